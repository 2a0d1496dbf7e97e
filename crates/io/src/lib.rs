//! Reads and writes files: images, data sets, scenes, checkpoints.
//!
//! Every file is treated as hostile: truncated, huge, cyclic, NaN. The answer is an [`IoError`]
//! that names file, place, expected and found; no panic, no unbounded allocation.

mod arrays;
mod atomic;
mod bake;
mod byte_order_mark;
mod camera_path;
mod camera_writer;
mod checkpoint;
mod confine;
mod dataset;
mod depth;
mod error;
mod gltf;
mod icc;
mod image;
mod input;
mod joined;
mod lens;
mod lights;
mod local_frame;
mod memory;
mod mesh;
#[cfg(feature = "ocio")]
mod ocio;
#[cfg(not(feature = "ocio"))]
#[path = "ocio/absent.rs"]
mod ocio;
mod photo;
mod pinhole;
mod ply;
mod read_file;
mod scene_file;
mod sog;
mod splat_model;
mod spz;
mod tags;
mod tensors;
mod usd;
mod validity;

pub use self::ocio::{OcioDisplay, OcioSpace};
pub use arrays::{Arrays, NamedArray, decode_arrays, encode_arrays, holds_arrays, read_arrays, write_arrays};
pub use atomic::{WriteSeek, is_unfinished_name, notice_written, remove_unfinished, sweep_unfinished, write_atomically, write_bytes};
pub use bake::{Appearance, BakeOptions, Baked, MIDDLE_GREY, display_exposure};
pub use camera_path::{PathCamera, decode_camera_path, read_camera_path};
pub use camera_writer::{camera_file_text, lens_fields, write_cameras};
pub use checkpoint::{
    CheckpointFile, checkpoint_path, decode_checkpoint, encode_checkpoint, list_checkpoints, prune_checkpoints, read_checkpoint,
    write_checkpoint,
};
pub use confine::{Confinement, check_within, confine};
pub use dataset::{
    AUTO_SIDE_PX, BLOCK_FILE, Block, BoundedPose, CheckPlan, ChosenDownscale, DatasetDescription, DatasetFormat, Downscale, Exposures,
    GroundRange, ImageMemory, ImagePlan, KeepView, LoadOptions, LoadProgress, Loading, MAX_DOWNSCALE, MAX_RELATIVE_ERROR, MaskSource,
    MemoryDataset, MemoryPoint, MemoryView, MetashapeCameras, PosedCamera, RecordedPose, SplitLists, Supervision, Transforms,
    TransformsFrame, UnknownFormat, VIEWS_IN_USE, ViewPlace, choose_downscale, colmap, composed, dataset_in_memory, decode_mask,
    describe_dataset, detect_format, load_dataset, load_dataset_within, parse_block, parse_exposures, parse_metashape,
    parse_polycam_camera, parse_poses_bounds, parse_realityscan_table, parse_realityscan_xmp, parse_record3d, parse_recorded_poses,
    parse_split, parse_transforms, prepared_metres_per_unit, sees,
};
pub use depth::{DepthFolder, DepthKind, DepthMap, DepthReport, decode_depth_map, find_depth};
pub use error::{IoError, IoErrorKind};
pub use gltf::{decode_glb, encode_glb, read_glb, write_glb};
pub use image::{
    DecodedImage, DisplayCurve, DisplayEncoding, DisplayPrimaries, ExrAttributes, ExrOptions, ExrPlane, ExrSample, HALF_MAX, LightLevels,
    PlaneValues, ReadOptions, SampleDepth, Transfer, color_interop_id, decode_codes, decode_image, downscale, downscale_masked,
    encode_deep_exr, encode_exr, encode_jpeg, encode_png, encode_png_pq, holds_radiance, image_size, pinhole_within, read_codes,
    read_exr_attributes, read_image, undistort, undistort_into, write_deep_exr, write_display_png, write_exr, write_png,
};
pub use lights::{
    LightMesh, LightShape, StageDome, StageLight, StageLights, StagePortal, encode_lights_glb, stage_lights_text, write_lights,
};
pub use luxel_core::photo::{Codes, Exif, IccProfile, PhotoInfo, PhotoKind, RawInfo, RawPixels};
pub use memory::{available_memory, given_memory_limit, memory_limit, set_memory_limit, system_memory};
pub use mesh::{MeshFile, MeshFormat, write_mesh};
pub use photo::{Photo, decode_photo, decode_photo_layer, is_photo_name, photo_info};
pub use pinhole::{decode_pinhole_camera, read_pinhole_camera};
pub use ply::{
    PlyCloud, PlyPoint, decode_points_ply, decode_scene_ply, encode_baked_ply, encode_scene_ply, read_points_ply, read_scene_ply,
    write_baked_ply, write_exact_ply, write_scene_ply,
};
pub use read_file::{open_regular, read_file, read_text};
pub use scene_file::{SceneFile, SceneFormat, read_scene, read_scene_file};
pub use sog::{decode_sog, encode_sog, read_sog, sog_positions, write_sog};
pub use spz::{SpzPositions, SpzVersion, decode_spz, encode_spz, read_spz, spz_out_of_range, spz_positions, write_spz};
pub use tensors::{Tensors, decode_tensors, read_tensors};
pub use usd::{
    PackagedFile, StageCameras, StageChoice, StageMotion, UsdCameras, decode_stage_cameras, decode_usd_cameras, decode_usda, decode_usdc,
    encode_usda, encode_usdc, is_usd, read_usda, stage_cameras_text, write_stage_cameras, write_usda, write_usdc, write_usdz,
};

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
