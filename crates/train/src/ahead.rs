//! Views that are read and prepared while the engine computes.
//!
//! In: views whose images are read on demand, in the order in which the next steps want them. Out:
//! the same views with their images in memory, as [`prepare`](Wanted::prepare) makes them. One
//! thread reads; at most [`AHEAD`] views are read ahead, so that a limit on the memory of images
//! holds. The result is the same whether a view was read ahead or not. Degenerate: a view that
//! nobody asked for in advance is read at once.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use luxel_core::{ReadError, View};

use crate::crop::Crop;

/// Views that are read ahead.
pub(crate) const AHEAD: usize = 1;

/// A view to be prepared.
#[derive(Clone)]
pub(crate) struct Wanted {
    /// The step's view, which tells it from others.
    pub(crate) key: Key,
    /// The view, not loaded.
    pub(crate) view: View,
    /// Reduction of a side that remains to be done.
    pub(crate) reduce_by: u32,
}

/// The view of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Key {
    /// Index of the training view.
    pub(crate) index: usize,
    /// Reduction of a side.
    pub(crate) factor: u32,
    /// The part of the view, if not all of it.
    pub(crate) crop: Option<Crop>,
}

type Prepared = (Key, Result<View, ReadError>);
type Prepare = dyn Fn(&Wanted) -> Result<View, ReadError> + Send + Sync;

/// The thread that reads ahead, and what it has been asked for.
pub(crate) struct Ahead {
    prepare: Arc<Prepare>,
    /// `None` until the first view is asked for in advance.
    reader: Option<Reader>,
    /// The views that the reader has yet to hand over, in order.
    asked: VecDeque<Key>,
}

struct Reader {
    jobs: Sender<Wanted>,
    ready: Receiver<Prepared>,
}

impl Ahead {
    pub(crate) fn new(prepare: impl Fn(&Wanted) -> Result<View, ReadError> + Send + Sync + 'static) -> Self {
        Self { prepare: Arc::new(prepare), reader: None, asked: VecDeque::new() }
    }

    /// Asks for a view in advance, unless enough are on their way.
    pub(crate) fn ask(&mut self, wanted: impl FnOnce() -> Option<Wanted>) {
        if self.asked.len() >= AHEAD {
            return;
        }
        let Some(wanted) = wanted() else { return };
        let reader = self.reader.get_or_insert_with(|| Reader::start(Arc::clone(&self.prepare)));
        let key = wanted.key;
        // A reader that is gone leaves the view to be read when it is needed.
        if reader.jobs.send(wanted).is_ok() {
            self.asked.push_back(key);
        }
    }

    /// Returns a view: what was read in advance, or what is read now. Views that were asked for
    /// before it and never taken are dropped.
    pub(crate) fn take(&mut self, wanted: &Wanted) -> Result<View, ReadError> {
        let is_asked = self.asked.contains(&wanted.key);
        while let Some(reader) = self.reader.as_ref().filter(|_| is_asked || !self.asked.is_empty()) {
            let Ok((key, view)) = reader.ready.recv() else { break };
            self.asked.pop_front();
            if key == wanted.key {
                return view;
            }
        }
        (self.prepare)(wanted)
    }
}

impl Reader {
    fn start(prepare: Arc<Prepare>) -> Self {
        let (jobs, inbox) = channel::<Wanted>();
        let (outbox, ready) = channel::<Prepared>();
        // Ends when the trainer is dropped, which closes the channels.
        std::thread::spawn(move || {
            for wanted in inbox {
                if outbox.send((wanted.key, prepare(&wanted))).is_err() {
                    break;
                }
            }
        });
        Self { jobs, ready }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use luxel_core::Image;

    use super::*;
    use crate::testing::{camera_at, view_of};

    fn wanted(index: usize) -> Wanted {
        let image = Image::filled(2, 2, [index as f32; 3]);
        Wanted {
            key: Key { index, factor: 1, crop: None },
            view: view_of(&index.to_string(), camera_at([0.0; 3], [2, 2]), image),
            reduce_by: 1,
        }
    }

    #[test]
    fn views_come_as_they_are_wanted_whatever_was_asked_for() {
        let made = Arc::new(AtomicUsize::new(0));
        let counter = Arc::clone(&made);
        let mut ahead = Ahead::new(move |wanted: &Wanted| {
            counter.fetch_add(1, Ordering::Relaxed);
            Ok(wanted.view.clone())
        });
        let name = |ahead: &mut Ahead, index| ahead.take(&wanted(index)).unwrap().name;
        assert_eq!(name(&mut ahead, 3), "3");
        ahead.ask(|| Some(wanted(4)));
        ahead.ask(|| panic!("one is on its way"));
        assert_eq!((name(&mut ahead, 4), made.load(Ordering::Relaxed)), ("4".to_owned(), 2));
        // Another than the one that was asked for.
        ahead.ask(|| Some(wanted(5)));
        assert_eq!(name(&mut ahead, 6), "6");
        ahead.ask(|| Some(wanted(7)));
        assert_eq!((name(&mut ahead, 7), made.load(Ordering::Relaxed)), ("7".to_owned(), 5));
    }

    #[test]
    fn an_error_is_of_the_view_that_has_it() {
        let mut ahead = Ahead::new(|wanted: &Wanted| match wanted.key.index {
            1 => Err(ReadError { message: "gone".into(), remedy: None }),
            _ => Ok(wanted.view.clone()),
        });
        ahead.ask(|| Some(wanted(1)));
        assert!(ahead.take(&wanted(0)).is_ok());
        ahead.ask(|| Some(wanted(1)));
        assert_eq!(ahead.take(&wanted(1)).unwrap_err().message, "gone");
    }
}
