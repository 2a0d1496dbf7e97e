//! Views as a training sees them that refines cameras.
//!
//! In: a trainer and its data set. Out: the views with refined cameras, in the local coordinates of
//! the data set, and cameras in the world. Degenerate: a trainer that refines none gives the views
//! as they are.

use std::borrow::Cow;
use std::collections::BTreeMap;

use luxel_core::{Camera, Dataset, View};
use luxel_train::Reconstruction;

/// Returns the training views as a trainer sees them: with refined cameras, if there are any.
pub fn train_views_of<'d>(trainer: &dyn Reconstruction, dataset: &'d Dataset) -> Cow<'d, [View]> {
    let Some(cameras) = trainer.refined_cameras() else { return Cow::Borrowed(&dataset.train) };
    let views = dataset.train.iter().zip(cameras);
    Cow::Owned(views.map(|(view, camera)| View { camera, ..view.clone() }).collect())
}

/// Returns the test views with the lenses of the training views, if those are refined.
pub fn test_views_of<'d>(trainer: &dyn Reconstruction, dataset: &'d Dataset) -> Cow<'d, [View]> {
    match train_views_of(trainer, dataset) {
        Cow::Borrowed(_) => Cow::Borrowed(&dataset.test),
        Cow::Owned(train) => {
            let mut test = dataset.test.clone();
            share_lenses(&dataset.train, &train, &mut test);
            Cow::Owned(test)
        }
    }
}

/// Gives test views the refined focal lengths of training views with the same lens, whose cameras
/// were the `given` ones and are the `refined` ones.
pub fn share_lenses(given: &[View], refined: &[View], test: &mut [View]) {
    let lens = |view: &View| (view.camera.focal_px, view.camera.center_px, view.camera.size_px, view.camera.projection);
    for view in test {
        if let Some(at) = given.iter().position(|other| lens(other) == lens(view))
            && let Some(refined) = refined.get(at)
        {
            view.camera.focal_px = refined.camera.focal_px;
        }
    }
}

/// Returns the cameras of views by name, in the world of their data set.
pub fn cameras_in_world<'a>(dataset: &Dataset, views: impl IntoIterator<Item = &'a View>) -> BTreeMap<String, Camera> {
    let in_world = |view: &View| {
        let mut camera = view.camera.clone();
        dataset.world_from_local.apply_to_camera(&mut camera);
        (view.name.clone(), camera)
    };
    views.into_iter().map(in_world).collect()
}
