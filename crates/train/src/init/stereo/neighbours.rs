//! Which views are compared with which.
//!
//! In: panels. Out: for each, the indices of up to [`MOST`] others that show the same from another
//! place, best first. A small angle between rays leaves depth uncertain, a large one makes patches
//! unlike each other.

use glam::DVec2;

use super::panel::Panel;

/// Largest number of neighbours of a view.
const MOST: usize = 5;

/// Angle between the rays of two views that suits stereo best, radians (about 8 degrees).
const BEST_ANGLE: f64 = 0.14;

/// Smallest and largest angle at which views are compared, radians.
const ANGLES: [f64; 2] = [0.01, 0.7];

/// Smallest part of a panel that a neighbour has to see.
const LEAST_SEEN: f64 = 0.3;

/// Returns the neighbours of each view.
pub(super) fn neighbours(panels: &[Panel]) -> Vec<Vec<usize>> {
    panels.iter().enumerate().map(|(i, panel)| best_neighbours(i, panel, panels)).collect()
}

fn best_neighbours(own: usize, panel: &Panel, panels: &[Panel]) -> Vec<usize> {
    let mut scored: Vec<(f64, usize)> =
        panels.iter().enumerate().filter(|(i, _)| *i != own).filter_map(|(i, other)| Some((score(panel, other)?, i))).collect();
    scored.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    scored.into_iter().take(MOST).map(|(_, i)| i).collect()
}

/// Returns how well `other` complements `panel`, or `None` if the two cannot be compared.
fn score(panel: &Panel, other: &Panel) -> Option<f64> {
    let size = DVec2::new(panel.width as f64, panel.height as f64);
    let (mut seen, mut angles, mut count) = (0.0, 0.0, 0.0);
    for x in [0.15, 0.5, 0.85] {
        for y in [0.15, 0.5, 0.85] {
            let place = panel.place(size * DVec2::new(x, y), panel.typical);
            count += 1.0;
            if other.find(place).is_some() {
                seen += 1.0;
                angles += (panel.camera.eye() - place).angle_between(other.camera.eye() - place);
            }
        }
    }
    let (seen, angle) = (seen / count, angles / f64::max(seen, 1.0));
    let suits = seen >= LEAST_SEEN && (ANGLES[0]..ANGLES[1]).contains(&angle);
    suits.then(|| seen * (-(angle / BEST_ANGLE).ln().powi(2)).exp())
}
