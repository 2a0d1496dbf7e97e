//! Removal of splats from a scene: those that a selection names, and floaters.
//!
//! In: a scene, and for floaters the views of a data set if there is one. Out: [`Removed`], a
//! reason for each splat that goes. Nothing else of the scene changes, and the order of the others
//! stays.
//!
//! A floater is a splat that no surface explains:
//! - unseen: its blending weights in all views together are less than a tenth of a pixel;
//! - isolated: its nearest [`NEIGHBOURS`] splats are several times as far as theirs are from one
//!   another (the local outlier factor of Breunig et al. 2000, with distances in place of
//!   reachabilities), it does not reach them, and few views see it or it is faint;
//! - haze: it is faint, larger than half of the scene, and adds next to nothing to the views.
//!
//! Degenerate: without views a splat is isolated if it is faint or twice as far away, and none is
//! unseen. A scene that would lose all its splats is an error.

use luxel_core::edit::MaskShares;
use luxel_core::{Camera, Dataset, Engine, Mask, OnDemand, Scene, Selection, mask, sigmoid, text};
use luxel_train::Neighbourhood;

use crate::error::{Context, bail};
use crate::{Observer, Result};

/// Neighbours whose distance tells how isolated a splat is: more than a floater's own clump has.
const NEIGHBOURS: usize = 16;
/// Ratio of distances from which a splat is isolated.
const ISOLATED: f32 = 4.0;
/// Standard deviations within which a splat reaches its neighbours.
const REACH: f32 = 3.0;
/// Opacity below which an isolated splat is faint, and haze.
const FAINT: f32 = 0.3;
const HAZE: f32 = 0.1;
/// Sum of blending weights over all views, pixels, below which a splat is unseen.
const UNSEEN_PX: f32 = 0.1;
/// Weight in a view, pixels, from which the view sees a splat.
const SEEN_PX: f32 = 0.5;
/// Part of the views that is few.
const FEW_VIEWS: f32 = 0.1;
/// Part of all weights that is next to nothing, for one splat.
const NEXT_TO_NOTHING: f64 = 1e-4;

/// The reason for which a splat is removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RemovalReason {
    /// A selection names it.
    Selected,
    /// No view sees it.
    Unseen,
    /// It is far from all others.
    Isolated,
    /// It is large and faint.
    Haze,
}

/// The splats to remove.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Removed {
    /// The reason of each splat, `[N]`; `None` for those that stay.
    pub reasons: Vec<Option<RemovalReason>>,
}

/// A view that tells which splats are seen: its camera, in the local coordinates of the scene, and
/// the pixels that count.
#[derive(Clone, Copy, Debug)]
pub struct Watching<'a> {
    /// Camera.
    pub camera: &'a Camera,
    /// Pixels that count; `None` for all.
    pub mask: Option<&'a OnDemand<Mask>>,
}

/// The weight of each splat in the views, and the views that see it.
struct Sight {
    /// Sum of blending weights over all views, pixels, `[N]`.
    weight: Vec<f32>,
    /// Number of views that see it, `[N]`.
    views: Vec<u32>,
    /// Sum of all weights.
    total: f64,
    /// Number of views in all.
    all_views: usize,
}

impl Removed {
    /// Returns the splats that a selection names: those whose weight is at least one half.
    ///
    /// # Errors
    /// A parameter that is out of range, or a mask that is missing.
    pub fn selected(selection: &Selection, scene: &Scene, masks: &MaskShares) -> Result<Self> {
        let weights = selection.weights(scene, masks).with_context(|| format!("cannot delete \"{selection}\""))?;
        Ok(Self { reasons: weights.into_iter().map(|weight| (weight >= 0.5).then_some(RemovalReason::Selected)).collect() })
    }

    /// Returns the floaters of a scene, by the views of `dataset` if there is one.
    ///
    /// ```
    /// use luxel::edit::Removed;
    /// use luxel::{Device, SelectedEngine, Silent, synthetic};
    ///
    /// # fn main() -> luxel::Result<()> {
    /// let scene = synthetic::room(200, 1).into_core();
    /// let mut engine = SelectedEngine::open(&Device::Cpu.into())?.engine;
    /// let found = Removed::floaters(&scene, None, engine.as_mut(), &Silent)?;
    /// assert!(found.count() < 20);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// A device that gave up.
    pub fn floaters(scene: &Scene, dataset: Option<&Dataset>, engine: &mut dyn Engine, observer: &dyn Observer) -> Result<Self> {
        // Held-out views too: what only they see is no floater.
        let views = dataset.map(|dataset| dataset.train.iter().chain(&dataset.test));
        let views: Option<Vec<Watching<'_>>> =
            views.map(|views| views.map(|view| Watching { camera: &view.camera, mask: view.mask.as_ref() }).collect());
        Self::floaters_in(scene, views.as_deref(), engine, observer)
    }

    /// Returns the floaters of a scene by these views, as [`Self::floaters`] does.
    ///
    /// # Errors
    /// A device that gave up.
    pub fn floaters_in(scene: &Scene, views: Option<&[Watching<'_>]>, engine: &mut dyn Engine, observer: &dyn Observer) -> Result<Self> {
        let sight = match views {
            Some(views) => Some(Sight::measure(scene, views, engine)?),
            None => {
                observer.note("no data set: floaters are found by opacity, size and isolation, not by their contribution to views");
                None
            }
        };
        let splats = &scene.splats;
        let neighbourhood = Neighbourhood::new(&splats.position, NEIGHBOURS);
        let isolation = neighbourhood.isolation();
        let extent = extent(&splats.position);
        let reason = |i: usize| {
            let opacity = sigmoid(splats.opacity_logit[i]);
            let largest = splats.log_scale[i].into_iter().fold(f32::NEG_INFINITY, f32::max).exp();
            let is_far = |ratio: f32| isolation[i] > ratio && neighbourhood.distance(i) > REACH * largest;
            if sight.as_ref().is_some_and(|sight| sight.weight[i] < UNSEEN_PX) {
                return Some(RemovalReason::Unseen);
            }
            let is_doubtful = match &sight {
                Some(sight) => opacity < FAINT || sight.is_seen_by_few(i),
                None => opacity < FAINT || is_far(2.0 * ISOLATED),
            };
            if is_far(ISOLATED) && is_doubtful {
                return Some(RemovalReason::Isolated);
            }
            let is_nothing = sight.as_ref().is_none_or(|sight| sight.is_next_to_nothing(i));
            (opacity < HAZE && largest > 0.5 * extent && is_nothing).then_some(RemovalReason::Haze)
        };
        Ok(Self { reasons: (0..splats.len()).map(reason).collect() })
    }

    /// Returns both removals together; where both name a splat, this one's reason counts.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        let length = self.reasons.len().max(other.reasons.len());
        let at = |reasons: &[Option<RemovalReason>], i: usize| reasons.get(i).copied().flatten();
        Self { reasons: (0..length).map(|i| at(&self.reasons, i).or(at(&other.reasons, i))).collect() }
    }

    /// Returns the number of splats to remove.
    pub fn count(&self) -> usize {
        self.reasons.iter().flatten().count()
    }

    /// Returns the number of splats that go for a reason.
    pub fn count_of(&self, reason: RemovalReason) -> usize {
        self.reasons.iter().flatten().filter(|found| **found == reason).count()
    }

    /// Returns the part of the scene's light ([`Scene::light`]) that the splats hold, 0 to 1.
    pub fn share_of_light(&self, scene: &Scene) -> f64 {
        let light = |i: usize| scene.light(i);
        let total: f64 = (0..scene.splats.len()).map(light).sum();
        let removed: f64 = (0..scene.splats.len()).filter(|i| self.is_removed(*i)).map(light).sum();
        if total > 0.0 { removed / total } else { 0.0 }
    }

    /// Returns whether splat `i` goes.
    pub fn is_removed(&self, i: usize) -> bool {
        self.reasons.get(i).is_some_and(Option::is_some)
    }

    /// Returns what goes in words: `12 of 400 splats: 5 selected, 7 that no view sees`.
    pub fn in_words(&self) -> String {
        let words = [
            (RemovalReason::Selected, "selected"),
            (RemovalReason::Unseen, "that no view sees"),
            (RemovalReason::Isolated, "isolated"),
            (RemovalReason::Haze, "large and faint"),
        ];
        let found: Vec<String> = words
            .into_iter()
            .map(|(reason, words)| (self.count_of(reason), words))
            .filter(|(count, _)| *count > 0)
            .map(|(count, words)| format!("{} {words}", text::count(count)))
            .collect();
        let parts = if found.is_empty() { String::new() } else { format!(": {}", found.join(", ")) };
        format!("{} of {}{parts}", text::count(self.count()), text::plural(self.reasons.len(), "splat"))
    }

    /// Removes the splats from the scene, and adds `record` to its log of edits.
    ///
    /// # Errors
    /// No splat would be left.
    pub fn apply(&self, scene: &mut Scene, record: String) -> Result<()> {
        let kept: Vec<u32> = (0..scene.splats.len()).filter(|i| !self.is_removed(*i)).filter_map(|i| u32::try_from(i).ok()).collect();
        if kept.is_empty() {
            bail!("no splats would be left of {}; narrow the selection", text::plural(scene.splats.len(), "splat"));
        }
        scene.splats = scene.splats.select(kept);
        scene.edits.push(record);
        Ok(())
    }
}

impl Sight {
    fn measure(scene: &Scene, views: &[Watching<'_>], engine: &mut dyn Engine) -> Result<Self> {
        engine.load(&scene.splats, None).context("cannot load the scene")?;
        let options = scene.render_options();
        let count = scene.splats.len();
        let mut sight = Self { weight: vec![0.0; count], views: vec![0; count], total: 0.0, all_views: views.len() };
        for Watching { camera, mask } in views {
            let [width, height] = camera.size_px.map(|side| side as usize);
            let mask = mask.map(OnDemand::loaded).transpose()?;
            let is_valid = |i: usize| mask::is_valid(mask.as_deref(), i);
            let mask: Vec<f32> = (0..width * height).map(|i| f32::from(u8::from(is_valid(i)))).collect();
            let found = engine.contributions(camera, &options, &mask).context("cannot measure the splats' contributions")?;
            for (i, weight) in found.masked.into_iter().enumerate() {
                sight.weight[i] += weight;
                sight.total += f64::from(weight);
                sight.views[i] += u32::from(weight >= SEEN_PX);
            }
        }
        Ok(sight)
    }

    fn is_seen_by_few(&self, i: usize) -> bool {
        self.views[i] as f32 <= (FEW_VIEWS * self.all_views as f32).max(1.0)
    }

    fn is_next_to_nothing(&self, i: usize) -> bool {
        f64::from(self.weight[i]) < NEXT_TO_NOTHING * self.total
    }
}

/// Returns the diagonal of the box that 98 % of the centres are in along each axis.
fn extent(positions: &[[f32; 3]]) -> f32 {
    let side = |axis: usize| {
        let mut values: Vec<f32> = positions.iter().map(|position| position[axis]).collect();
        values.sort_unstable_by(f32::total_cmp);
        let at = |part: f64| values.get((part * values.len().saturating_sub(1) as f64) as usize).copied().unwrap_or(0.0);
        at(0.99) - at(0.01)
    };
    (0..3).map(|axis| side(axis).powi(2)).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use luxel_core::{Splat, Splats, logit};

    use super::*;
    use crate::{Device, SelectedEngine, Silent, synthetic};

    struct Lone {
        position: [f32; 3],
        sigma: f32,
        opacity: f32,
    }

    /// A wall of 40 x 40 splats at z = 4, and these behind it.
    fn scene(lone: &[Lone]) -> Scene {
        let mut scene = synthetic::room(1, 1).into_core();
        let mut splats = Splats::empty(scene.splats.color_model);
        let (dc, raw) = splats.color_model.constant([0.5, 0.4, 0.3]);
        let mut sh = vec![0.0; 3 * splats.color_model.sh_coefficients()];
        sh[..3].copy_from_slice(&dc);
        let raw = vec![raw; splats.color_model.luminance_coefficients()];
        let wall = (0..1600).map(|i| Lone {
            position: [0.1 * (i % 40) as f32 - 2.0, 0.1 * (i / 40) as f32 - 2.0, 4.0],
            sigma: 0.05,
            opacity: 0.9,
        });
        for Lone { position, sigma, opacity } in wall.chain(lone.iter().map(|l| Lone { ..*l })) {
            let rotation = [1.0, 0.0, 0.0, 0.0];
            let log_scale = [sigma.ln(); 3];
            splats.push(&Splat { position, rotation, log_scale, opacity_logit: logit(opacity), sh: &sh, raw_luminance: &raw });
        }
        scene.splats = splats;
        scene
    }

    fn found(scene: &Scene, dataset: Option<&Dataset>) -> Vec<(usize, RemovalReason)> {
        let mut engine = SelectedEngine::open(&Device::Cpu.into()).unwrap().engine;
        let removed = Removed::floaters(scene, dataset, engine.as_mut(), &Silent).unwrap();
        removed.reasons.iter().enumerate().filter_map(|(i, reason)| Some((i, (*reason)?))).collect()
    }

    #[test]
    fn lone_splats_in_free_space_are_floaters_and_the_wall_is_not() {
        assert_eq!(found(&scene(&[]), None), []);
        let lone = [
            Lone { position: [0.0, 0.0, 1.0], sigma: 0.02, opacity: 0.9 },
            Lone { position: [0.5, 0.5, 2.0], sigma: 0.02, opacity: 0.1 },
            // On the wall.
            Lone { position: [0.02, 0.03, 4.0], sigma: 0.02, opacity: 0.1 },
            // Large and faint: haze over everything.
            Lone { position: [0.0, 0.0, 3.9], sigma: 30.0, opacity: 0.03 },
        ];
        let expected = [(1600, RemovalReason::Isolated), (1601, RemovalReason::Isolated), (1603, RemovalReason::Haze)];
        assert_eq!(found(&scene(&lone), None), expected);
    }

    #[test]
    fn a_clump_of_floaters_is_found() {
        let clump: Vec<Lone> = (0..8).map(|i| Lone { position: [0.05 * i as f32, 0.0, 1.0], sigma: 0.01, opacity: 0.2 }).collect();
        let found = found(&scene(&clump), None);
        assert_eq!(found, (1600..1608).map(|i| (i, RemovalReason::Isolated)).collect::<Vec<_>>());
    }

    #[test]
    fn views_tell_a_lamp_from_a_floater_and_what_none_of_them_sees() {
        let folder = tempfile::tempdir().unwrap();
        synthetic::write_dataset(folder.path(), synthetic::BallsOptions { side_px: 32, views: 9 }).unwrap();
        let mut dataset = crate::Dataset::open(folder.path()).unwrap().into_core();
        dataset.test.clear();
        // All cameras at the origin look along z, one of them from beside.
        let pose = |x: f64| glam::DAffine3::from_translation(glam::DVec3::new(-x, 0.0, 0.0));
        dataset.train.iter_mut().enumerate().for_each(|(i, view)| view.camera.camera_from_world = pose(0.1 * i as f64));
        let lone = [
            // In front of all cameras: a lamp.
            Lone { position: [0.0, 0.0, 2.0], sigma: 0.03, opacity: 0.95 },
            // Behind them.
            Lone { position: [0.0, 0.0, -3.0], sigma: 0.03, opacity: 0.95 },
            // Behind the wall, through whose gaps few views see it.
            Lone { position: [0.0, 0.0, 9.0], sigma: 0.03, opacity: 0.95 },
        ];
        let scene = scene(&lone);
        let found = found(&scene, Some(&dataset));
        let of_lone: Vec<_> = found.iter().filter(|(i, _)| *i >= 1600).copied().collect();
        assert_eq!(of_lone, [(1601, RemovalReason::Unseen), (1602, RemovalReason::Isolated)]);
    }

    #[test]
    fn removal_keeps_the_others_and_their_order() {
        let mut scene = scene(&[Lone { position: [0.0, 0.0, 1.0], sigma: 0.02, opacity: 0.9 }]);
        let before = scene.clone();
        let selection: Selection = "box(-9,-9,3.5,9,0,4.5)".parse().unwrap();
        let removed = Removed::selected(&selection, &scene, &MaskShares::new()).unwrap();
        assert!(removed.in_words().starts_with(&format!("{} of 1,601 splats: {} selected", removed.count(), removed.count())));
        removed.apply(&mut scene, "delete".into()).unwrap();
        let kept: Vec<u32> = (0..1601).filter(|i| !removed.is_removed(*i as usize)).collect();
        assert_eq!((&scene.splats, scene.edits.len()), (&before.splats.select(kept), 1));
        assert_eq!(scene.splats.len() + removed.count(), 1601);
        let all = Removed::selected(&Selection::All, &scene, &MaskShares::new()).unwrap();
        assert!(all.apply(&mut scene, "delete".into()).unwrap_err().to_string().contains("no splats would be left"));
        let both =
            Removed { reasons: vec![None, Some(RemovalReason::Haze)] }.or(Removed { reasons: vec![Some(RemovalReason::Selected); 2] });
        assert_eq!(both.reasons, [Some(RemovalReason::Selected), Some(RemovalReason::Haze)]);
    }
}
