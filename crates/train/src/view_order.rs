//! The order in which training views come: one of each part of the views a step.
//!
//! In: the number of views and of views a step. Out: the views of a step, slot by slot. Part `s`
//! has the views whose index leaves the remainder `s`, so whoever computes slot `s` needs the
//! images of that part alone, whatever is drawn. Each part has epochs of its own, in which each of
//! its views comes once; parts differ by at most one view. Which process computes which slot
//! changes nothing here. Degenerate: with one view a step, the only part has all views.

use std::ops::Range;

use rand::seq::SliceRandom;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// The number of views of each part's epoch that have been used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Cursors(Vec<usize>);

/// Returns the places in the order that belong to part `slot` of `count` views in `batch` parts.
fn part(count: usize, batch: usize, slot: usize) -> Range<usize> {
    let len = |slot: usize| (count + batch - 1 - slot) / batch;
    let start = (0..slot).map(len).sum();
    start..start + len(slot)
}

/// Returns the first order, part after part, and cursors at the ends of epochs, so that the first
/// step shuffles.
pub(crate) fn first_order(count: usize, batch: usize) -> (Vec<u32>, Cursors) {
    let order = (0..batch).flat_map(|slot| (slot..count).step_by(batch)).map(|view| view as u32).collect();
    (order, Cursors((0..batch).map(|slot| part(count, batch, slot).len()).collect()))
}

impl Cursors {
    fn batch(&self) -> usize {
        self.0.len()
    }

    /// Returns the views of the next step, one a slot, and moves on past those of `validation`, of
    /// which no part may consist.
    pub(crate) fn next_views(&mut self, order: &mut [u32], rng: &mut Pcg64Mcg, validation: &[usize]) -> Vec<usize> {
        let (count, batch) = (order.len(), self.batch());
        let next = |(slot, cursor): (usize, &mut usize)| {
            let part = &mut order[part(count, batch, slot)];
            loop {
                if *cursor >= part.len() {
                    part.shuffle(rng);
                    *cursor = 0;
                }
                let view = part.get(*cursor).copied().unwrap_or(0) as usize;
                *cursor += 1;
                if !validation.contains(&view) {
                    return view;
                }
            }
        };
        self.0.iter_mut().enumerate().map(next).collect()
    }

    /// Returns the view of `slot` that [`Self::next_views`] would return now. At the end of an
    /// epoch, random numbers drawn until then may still change it.
    pub(crate) fn upcoming_view(&self, order: &[u32], rng: &Pcg64Mcg, slot: usize, validation: &[usize]) -> usize {
        let part = &order[part(order.len(), self.batch(), slot)];
        let left = self.0.get(slot).and_then(|cursor| part.get(*cursor..)).unwrap_or_default();
        let first = |views: &[u32]| views.iter().find(|view| !validation.contains(&(**view as usize))).copied();
        let view = first(left).or_else(|| {
            let (mut part, mut rng) = (part.to_vec(), rng.clone());
            part.shuffle(&mut rng);
            first(&part)
        });
        view.unwrap_or(0) as usize
    }

    /// Returns whether these are cursors into an order of `count` views in `batch` parts.
    pub(crate) fn fit(&self, order: &[u32], count: usize, batch: usize) -> bool {
        order.len() == count
            && self.batch() == batch
            && self.0.iter().enumerate().all(|(slot, cursor)| {
                let mut views = order[part(count, batch, slot)].to_vec();
                views.sort_unstable();
                *cursor <= views.len() && views.into_iter().map(|view| view as usize).eq((slot..count).step_by(batch))
            })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn every_view_comes_once_in_an_epoch_of_its_part() {
        for (count, batch) in [(6, 1), (7, 3), (8, 4), (3, 3), (5, 2)] {
            let (mut order, mut cursors) = first_order(count, batch);
            let mut rng = Pcg64Mcg::seed_from_u64(1);
            let longest = count.div_ceil(batch);
            let mut seen = vec![0; count];
            for _ in 0..12 * longest {
                assert!(cursors.fit(&order, count, batch), "{count} {batch}");
                let upcoming: Vec<usize> = (0..batch).map(|slot| cursors.upcoming_view(&order, &rng, slot, &[])).collect();
                let (before, views) = (rng.clone(), cursors.next_views(&mut order, &mut rng, &[]));
                assert!(views.iter().enumerate().all(|(slot, view)| view % batch == slot), "{views:?}");
                assert!(before != rng || upcoming == views, "{upcoming:?} {views:?}");
                views.into_iter().for_each(|view| seen[view] += 1);
            }
            assert!(seen.iter().all(|times| (12..=12 * longest / (longest - 1).max(1)).contains(times)), "{count} {batch}: {seen:?}");
        }
    }

    #[test]
    fn validation_views_come_in_no_step() {
        let (mut order, mut cursors) = first_order(13, 1);
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        let validation = [3, 9];
        let mut seen = [0; 13];
        for _ in 0..66 {
            let upcoming = cursors.upcoming_view(&order, &rng, 0, &validation);
            let views = cursors.next_views(&mut order, &mut rng, &validation);
            assert_eq!(views, [upcoming]);
            seen[upcoming] += 1;
        }
        assert!(seen.iter().enumerate().all(|(view, times)| *times == if validation.contains(&view) { 0 } else { 6 }), "{seen:?}");
        let all: std::collections::BTreeSet<usize> = (0..26).flat_map(|_| cursors.next_views(&mut order, &mut rng, &[])).collect();
        assert_eq!(all.len(), 13);
    }

    #[test]
    fn cursors_come_back_and_must_fit() {
        let (order, cursors) = first_order(5, 1);
        let two = first_order(5, 2).1;
        assert_eq!(serde_json::from_str::<Cursors>(&serde_json::to_string(&two).unwrap()).unwrap(), two);
        assert!(cursors.fit(&order, 5, 1) && !cursors.fit(&order, 5, 2) && !two.fit(&order, 5, 2) && !cursors.fit(&order, 6, 1));
        assert!(!Cursors(vec![6]).fit(&order, 5, 1));
    }
}
