//! Views with the same lens.
//!
//! In: the cameras of the data set. Out: the number of each camera's group. Cameras are in one
//! group if focal lengths, principal point, image size and projection are equal; groups are
//! numbered in the order of their first cameras.

use luxel_core::Camera;

/// Returns whether two cameras have the same lens and image size.
pub(crate) fn has_same_lens(a: &Camera, b: &Camera) -> bool {
    let intrinsics = |camera: &Camera| (camera.focal_px, camera.center_px, camera.size_px, camera.projection);
    intrinsics(a) == intrinsics(b)
}

/// Returns the group of each camera.
pub(crate) fn groups_by_lens(cameras: &[Camera]) -> Vec<usize> {
    let mut first_of_group: Vec<&Camera> = Vec::new();
    let mut groups = Vec::with_capacity(cameras.len());
    for camera in cameras {
        let known = first_of_group.iter().position(|first| has_same_lens(first, camera));
        groups.push(known.unwrap_or(first_of_group.len()));
        if known.is_none() {
            first_of_group.push(camera);
        }
    }
    groups
}
