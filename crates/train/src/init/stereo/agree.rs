//! Points that the depths of several views agree on.
//!
//! In: panels and their depth maps. Out: one point per pixel whose depth at least [`LEAST_VIEWS`]
//! other views confirm, unless as many see through the place; at the mean of the places that these
//! views find, with the pixels at which they see it. A place that an earlier view confirms is left
//! out, because that view has given its point.

use glam::{DVec2, DVec3};
use luxel_core::{Observation, Point};
use rayon::prelude::*;

use super::panel::Panel;
use super::sweep::DepthMap;

/// Number of other views that have to agree, where a view has as many neighbours.
const LEAST_VIEWS: usize = 2;

/// Largest relative difference of two depths that agree.
const TOLERANCE: f64 = 0.01;

/// Relative difference of depths from which a view sees through a place.
const THROUGH: f64 = 0.05;

/// Returns the points, in the order of the views and their pixels.
pub(super) fn agreed(panels: &[Panel], maps: &[DepthMap], near: &[Vec<usize>]) -> Vec<Point> {
    let by_view: Vec<Vec<Point>> = (0..panels.len()).into_par_iter().map(|i| points_of_view(i, panels, maps, near)).collect();
    by_view.into_iter().flatten().collect()
}

fn points_of_view(own: usize, panels: &[Panel], maps: &[DepthMap], near: &[Vec<usize>]) -> Vec<Point> {
    let panel = &panels[own];
    let needed = LEAST_VIEWS.min(near[own].len()).max(1);
    let mut points = Vec::new();
    for (i, depth) in maps[own].depth.iter().enumerate().filter(|(_, depth)| **depth > 0.0) {
        let at_px = DVec2::new((i % panel.width) as f64 + 0.5, (i / panel.width) as f64 + 0.5);
        let place = panel.place(at_px, f64::from(*depth));
        let mut sum = place;
        let mut observations = vec![observation(panel, at_px)];
        let (mut through, mut is_given) = (0, false);
        for (view, other) in panels.iter().enumerate().filter(|(view, _)| *view != own) {
            let Some(([x, y], seen_px, distance)) = other.find(place) else { continue };
            let theirs = f64::from(maps[view].depth[y * other.width + x]);
            if theirs <= 0.0 {
                continue;
            }
            if (theirs / distance - 1.0).abs() < TOLERANCE {
                sum += other.place(seen_px, theirs);
                observations.push(observation(other, seen_px));
                is_given |= view < own;
            } else if theirs > distance * (1.0 + THROUGH) {
                through += 1;
            }
        }
        let agreeing = observations.len() - 1;
        if agreeing >= needed && through < agreeing && !is_given {
            let mean: DVec3 = sum / (agreeing + 1) as f64;
            points.push(Point { position: mean.as_vec3().to_array(), rgb8: None, observations });
        }
    }
    points
}

fn observation(panel: &Panel, at_px: DVec2) -> Observation {
    Observation { view: panel.view as u32, pixel_px: (at_px * panel.factor).as_vec2().to_array() }
}
