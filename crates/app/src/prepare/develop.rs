//! One view: from photographs to radiance, its proxy for structure from motion, and its metrics.
//!
//! In: a [`PlannedView`]. Out: `work/radiance/NAME.exr` (float, in the data set's space),
//! `proxies/NAME.jpg` or a panorama's cut-outs, `work/saturation/NAME.png` (a mask, black where a
//! channel is saturated in every exposure; only where there are such pixels), and a [`ViewRecord`].
//! Degenerate: a frame that cannot be decoded is left out with a reason; a view without any frame
//! is an error, and the other views continue. A refusal of the system to read or write is not a
//! photograph's fault ([`is_system_error`]): nothing continues.

use std::path::Path;

use luxel::error::bail;
use luxel::{Error, Result};
use luxel_capture::panorama::{CutoutLens, Face, cut_out};
use luxel_capture::prepare::{
    CurveTables, LeftOut, Photograph, Plan, PlannedView, SetProjection, ViewRecord, conversion_from, developed_frame, raw_frame,
};
use luxel_capture::{CapturedFrame, Developed, Proxy, ProxyOptions, capture_metrics, frame_offset, merge, proxy};
use luxel_core::{ColorSpace, Conversion, Image};
use luxel_io::{
    DecodedImage, IoError, IoErrorKind, OcioSpace, Photo, PhotoKind, ReadOptions, Transfer, decode_image, decode_photo, decode_photo_layer,
    downscale, encode_jpeg, encode_png, write_exr,
};
use rayon::prelude::*;

use super::dataset::Pixels;
use super::folders::{Folders, proxy_name};
use super::pictures::cutout_name;
use super::state::key;
use crate::files::{remove_if_there, write_bytes};

/// Longest side of proxies. COLMAP reduces larger pictures itself.
const PROXY_SIDE_PX: usize = 3200;
/// JPEG quality of proxies: artefacts stay below what features react to.
const PROXY_QUALITY: u8 = 95;

/// The settings that all views share.
pub(super) struct Developer<'a> {
    pub(super) plan: &'a Plan,
    pub(super) photos: &'a [Photograph],
    pub(super) folders: &'a Folders,
    pub(super) tables: Option<&'a CurveTables>,
    pub(super) space: ColorSpace,
    pub(super) input_space: ColorSpace,
    /// Space of radiance files, whatever they state.
    pub(super) ocio: Option<&'a OcioSpace>,
    /// Curve of plates.
    pub(super) transfer: Option<Transfer>,
    /// Layer of OpenEXR files.
    pub(super) layer: Option<&'a str>,
    pub(super) downscale: u32,
    /// Digest of all settings that pixels depend on.
    pub(super) settings_key: String,
}

/// Size of a view's pictures for structure from motion.
struct PictureSize {
    size_px: [usize; 2],
    /// Factor by which each side is smaller than the view's.
    reduction: usize,
}

/// Pixels of a view, and statistics about them.
struct Light {
    image: Image,
    /// Pixels of which a channel is saturated in every exposure; empty for none.
    saturated: Vec<bool>,
    negative: usize,
    dark: f64,
    disagreeing: f64,
    offset_px: Option<f64>,
    left_out: Vec<LeftOut>,
}

impl Developer<'_> {
    /// Returns the key of a view: a digest of its inputs and settings.
    pub(super) fn key(&self, view: &PlannedView) -> String {
        let photos: Vec<&Photograph> = view.frames.iter().filter_map(|i| self.photos.get(*i)).collect();
        let exposures: Vec<String> = view.frames.iter().map(|i| format!("{:?}", self.photos.get(*i).and_then(|p| p.exposure))).collect();
        let mut parts: Vec<&str> = photos.iter().flat_map(|p| [p.stem.as_str(), p.digest.as_str()]).collect();
        parts.extend(exposures.iter().map(String::as_str));
        parts.push(&self.settings_key);
        parts.extend(photos.iter().filter_map(|p| p.info.raw.as_ref()).flat_map(|raw| &raw.applied).map(String::as_str));
        key(parts)
    }

    /// Returns the key of a proxy: a digest of its photographs and its size, but not of how it is
    /// developed.
    pub(super) fn picture_key(&self, view: &PlannedView, record: &ViewRecord) -> String {
        let digests = view.frames.iter().filter_map(|i| self.photos.get(*i)).map(|p| p.digest.as_str());
        key(digests.chain([format!("{:?}", record.proxy_px).as_str()]))
    }

    /// Returns the memory that a view takes while it is developed, bytes: codes of its frames, then
    /// floats of a few stages; of radiance one image of floats with its opacity, and files.
    pub(super) fn bytes_of(&self, view: &PlannedView) -> u64 {
        let pixels = view.frames.first().and_then(|i| self.photos.get(*i)).map_or(0, |p| {
            let [width, height] = p.info.size_px.map(u64::from);
            width * height
        });
        match self.plan.kind {
            PhotoKind::Radiance => pixels * 28,
            PhotoKind::Raw | PhotoKind::Developed => pixels * (9 * view.frames.len() as u64 + 56),
        }
    }

    /// Develops a view and writes its files.
    pub(super) fn develop(&self, view: &PlannedView) -> Result<ViewRecord> {
        let mut notes = Vec::new();
        let photos: Vec<&Photograph> = view.frames.iter().filter_map(|i| self.photos.get(*i)).collect();
        let Light { image, saturated, negative, dark, disagreeing, offset_px, left_out } = match self.plan.kind {
            PhotoKind::Radiance => self.radiance(&photos, &mut notes)?,
            PhotoKind::Raw | PhotoKind::Developed => self.merged(view, &photos)?,
        };
        let used: Vec<&Photograph> = photos.into_iter().filter(|p| !left_out.iter().any(|l| l.file == p.file_name())).collect();
        let pixels = image.pixels.len().max(1) as f64;
        let share = |n: usize| n as f64 / pixels;
        let saturated_share = share(saturated.iter().filter(|s| **s).count());
        let (image, saturated) = self.reduced(image, saturated);
        let picture = proxy(&image, &ProxyOptions { max_side_px: PROXY_SIDE_PX });
        let metrics = capture_metrics(&image, &picture);
        let pictures = self.write_pictures(&view.name, &image, &picture)?;
        let mask = self.folders.saturation(&view.name);
        if saturated_share > 0.0 {
            let rgb8: Vec<u8> = saturated.iter().flat_map(|s| [if *s { 0 } else { 255 }; 3]).collect();
            write_bytes(&mask, &encode_png(image.width, image.height, &rgb8)?)?;
        } else {
            remove_if_there(&mask)?;
        }
        write_exr(&self.folders.radiance(&view.name), &image, &self.pixels().exr_options())?;
        Ok(ViewRecord {
            name: view.name.clone(),
            key: self.key(view),
            files: used.iter().map(|p| p.file_name()).collect(),
            stops: used.iter().filter_map(|p| p.exposure).map(|e| e.stops()).collect(),
            camera: view.camera,
            size_px: [image.width, image.height],
            proxy_px: pictures.size_px,
            proxy_reduction: pictures.reduction,
            saturated: saturated_share,
            dark,
            negative: share(negative),
            disagreeing,
            offset_px,
            metrics,
            left_out,
            notes,
        })
    }

    /// Writes the pictures for structure from motion: `picture`, or cut-outs of a panorama.
    fn write_pictures(&self, view: &str, image: &Image, picture: &Proxy) -> Result<PictureSize> {
        let write = |name: &str, picture: &Proxy| {
            let bytes = encode_jpeg(picture.width, picture.height, &picture.rgb8, PROXY_QUALITY)?;
            write_bytes(&self.folders.output.join("proxies").join(name), &bytes)
        };
        match self.plan.projection {
            SetProjection::Pinhole => {
                write(&proxy_name(view), picture)?;
                Ok(PictureSize { size_px: [picture.width, picture.height], reduction: picture.reduction })
            }
            SetProjection::Equirectangular => {
                let lens = CutoutLens::for_width(image.width);
                for face in Face::ALL {
                    let picture = proxy(&cut_out(image, face, lens), &ProxyOptions { max_side_px: lens.side_px });
                    write(&cutout_name(face, lens.side_px, view), &picture)?;
                }
                Ok(PictureSize { size_px: [lens.side_px; 2], reduction: 1 })
            }
        }
    }

    /// Returns the names below `proxies/` of a view's pictures.
    pub(super) fn picture_names(&self, record: &ViewRecord) -> Vec<String> {
        match self.plan.projection {
            SetProjection::Pinhole => vec![proxy_name(&record.name)],
            SetProjection::Equirectangular => Face::ALL.map(|face| cutout_name(face, record.proxy_px[0], &record.name)).to_vec(),
        }
    }

    fn pixels(&self) -> Pixels {
        Pixels { space: self.space, is_absolute: self.plan.is_absolute }
    }

    /// Reduces image and mask by area average; a pixel of the mask is set if any of its parts is.
    fn reduced(&self, image: Image, saturated: Vec<bool>) -> (Image, Vec<bool>) {
        let factor = self.downscale as usize;
        if factor <= 1 {
            return (image, saturated);
        }
        let small = downscale(&image, factor);
        let is_any = |i: usize| {
            let (x, y) = (i % small.width * factor, i / small.width * factor);
            (y..y + factor).any(|y| (x..x + factor).any(|x| saturated.get(y * image.width + x).copied().unwrap_or(false)))
        };
        let saturated = (0..small.pixels.len()).map(is_any).collect();
        (small, saturated)
    }

    /// Reads a radiance file, and converts it to the data set's space.
    fn radiance(&self, photos: &[&Photograph], notes: &mut Vec<String>) -> Result<Light> {
        let [photo] = photos else { bail!("{} radiance files in one view, expected one", photos.len()) };
        let bytes = read(&photo.path)?;
        let mut decoded = match self.transfer {
            Some(transfer) => {
                let options = ReadOptions { transfer: Some(transfer), layer: self.layer.map(str::to_owned) };
                decode_image(&photo.path, &bytes, &options)?
            }
            None => match decode_photo_layer(&photo.path, &bytes, self.layer)? {
                Photo::Radiance(decoded) => decoded,
                Photo::Raw(_) | Photo::Developed { .. } => bail!("{}: changed while it was read", photo.path.display()),
            },
        };
        decoded.composite_over_black();
        let DecodedImage { mut image, color_space, warnings, .. } = decoded;
        notes.extend(warnings);
        match self.ocio {
            Some(space) => space.convert(&mut image, self.space)?,
            None => convert(&mut image, color_space.unwrap_or(self.input_space), self.space),
        }
        let negative = image.pixels.iter().filter(|p| p.iter().any(|v| *v < 0.0)).count();
        let pixels = image.pixels.len();
        if negative == pixels {
            notes.push(format!("{}: all {pixels} pixels have negative channels, which become 0", photo.file_name()));
        }
        // Stays as it is: a data set's reader masks it, whatever becomes of masks in files.
        let unfinite = image.pixels.iter().filter(|p| p.iter().any(|v| !v.is_finite())).count();
        if unfinite > 0 {
            notes.push(format!("{}: {unfinite} pixels are NaN or infinite; they stay so, and training masks them", photo.file_name()));
        }
        image.pixels.par_iter_mut().for_each(|p| *p = p.map(|v| if v < 0.0 { 0.0 } else { v }));
        // Light has no upper end.
        Ok(Light { image, saturated: Vec::new(), negative, dark: 0.0, disagreeing: 0.0, offset_px: None, left_out: Vec::new() })
    }

    /// Merges frames to radiance in the data set's space.
    fn merged(&self, view: &PlannedView, photos: &[&Photograph]) -> Result<Light> {
        let decoded: Vec<Result<CapturedFrame>> = photos.par_iter().map(|photo| self.frame(photo)).collect();
        let (mut frames, mut left_out) = (Vec::new(), Vec::new());
        for (photo, frame) in photos.iter().zip(decoded) {
            match frame {
                Ok(frame) => frames.push(frame),
                Err(error) if is_system_error(&error) => return Err(error),
                Err(error) => left_out.push(LeftOut { file: photo.file_name(), reason: error.to_string() }),
            }
        }
        if frames.is_empty() {
            let reasons: Vec<String> = left_out.iter().map(|l| format!("{}: {}", l.file, l.reason)).collect();
            bail!("none of its files can be decoded: {}", reasons.join("; "));
        }
        let offset_px = frames.windows(2).filter_map(|pair| frame_offset(&pair[0], &pair[1])).map(|o| o.length_px()).reduce(f64::max);
        let merged = merge(&frames)?;
        drop(frames);
        let samples = merged.radiance.len().max(1) as f64;
        let (dark, disagreeing) = (merged.dark as f64 / samples, merged.disagreeing as f64 / samples);
        let (gains, matrix) = match self.plan.cameras.get(view.camera).and_then(|c| c.color) {
            Some(color) => color,
            None => {
                let stated = photos.first().and_then(|p| p.info.primaries);
                let rows = conversion_from(stated, self.input_space, self.space).rows();
                ([1.0; 3], glam::DMat3::from_cols_array_2d(&rows).transpose())
            }
        };
        let developed = merged.develop(gains, &matrix);
        let Developed { image, saturated, negative } = developed;
        Ok(Light { image, saturated, negative, dark, disagreeing, offset_px, left_out })
    }

    /// Decodes a photograph to a frame of sensor samples with their exposure.
    fn frame(&self, photo: &Photograph) -> Result<CapturedFrame> {
        let bytes = read(&photo.path)?;
        let name = Path::new(photo.path.file_name().unwrap_or_default());
        let Some(exposure) = photo.exposure else { bail!("it has no exposure") };
        match (decode_photo(name, &bytes).map_err(|e| Error::new(e.message))?, self.tables) {
            (Photo::Raw(pixels), _) => {
                let info = photo.info.raw.clone().unwrap_or_default();
                match raw_frame(pixels, &info, &exposure) {
                    Some(frame) => Ok(frame),
                    None => bail!("its mosaic is no Bayer cell; develop it to OpenEXR"),
                }
            }
            (Photo::Developed { width, height, codes }, Some(tables)) => Ok(developed_frame([width, height], codes, tables, &exposure)),
            _ => bail!("changed while it was read"),
        }
    }
}

fn read(path: &Path) -> Result<Vec<u8>> {
    Ok(luxel_io::read_file(path)?)
}

/// Returns whether the system refused something that may succeed another time. Otherwise the
/// content of a file is to blame.
pub(super) fn is_system_error(error: &Error) -> bool {
    let is_refused = |error: &IoError| matches!(error.kind, IoErrorKind::System | IoErrorKind::NoRoom);
    error.find::<std::io::Error>().is_some() || error.find::<IoError>().is_some_and(is_refused)
}

/// Converts an image between colour spaces in place.
fn convert(image: &mut Image, from: ColorSpace, to: ColorSpace) {
    let conversion = Conversion::between(from, to);
    if !conversion.is_identity() {
        image.pixels.par_iter_mut().for_each(|p| *p = conversion.apply(*p));
    }
}
