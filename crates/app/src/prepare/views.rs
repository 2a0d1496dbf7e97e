//! All views, several at a time as far as memory allows.
//!
//! In: a [`Developer`] and a memory budget. Out: records of the views that could be developed, and
//! what was left out. Views that an earlier call finished are taken over. Views are taken from one
//! list by as many workers as their memory fits into the budget, at least one; within a view all
//! cores work.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

use luxel::{Event, ItemKind, Observer, Result};
use luxel_capture::prepare::{LeftOut, PlannedView, ViewRecord};

use super::develop::{Developer, is_system_error};
use super::state::State;

/// Develops all views that are not there yet. A refusal of the system ends it, and is no reason to
/// leave a view out.
pub(super) fn develop_all(
    developer: &Developer<'_>,
    state: &mut State,
    memory_bytes: u64,
    observer: &dyn Observer,
) -> Result<(Vec<ViewRecord>, Vec<LeftOut>)> {
    let views = &developer.plan.views;
    let total = views.len();
    let mut done: Vec<ViewRecord> = Vec::with_capacity(total);
    let mut todo: Vec<&PlannedView> = Vec::new();
    for view in views {
        let record = state.view(&view.name, &developer.key(view));
        match record.filter(|record| is_there(developer, record)) {
            Some(record) => done.push(record.clone()),
            None => todo.push(view),
        }
    }
    if !done.is_empty() && !todo.is_empty() {
        observer.note(&format!("{} of {total} views are there from an earlier run", done.len()));
    }
    state.forget(todo.iter().map(|view| view.name.as_str()))?;
    let largest = todo.iter().map(|view| developer.bytes_of(view)).max().unwrap_or(1).max(1);
    let fitting = usize::try_from(memory_bytes / largest).unwrap_or(usize::MAX);
    let workers = rayon::current_num_threads().min(fitting).min(todo.len()).max(1);
    let mut left_out = Vec::new();
    observer.event(Event::StepsBegin { done: done.len() as u32, total: total as u32 });
    let next = AtomicUsize::new(0);
    let (sender, receiver) = mpsc::channel();
    let result = std::thread::scope(|scope| {
        for _ in 0..workers {
            let sender = sender.clone();
            scope.spawn(|| {
                let sender = sender;
                while let Some(view) = todo.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if sender.send((view.name.clone(), developer.develop(view))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        for (name, made) in receiver {
            match made {
                Ok(record) => {
                    for left_out in &record.left_out {
                        observer.warn(&format!("view {name}: {} is left out: {}", left_out.file, left_out.reason));
                    }
                    state.insert(record.clone())?;
                    done.push(record);
                }
                Err(error) if is_system_error(&error) => {
                    return Err(error.context(format!("view {name}: cannot be made; the same call continues where it was")));
                }
                Err(error) => {
                    observer.warn(&format!("view {name}: {error:#}"));
                    left_out.push(LeftOut { file: name.clone(), reason: format!("{error:#}") });
                }
            }
            let made = done.len() + left_out.len();
            observer.event(Event::Step { done: made as u32 });
            observer.event(Event::Item { kind: ItemKind::View, name, done: made as u32, total: total as u32 });
        }
        Ok(())
    });
    observer.event(Event::StepsEnd);
    // Finished views are recorded, whatever ended the others.
    result.and(state.save())?;
    done.sort_by(|a, b| a.name.cmp(&b.name));
    Ok((done, left_out))
}

/// Returns whether the files of a view are there.
fn is_there(developer: &Developer<'_>, record: &ViewRecord) -> bool {
    let pictures = developer.picture_names(record);
    let proxies = developer.folders.output.join("proxies");
    developer.folders.radiance(&record.name).is_file() && pictures.iter().all(|name| proxies.join(name).is_file())
}
