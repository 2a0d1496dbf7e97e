//! The cameras before and after a frame, between which pixels move.

use anyhow::{Result, bail};
use luxel_core::Camera;

use super::plan::RenderPlan;
use super::shots::{Shot, Shots};
use crate::args::channels::ChannelArg;

/// The frames next to one in time.
#[derive(Clone, Debug)]
pub(super) struct Neighbours {
    pub(super) before: Option<Camera>,
    pub(super) after: Option<Camera>,
}

impl Neighbours {
    /// Returns the neighbours of each shot, if motion is asked for.
    ///
    /// # Errors
    /// Cameras that are not frames.
    pub(super) fn of_shots(plan: &RenderPlan<'_>, shots: &Shots) -> Result<Option<Vec<Self>>> {
        if !plan.images.channels.has(ChannelArg::Motion) {
            return Ok(None);
        }
        if !plan.cameras.choice.is_moving() || shots.frames_len() < 2 {
            bail!(
                "--aov motion needs a camera that moves from frame to frame; give --path KIND, or --cameras FILE with two frames or more"
            );
        }
        let step = shots.images_per_frame;
        let camera = |i: Option<usize>| i.and_then(|i| shots.all.get(i)).map(|shot: &Shot| shot.camera.clone());
        let of = |i: usize| Self { before: camera(i.checked_sub(step)), after: camera(i.checked_add(step)) };
        Ok(Some((0..shots.all.len()).map(of).collect()))
    }

    /// Returns what decides the channels beside the camera.
    pub(super) fn recipe(&self) -> String {
        format!("{:?} {:?}", self.before, self.after)
    }
}
