//! Every reader of the crate, with files to begin with.

use std::path::{Path, PathBuf};

use luxel_core::{Camera, CameraProjection, Distortion};
use luxel_io::colmap::{ColmapFiles, parse_binary, parse_text};
use luxel_io::{
    IoError, PosedCamera, ReadOptions, Transfer, decode_camera_path, decode_checkpoint, decode_codes, decode_depth_map, decode_glb,
    decode_image, decode_mask, decode_photo, decode_pinhole_camera, decode_points_ply, decode_scene_ply, decode_sog, decode_spz,
    decode_tensors, decode_usd_cameras, decode_usda, decode_usdc, parse_exposures, parse_metashape, parse_polycam_camera,
    parse_poses_bounds, parse_realityscan_table, parse_realityscan_xmp, parse_record3d, parse_recorded_poses, parse_split,
    parse_transforms, photo_info,
};

use crate::{Reader, camera_seeds, seeds};

/// Stands between the files of a model of COLMAP.
pub(crate) const SEPARATOR: &[u8] = b"\n@@\n";

pub(crate) fn all() -> Vec<Reader> {
    vec![
        Reader { name: "exr", read: image, seeds: seeds::exr() },
        Reader { name: "hdr", read: image, seeds: seeds::hdr() },
        Reader { name: "tiff", read: image, seeds: seeds::tiff() },
        Reader { name: "png", read: image, seeds: seeds::png() },
        Reader { name: "jpeg", read: image, seeds: seeds::jpeg() },
        Reader { name: "npy", read: image, seeds: seeds::npy() },
        Reader { name: "codes", read: codes, seeds: [seeds::png(), seeds::tiff()].concat() },
        Reader { name: "mask", read: mask, seeds: seeds::png() },
        Reader { name: "dng", read: photo, seeds: seeds::dng() },
        Reader { name: "photo", read: photo, seeds: [seeds::jpeg(), seeds::tiff(), seeds::png()].concat() },
        Reader { name: "ply", read: |bytes| decode_scene_ply(name(), bytes).map(drop), seeds: seeds::ply() },
        Reader { name: "points", read: |bytes| decode_points_ply(name(), bytes).map(drop), seeds: seeds::ply() },
        Reader { name: "usd", read: |bytes| decode_usda(name(), bytes).map(drop), seeds: seeds::usd() },
        Reader { name: "usd_binary", read: |bytes| decode_usdc(name(), bytes).map(drop), seeds: seeds::usd_binary() },
        Reader { name: "glb", read: |bytes| decode_glb(name(), bytes).map(drop), seeds: seeds::glb() },
        Reader { name: "sog", read: |bytes| decode_sog(name(), bytes).map(drop), seeds: seeds::sog() },
        Reader { name: "spz", read: |bytes| decode_spz(name(), bytes).map(drop), seeds: seeds::spz() },
        Reader { name: "checkpoint", read: |bytes| decode_checkpoint(name(), bytes).map(drop), seeds: seeds::checkpoint() },
        Reader { name: "tensors", read: |bytes| decode_tensors(name(), bytes).map(drop), seeds: seeds::tensors() },
        Reader { name: "colmap_binary", read: colmap_binary, seeds: seeds::colmap_binary() },
        Reader { name: "colmap_text", read: colmap_text, seeds: seeds::colmap_text() },
        Reader { name: "transforms", read: transforms, seeds: seeds::transforms() },
        Reader { name: "camera_path", read: camera_path, seeds: seeds::camera_path() },
        Reader { name: "camera", read: |bytes| decode_pinhole_camera(name(), bytes).map(drop), seeds: seeds::camera() },
        Reader { name: "split", read: |bytes| parse_split(name(), bytes).map(drop), seeds: seeds::split() },
        Reader { name: "exposures", read: |bytes| parse_exposures(name(), bytes).map(drop), seeds: seeds::exposures() },
        Reader { name: "poses", read: |bytes| parse_recorded_poses(name(), bytes).map(drop), seeds: seeds::poses() },
        Reader { name: "poses_bounds", read: |bytes| parse_poses_bounds(name(), bytes).map(drop), seeds: camera_seeds::poses_bounds() },
        Reader {
            name: "realityscan_table",
            read: |bytes| valid(parse_realityscan_table(name(), bytes)?),
            seeds: camera_seeds::realityscan_table(),
        },
        Reader {
            name: "realityscan_xmp",
            read: |bytes| valid(parse_realityscan_xmp(name(), bytes)?),
            seeds: camera_seeds::realityscan_xmp(),
        },
        Reader { name: "metashape", read: |bytes| valid(parse_metashape(name(), bytes)?.cameras), seeds: camera_seeds::metashape() },
        Reader { name: "polycam", read: |bytes| valid([parse_polycam_camera(name(), bytes)?]), seeds: camera_seeds::polycam() },
        Reader { name: "record3d", read: |bytes| valid(parse_record3d(name(), bytes)?), seeds: camera_seeds::record3d() },
        Reader { name: "usd_cameras", read: usd_cameras, seeds: camera_seeds::usd() },
        Reader { name: "depth", read: |bytes| decode_depth_map(name(), bytes).map(drop), seeds: camera_seeds::depth() },
    ]
}

fn name() -> &'static Path {
    Path::new("input")
}

fn image(bytes: &[u8]) -> Result<(), IoError> {
    decode_image(name(), bytes, &ReadOptions { transfer: Some(Transfer::Linear), layer: None }).map(drop)
}

fn codes(bytes: &[u8]) -> Result<(), IoError> {
    decode_codes(name(), bytes).map(drop)
}

fn mask(bytes: &[u8]) -> Result<(), IoError> {
    decode_mask(name(), bytes, [seeds::WIDTH, seeds::HEIGHT]).map(drop)
}

fn photo(bytes: &[u8]) -> Result<(), IoError> {
    let info = photo_info(name(), bytes);
    decode_photo(name(), bytes)?;
    info.map(drop)
}

/// Splits the three files of a model.
fn colmap(bytes: &[u8], extension: &str) -> (ColmapFiles<PathBuf>, ColmapFiles<Vec<u8>>) {
    let mut rest = bytes;
    let mut next = || {
        let end = rest.windows(SEPARATOR.len()).position(|window| window == SEPARATOR);
        let (file, after) = end.map_or((rest, &[][..]), |end| (&rest[..end], &rest[end + SEPARATOR.len()..]));
        rest = after;
        file.to_vec()
    };
    let file = |stem: &str| PathBuf::from(format!("{stem}.{extension}"));
    let paths = ColmapFiles { cameras: file("cameras"), images: file("images"), points: file("points3D") };
    (paths, ColmapFiles { cameras: next(), images: next(), points: next() })
}

fn colmap_binary(bytes: &[u8]) -> Result<(), IoError> {
    let (paths, files) = colmap(bytes, "bin");
    parse_binary(&paths, &files).map(drop)
}

fn colmap_text(bytes: &[u8]) -> Result<(), IoError> {
    let (paths, files) = colmap(bytes, "txt");
    parse_text(&paths, &files).map(drop)
}

fn transforms(bytes: &[u8]) -> Result<(), IoError> {
    for frame in parse_transforms(name(), bytes)?.frames {
        let size = frame.size_px().unwrap_or([640, 480]);
        if let Ok(camera) = frame.camera(size) {
            assert_eq!(camera.validate(), Ok(()));
        }
    }
    Ok(())
}

fn camera_path(bytes: &[u8]) -> Result<(), IoError> {
    let default = Camera {
        camera_from_world: glam::DAffine3::IDENTITY,
        focal_px: glam::DVec2::new(300.0, 310.0),
        center_px: glam::DVec2::new(201.0, 149.0),
        size_px: [400, 300],
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    };
    for camera in decode_camera_path(name(), bytes, Some(&default))? {
        assert_eq!(camera.camera.validate(), Ok(()));
    }
    Ok(())
}

/// Whatever can be used is valid.
fn valid(cameras: impl IntoIterator<Item = PosedCamera>) -> Result<(), IoError> {
    for camera in cameras {
        if let Ok(seen) = camera.camera([640, 480]) {
            assert_eq!(seen.validate(), Ok(()));
        }
    }
    Ok(())
}

fn usd_cameras(bytes: &[u8]) -> Result<(), IoError> {
    let layer = decode_usd_cameras(name(), bytes)?;
    for time in [None, Some(0.0), Some(1.5)] {
        assert!(layer.eyes_at(time).iter().all(|eye| eye.is_finite()));
    }
    Ok(())
}
