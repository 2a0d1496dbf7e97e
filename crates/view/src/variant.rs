//! The scene that a picture is of, and how its splats are drawn.
//!
//! In: the parameters `scene`, `splats`, `splat_size`, `splat_opacity`, `near` and `far` of a
//! request. Out: a [`Variant`]. Degenerate: without any of them it is the first scene, blended, as
//! a whole.

use crate::solids::{Shape, SolidOptions};
use luxel::Scene;
use luxel_core::Camera;

use crate::query::Query;

/// Largest size of an ellipsoid, standard deviations, and of a dot's radius, pixels.
const MAX_SIZE: f64 = 10.0;

/// The scene that a picture is of, and how its splats are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Variant {
    /// Index of the scene; the first is 0.
    pub(crate) scene: usize,
    /// Splats as bodies; `None` for a render.
    pub(crate) solids: Option<SolidOptions>,
    /// Depths that are shown.
    pub(crate) clip: Option<Clip>,
}

/// The depths between which splats are shown by their centres, world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Clip {
    pub(crate) near: f64,
    pub(crate) far: f64,
}

impl Variant {
    /// Takes a variant out of a query to a viewer of `scenes` scenes.
    pub(crate) fn take(query: &mut Query, scenes: usize) -> Result<Self, String> {
        let scene = query.number("scene")?.unwrap_or(0);
        if scene >= scenes {
            return Err(format!("\"scene\" is {scene}, expected a number below {scenes}, the scenes of this viewer"));
        }
        Ok(Self { scene, solids: solids(query)?, clip: Clip::take(query)? })
    }
}

fn solids(query: &mut Query) -> Result<Option<SolidOptions>, String> {
    let kind = query.take("splats");
    let (size, opacity) = (query.number::<f64>("splat_size")?, query.number::<f32>("splat_opacity")?);
    let shape = match kind.as_deref() {
        None | Some("blended") if size.is_none() && opacity.is_none() => return Ok(None),
        None | Some("blended") => return Err("\"splat_size\" and \"splat_opacity\" go with splats=ellipsoids or splats=centres".into()),
        Some("ellipsoids") => Shape::Ellipsoids { deviations: in_range("splat_size", size.unwrap_or(1.0), 0.01, MAX_SIZE)? },
        Some("centres") => Shape::Centres { radius_px: in_range("splat_size", size.unwrap_or(1.0), 0.5, MAX_SIZE)? },
        Some(other) => return Err(format!("\"splats\" is \"{}\", expected blended, ellipsoids or centres", other.escape_default())),
    };
    let least_opacity = in_range("splat_opacity", opacity.unwrap_or(0.1).into(), 0.0, 1.0)? as f32;
    Ok(Some(SolidOptions { shape, least_opacity }))
}

fn in_range(name: &str, value: f64, low: f64, high: f64) -> Result<f64, String> {
    match (low..=high).contains(&value) {
        true => Ok(value),
        false => Err(format!("\"{name}\" is {value}, expected {low} to {high}")),
    }
}

impl Clip {
    fn take(query: &mut Query) -> Result<Option<Self>, String> {
        let (near, far) = (query.number::<f64>("near")?, query.number::<f64>("far")?);
        if near.is_none() && far.is_none() {
            return Ok(None);
        }
        let clip = Self { near: near.unwrap_or(0.0), far: far.unwrap_or(f64::MAX) };
        match clip.near >= 0.0 && clip.near < clip.far && clip.far.is_finite() {
            true => Ok(Some(clip)),
            false => Err(format!("clip planes at {} and {}, expected 0 <= near < far", clip.near, clip.far)),
        }
    }

    /// Returns the scene's splats whose centres are between the planes of a camera, which is in the
    /// scene's local coordinates.
    pub(crate) fn apply(self, scene: &Scene, camera: &Camera) -> Scene {
        let unit = scene.world_from_local.scale();
        let range = self.near / unit..=self.far / unit;
        let depth = |position: [f32; 3]| {
            let point = camera.camera_from_world.transform_point3(glam::DVec3::from_array(position.map(f64::from)));
            // As every depth: along the axis of a pinhole, else the distance.
            if camera.projection.is_pinhole() { point.z } else { point.length() }
        };
        let kept = (0u32..).zip(&scene.splats.position).filter(|(_, position)| range.contains(&depth(**position)));
        let splats = scene.splats.select(kept.map(|(i, _)| i));
        let edits = Vec::new();
        let luxel_core::Scene { radiance_scale, color_space, raster, world_from_local, metres_per_unit, .. } = **scene;
        luxel_core::Scene { splats, radiance_scale, color_space, raster, edits, world_from_local, metres_per_unit }.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn variant(text: &str) -> Result<Variant, String> {
        Variant::take(&mut Query::parse(text).unwrap(), 2)
    }

    #[test]
    fn parameters_make_a_variant() {
        assert_eq!(variant(""), Ok(Variant::default()));
        assert_eq!(variant("splats=blended&scene=1"), Ok(Variant { scene: 1, ..Variant::default() }));
        let ellipsoids = SolidOptions { shape: Shape::Ellipsoids { deviations: 2.0 }, least_opacity: 0.5 };
        assert_eq!(variant("splats=ellipsoids&splat_size=2&splat_opacity=0.5").unwrap().solids, Some(ellipsoids));
        assert_eq!(variant("near=0.5&far=3").unwrap().clip, Some(Clip { near: 0.5, far: 3.0 }));
    }

    #[test]
    fn what_is_wrong_is_said() {
        for (text, expected) in [
            ("scene=2", "below 2"),
            ("scene=x", "expected a number"),
            ("splats=cubes", "expected blended, ellipsoids or centres"),
            ("splat_size=2", "go with splats=ellipsoids"),
            ("splats=ellipsoids&splat_size=0", "expected 0.01 to 10"),
            ("splats=centres&splat_size=NaN", "expected 0.5 to 10"),
            ("splats=centres&splat_opacity=2", "expected 0 to 1"),
            ("near=2&far=1", "0 <= near < far"),
            ("near=-1", "0 <= near < far"),
            ("far=inf", "0 <= near < far"),
            ("near=NaN", "0 <= near < far"),
        ] {
            let error = variant(text).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn clip_planes_leave_out_centres() {
        let scene = luxel::synthetic::room(300, 1);
        let camera = luxel::synthetic::room_camera([40, 30]);
        let depth = |position: &[f32; 3]| camera.camera_from_world.transform_point3(glam::DVec3::from_array(position.map(f64::from))).z;
        let clipped = Clip { near: 1.0, far: 3.0 }.apply(&scene, &camera);
        let expected = scene.splats.position.iter().filter(|p| (1.0..=3.0).contains(&depth(p))).count();
        assert!(expected > 0 && expected < 300 && clipped.splats.len() == expected);
        // A panorama has depths behind it, too.
        let panorama = Camera::panorama(camera.camera_from_world, 64);
        let eye = camera.eye();
        let around =
            scene.splats.position.iter().filter(|p| (1.0..=3.0).contains(&(glam::DVec3::from_array(p.map(f64::from)) - eye).length()));
        assert_eq!(Clip { near: 1.0, far: 3.0 }.apply(&scene, &panorama).splats.len(), around.count());
    }
}
