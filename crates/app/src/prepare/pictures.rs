//! The pictures that structure from motion gets: one of each photograph, or six cut out of each
//! panorama.
//!
//! In: finished views. Out: [`Pictures`]: names below `proxies/`, grouped by lens, and the rigs
//! that hold the cut-outs of a panorama together. Cut-outs lie in a folder for each direction and
//! size, such as `front-485px/IMG_0001.jpg`: COLMAP takes pictures of one name in the folders of a
//! rig for one frame.

use std::collections::{BTreeMap, BTreeSet};

use glam::DQuat;
use luxel_capture::panorama::{CutoutLens, Face};
use luxel_capture::prepare::{PlannedCamera, SetProjection, ViewRecord};
use serde_json::{Value, json};

use super::folders::proxy_name;
use super::options::CameraModel;

/// Pictures of one lens.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PictureGroup {
    pub(super) model: CameraModel,
    /// COLMAP's parameters, where the lens is known or stated.
    pub(super) params: Option<String>,
    /// Names below `proxies/`.
    pub(super) names: Vec<String>,
}

/// All pictures.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pictures {
    pub(super) groups: Vec<PictureGroup>,
    /// Names of each view's pictures.
    pub(super) by_view: Vec<Vec<String>>,
    /// COLMAP's description of the rigs, of panoramas.
    pub(super) rigs: Option<Value>,
}

impl Pictures {
    /// Returns the pictures of views whose lenses have this model.
    pub(super) fn new(views: &[ViewRecord], cameras: &[PlannedCamera], model: CameraModel, projection: SetProjection) -> Self {
        match projection {
            SetProjection::Pinhole => Self::of_photographs(views, cameras, model),
            SetProjection::Equirectangular => Self::of_panoramas(views),
        }
    }

    /// Returns the number of pictures.
    pub(super) fn count(&self) -> usize {
        self.by_view.iter().map(Vec::len).sum()
    }

    fn of_photographs(views: &[ViewRecord], cameras: &[PlannedCamera], model: CameraModel) -> Self {
        let mut groups: BTreeMap<(usize, [usize; 2]), Vec<String>> = BTreeMap::new();
        for view in views {
            groups.entry((view.camera, view.proxy_px)).or_default().push(proxy_name(&view.name));
        }
        let group = |((camera, size_px), names): ((usize, [usize; 2]), Vec<String>)| {
            let [w, h] = size_px.map(|side| side as f64);
            let focal = cameras.get(camera).and_then(|camera| camera.focal_per_side);
            PictureGroup { model, params: focal.map(|focal| model.params(focal * w.max(h), [0.5 * w, 0.5 * h])), names }
        };
        let by_view = views.iter().map(|view| vec![proxy_name(&view.name)]).collect();
        Self { groups: groups.into_iter().map(group).collect(), by_view, rigs: None }
    }

    fn of_panoramas(views: &[ViewRecord]) -> Self {
        // A camera for each direction: those of a rig are different ones.
        let mut groups: BTreeMap<(CutoutSize, Face), Vec<String>> = BTreeMap::new();
        for view in views {
            for face in Face::ALL {
                groups.entry((CutoutSize::of(view), face)).or_default().push(cutout_name(face, view.proxy_px[0], &view.name));
            }
        }
        let sizes: BTreeSet<CutoutSize> = groups.keys().map(|(size, _)| *size).collect();
        let group = |((size, _), names): ((CutoutSize, Face), Vec<String>)| {
            let model = CameraModel::SimplePinhole;
            PictureGroup { model, params: Some(model.params(size.lens().focal_px, [0.5 * size.side_px as f64; 2])), names }
        };
        let by_view = views.iter().map(|view| Face::ALL.map(|face| cutout_name(face, view.proxy_px[0], &view.name)).to_vec()).collect();
        let rigs = sizes.iter().map(|size| rig(size.side_px)).collect();
        Self { groups: groups.into_iter().map(group).collect(), by_view, rigs: Some(Value::Array(rigs)) }
    }
}

/// Sizes of a panorama and of its cut-outs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct CutoutSize {
    side_px: usize,
    panorama_px: usize,
}

impl CutoutSize {
    fn of(view: &ViewRecord) -> Self {
        Self { side_px: view.proxy_px[0], panorama_px: view.size_px[0] }
    }

    fn lens(self) -> CutoutLens {
        CutoutLens::for_width(self.panorama_px)
    }
}

/// Returns the name of a cut-out below `proxies/`.
pub(super) fn cutout_name(face: Face, side_px: usize, view: &str) -> String {
    format!("{}{}", folder_name(face, side_px), proxy_name(view))
}

fn folder_name(face: Face, side_px: usize) -> String {
    format!("{}-{side_px}px/", face.name())
}

/// Returns COLMAP's description of the rig of cut-outs of a size.
fn rig(side_px: usize) -> Value {
    let camera = |face: Face| {
        let mut camera = json!({ "image_prefix": folder_name(face, side_px) });
        if face == Face::Front {
            camera["ref_sensor"] = json!(true);
        } else {
            let q = DQuat::from_mat3(&face.panorama_from_cutout().transpose()).normalize();
            camera["cam_from_rig_rotation"] = json!([q.w, q.x, q.y, q.z]);
            camera["cam_from_rig_translation"] = json!([0.0, 0.0, 0.0]);
        }
        camera
    };
    json!({ "cameras": Face::ALL.map(camera) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rig_has_six_cameras_at_right_angles() {
        let rig = rig(388);
        let cameras = rig["cameras"].as_array().unwrap();
        assert_eq!(cameras.len(), 6);
        assert_eq!(cameras[0], json!({ "image_prefix": "front-388px/", "ref_sensor": true }));
        let right: Vec<f64> = cameras[1]["cam_from_rig_rotation"].as_array().unwrap().iter().filter_map(Value::as_f64).collect();
        // What is to the right of the rig is before this camera.
        let seen = DQuat::from_xyzw(right[1], right[2], right[3], right[0]) * glam::DVec3::X;
        assert!(seen.abs_diff_eq(glam::DVec3::Z, 1e-12), "{seen}");
    }
}
