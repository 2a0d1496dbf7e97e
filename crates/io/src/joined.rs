//! Scenes of several parts in one file, each where its transform puts it.
//!
//! In: the parts of a file of another program, with the transform of each to the file's world. Out:
//! one scene in the local coordinates that suit all of them. Harmonics of lower degree are those of
//! the highest with zeros. Degenerate: no parts are no scene; parts of different colours, rasterisers
//! or models cannot be one scene and are an error.

use glam::{DMat3, DMat4, DQuat, DVec3};
use luxel_core::{ColorModel, Scene, SceneBounds, Similarity, Splats, sh};

use crate::local_frame::{samples, settle};

/// How far the numbers of a rotation's matrix may be off: files round them to a few digits.
const MATRIX_TOLERANCE: f64 = 1e-3;

/// Most parts of a file: one reached by many ways is read as often, and takes memory each time.
pub(crate) const MAX_PARTS: usize = 64;

/// Returns a matrix as a similarity; the error says what splats cannot follow.
pub(crate) fn similarity(matrix: DMat4) -> Result<Similarity, String> {
    if matrix == DMat4::IDENTITY {
        return Ok(Similarity::IDENTITY);
    }
    let linear = DMat3::from_mat4(matrix);
    let scale = linear.determinant().cbrt();
    let rotation = linear * (1.0 / scale);
    // Matrices are written with few digits: the rotation next to it is meant.
    let next = DMat3::from_quat(DQuat::from_mat3(&rotation).normalize());
    let similarity = next.abs_diff_eq(rotation, MATRIX_TOLERANCE).then(|| Similarity::new(next, scale, matrix.w_axis.truncate()));
    similarity.flatten().ok_or_else(|| {
        "a transform shears, mirrors or scales its splats unevenly, which is not supported; apply it in the program the file is from".into()
    })
}

/// Returns the local coordinates that suit splats together, which `moved` takes to the world.
pub(crate) fn suitable<'a>(parts: impl Iterator<Item = (&'a Splats, &'a Similarity)>) -> Similarity {
    let points: Vec<DVec3> = parts.flat_map(|(splats, moved)| samples(splats, None, moved)).collect();
    SceneBounds::from_points(&points).map_or(Similarity::IDENTITY, |bounds| bounds.world_from_local())
}

/// Joins parts of a file of another program; `None` for no parts.
pub(crate) fn settle_together(mut parts: Vec<(Scene, Similarity)>) -> Result<Option<Scene>, String> {
    let frame = suitable(parts.iter().map(|(scene, moved)| (&scene.splats, moved)));
    for (scene, moved) in &mut parts {
        settle(scene, None, moved, frame);
    }
    join(parts.into_iter().map(|(scene, _)| scene).collect())
}

/// Joins scenes in the same local coordinates; `None` for no scenes.
pub(crate) fn join(scenes: Vec<Scene>) -> Result<Option<Scene>, String> {
    let degree_of = |scene: &Scene| if let ColorModel::Sh { degree } = scene.splats.color_model { Some(degree) } else { None };
    let degree = scenes.iter().map(degree_of).collect::<Option<Vec<u8>>>().and_then(|degrees| degrees.into_iter().max());
    let mut scenes = scenes.into_iter().map(|mut scene| {
        if let Some(degree) = degree {
            raise(&mut scene.splats, degree);
        }
        scene
    });
    let Some(mut all) = scenes.next() else { return Ok(None) };
    for scene in scenes {
        let differs = [
            ("colour models", scene.splats.color_model != all.splats.color_model),
            ("smoothing filters", scene.splats.smoothing.is_empty() != all.splats.smoothing.is_empty()),
            ("colour spaces", (scene.radiance_scale, scene.color_space) != (all.radiance_scale, all.color_space)),
            ("raster settings", scene.raster != all.raster),
            ("origins", scene.world_from_local != all.world_from_local),
        ];
        if let Some((what, _)) = differs.into_iter().find(|(_, differs)| *differs) {
            return Err(format!("several parts of splats with different {what}, expected the same; export them apart"));
        }
        all.splats.append(scene.splats);
    }
    Ok(Some(all))
}

/// Gives harmonics of radiance a higher degree.
fn raise(splats: &mut Splats, degree: u8) {
    let (from, to) = (3 * splats.color_model.sh_coefficients(), 3 * sh::coefficients(degree.into()));
    if from == to {
        return;
    }
    let mut raised = vec![0.0; splats.len() * to];
    for (to, from) in raised.chunks_exact_mut(to).zip(splats.sh.chunks_exact(from)) {
        to[..from.len()].copy_from_slice(from);
    }
    splats.sh = raised;
    splats.color_model = ColorModel::Sh { degree };
}
