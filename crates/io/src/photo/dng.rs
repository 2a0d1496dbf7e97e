//! DNG (Adobe's specification 1.7): Bayer mosaics and LinearRaw, among them Apple ProRAW.
//!
//! In: bytes. Out: [`RawPixels`]; colours by the tags are in [`super::dng_info`]. Codes are
//! as stored, cropped to the default crop, after the linearisation table if there is one; black and
//! white come beside them, and corrections of the lens ([`super::dng_corrections`]). Uncompressed
//! samples of 8 to 16 bits, lossless JPEG and JPEG XL, in strips or tiles; rows and columns that
//! are stored in fields are put where they belong.
//!
//! JPEG XL of more than 8 bits comes on the scale of 16 bits, whatever its depth: levels and the
//! table of such files are on that scale, as Adobe's SDK decodes them.

use luxel_core::photo::{CropRect, Exif, RawCorrections, RawPixels};
use rayon::prelude::*;

use super::dng_corrections::{Plan, PlanError, correct_linear, correct_stored};
use super::dng_packing::{place_in_fields, unpack};
use super::dng_samples::Samples;
use super::dng_tags as tag;
use super::exif::exif_of_tags;
use super::{jpeg_xl, lossless_jpeg};
use crate::IoError;
use crate::image::guard::contain;
use crate::input::Input;
use crate::tags::{Ifd, Tags};

/// Directories that are looked through.
const MAX_IFDS: usize = 32;

/// A file whose tags were read.
pub(super) struct Dng<'a> {
    tags: Tags<'a>,
    pub(super) first: Ifd<'a>,
    pub(super) image: Ifd<'a>,
    input: Input<'a>,
}

/// LinearRaw: colours without a mosaic.
const LINEAR_RAW: usize = 34892;
/// A mosaic.
const CFA: usize = 32803;
/// Compressions.
const UNCOMPRESSED: usize = 1;
const LOSSLESS_JPEG: usize = 7;
const LOSSY_JPEG: usize = 34892;
const JPEG_XL: usize = 52546;

impl<'a> Dng<'a> {
    /// Opens a file; `None` if it is not a DNG.
    pub(super) fn open(input: Input<'a>) -> Option<Result<Self, IoError>> {
        let tags = Tags::new(input.bytes)?;
        let first = tags.first().filter(|ifd| ifd.has(tag::DNG_VERSION))?;
        let found = largest_raw_image(&tags, &first).ok_or_else(|| {
            input.invalid("DNG: no mosaic or LinearRaw image in it; it is damaged or a preview only, copy or export it again")
        });
        Some(found.map(|image| Self { tags, first, image, input }))
    }

    pub(super) fn exif(&self) -> Exif {
        exif_of_tags(&self.tags, &self.first)
    }

    /// Returns the size of the default crop.
    pub(super) fn size(&self) -> Result<[u32; 2], IoError> {
        let crop = self.crop()?;
        Ok([crop.width as u32, crop.height as u32])
    }

    pub(super) fn invalid(&self, message: impl std::fmt::Display) -> IoError {
        self.input.invalid(format!("DNG: {message}; the file is damaged, copy or export it again"))
    }

    pub(super) fn unsupported(&self, message: impl std::fmt::Display) -> IoError {
        self.input.unsupported(format!("DNG: {message}; convert it with a DNG converter, or develop it to OpenEXR"))
    }

    fn stored_size(&self) -> Result<[usize; 2], IoError> {
        let [width, height] = [tag::WIDTH, tag::HEIGHT].map(|t| self.image.unsigned(t).unwrap_or(0));
        self.input.check_size([width as u64, height as u64])?;
        Ok([width, height])
    }

    /// Returns the active area, in stored pixels.
    fn active_area(&self) -> Result<Crop, IoError> {
        let [width, height] = self.stored_size()?;
        let area = self.image.unsigneds(tag::ACTIVE_AREA).and_then(|v| <[usize; 4]>::try_from(v).ok());
        let [top, left, bottom, right] = area.unwrap_or([0, 0, height, width]);
        let crop = self.crop()?;
        let holds_crop = right >= crop.left + crop.width && bottom >= crop.top + crop.height;
        if !holds_crop || right > width || bottom > height {
            let area = format!("rows {top} to {bottom}, columns {left} to {right}");
            return Err(self.invalid(format_args!("an active area of {area} in an image of {width} x {height}, or a crop beyond it")));
        }
        Ok(Crop { left, top, width: right - left, height: bottom - top, area: [left, top] })
    }

    /// Returns the default crop within the active area, in stored pixels.
    fn crop(&self) -> Result<Crop, IoError> {
        let [width, height] = self.stored_size()?;
        let area = self.image.unsigneds(tag::ACTIVE_AREA).and_then(|v| <[usize; 4]>::try_from(v).ok());
        let [top, left, bottom, right] = area.unwrap_or([0, 0, height, width]);
        let pair = |t| self.image.numbers(t).and_then(|v| <[f64; 2]>::try_from(v).ok()).map(|v| v.map(|x| x.round().max(0.0) as usize));
        let [x, y] = pair(tag::CROP_ORIGIN).unwrap_or([0, 0]);
        let [crop_width, crop_height] = pair(tag::CROP_SIZE).unwrap_or([right.saturating_sub(left + x), bottom.saturating_sub(top + y)]);
        let fits = |start: usize, length: usize, end: usize| length > 0 && start.checked_add(length).is_some_and(|e| e <= end);
        let crop =
            Crop { left: left.saturating_add(x), top: top.saturating_add(y), width: crop_width, height: crop_height, area: [left, top] };
        if !(fits(crop.left, crop_width, width) && fits(crop.top, crop_height, height)) {
            return Err(self.invalid(format_args!("a crop of {crop_width} x {crop_height} pixels in an image of {width} x {height}")));
        }
        Ok(crop)
    }

    pub(super) fn is_mosaic(&self) -> bool {
        self.image.unsigned(tag::PHOTOMETRIC) == Some(CFA)
    }

    /// Decodes the image.
    pub(super) fn pixels(&self) -> Result<RawPixels, IoError> {
        let plan = self.plan()?;
        let size = self.stored_size()?;
        let default_crop = self.crop()?;
        // A warp takes pixels from beyond the crop.
        let crop = if plan.steps.is_empty() { self.crop()? } else { self.active_area()? };
        let image = &self.image;
        let per_pixel = image.unsigned(tag::SAMPLES_PER_PIXEL).unwrap_or(1);
        let is_mosaic = self.is_mosaic();
        if per_pixel != if is_mosaic { 1 } else { 3 } || image.unsigned(tag::PLANAR).unwrap_or(1) != 1 {
            return Err(self.unsupported(format_args!("{per_pixel} samples per pixel, or in separate planes")));
        }
        if image.unsigned(tag::SAMPLE_FORMAT).unwrap_or(1) != 1 {
            return Err(self.unsupported("floating-point samples"));
        }
        let bits = image.unsigned(tag::BITS).unwrap_or(16);
        if !(8..=16).contains(&bits) {
            return Err(self.unsupported(format_args!("{bits} bits per sample, expected 8 to 16")));
        }
        self.refuse_orders()?;
        let stored_cell = if is_mosaic { Some(self.cell()?) } else { None };
        let turn = |cell: [u8; 4], by: [usize; 2]| [0, 1, 2, 3].map(|i| cell[((i / 2 + by[1]) % 2) * 2 + (i % 2 + by[0]) % 2]);
        let mut stored = self.without_fields(self.read_chunks(size, per_pixel, bits)?, size, per_pixel)?;
        let cell = stored_cell.map(|cell| turn(cell, crop.area));
        let samples = Samples { codes: &mut stored, width: size[0], per_pixel, origin: [0, 0], cell };
        correct_stored(self.input, &plan, samples)?;
        let mut codes = self.input.zeroed::<u16>(crop.width * crop.height * per_pixel)?;
        let row = crop.width * per_pixel;
        for (y, out) in codes.chunks_exact_mut(row).enumerate() {
            let start = ((crop.top + y) * size[0] + crop.left) * per_pixel;
            out.copy_from_slice(stored.get(start..start + row).unwrap_or_default());
        }
        drop(stored);
        if let Some(table) = image.unsigneds(tag::LINEARIZATION).filter(|t| !t.is_empty()) {
            let last = table.last().copied().unwrap_or(0);
            codes.iter_mut().for_each(|c| *c = table.get(usize::from(*c)).copied().unwrap_or(last).min(65535) as u16);
        }
        // Black is given from the active area's corner on, the cell too, and both turn with the
        // crop's.
        let shift = [crop.left - crop.area[0], crop.top - crop.area[1]];
        let order = turn([0, 1, 2, 3], if is_mosaic { shift } else { [0, 0] });
        let black = self.black(per_pixel);
        let largest = if self.compression() == JPEG_XL { jpeg_xl::largest_code(bits) } else { (1 << bits) - 1 };
        let white = image.number(tag::WHITE).unwrap_or(largest.into()) as f32;
        let read = ReadArea { width: crop.width, shift, per_pixel };
        let added = self.subtract_black_deltas(&mut codes, read, white).map_err(|message| self.invalid(message))?;
        let mut black = order.map(|i| black[usize::from(i)]);
        black.iter_mut().zip(added).for_each(|(level, added)| *level += added);
        if !(black.iter().all(|b| b.is_finite() && *b < white)) {
            return Err(self.invalid(format_args!("black {black:?} is not below white {white}")));
        }
        let cell = stored_cell.map(|cell| turn(cell, shift));
        let mut pixels = RawPixels { width: crop.width, height: crop.height, cell, codes, black, white, corrections: None };
        correct_linear(&plan, &mut pixels, shift);
        pixels.corrections = self.corrections(plan, shift, &default_crop)?;
        Ok(pixels)
    }

    /// Reads the opcode lists.
    pub(super) fn plan(&self) -> Result<Plan, IoError> {
        Plan::new(tag::OPCODE_LISTS.map(|tag| self.image.bytes(tag)), self.is_mosaic()).map_err(|error| match error {
            PlanError::Damaged(message) => self.invalid(message),
            PlanError::Unknown(message) => self.unsupported(message),
        })
    }

    /// Returns what is left for after the samples were read; `origin_px` is the place of the first
    /// one in the active area.
    fn corrections(&self, plan: Plan, origin_px: [usize; 2], crop: &Crop) -> Result<Option<RawCorrections>, IoError> {
        let Plan { gains, steps, .. } = plan;
        if gains.is_empty() && steps.is_empty() {
            return Ok(None);
        }
        let area = self.active_area()?;
        let (left, top) = (crop.left - area.left - origin_px[0], crop.top - area.top - origin_px[1]);
        let crop = CropRect { left, top, width: crop.width, height: crop.height };
        Ok(Some(RawCorrections { area_px: [area.width, area.height], origin_px, gains, steps, crop }))
    }

    fn compression(&self) -> usize {
        self.image.unsigned(tag::COMPRESSION).unwrap_or(UNCOMPRESSED)
    }

    /// Refuses orders and differences of samples that are not undone.
    fn refuse_orders(&self) -> Result<(), IoError> {
        let block = self.image.unsigneds(tag::SUB_TILE_BLOCK_SIZE).unwrap_or_default();
        if block.iter().any(|side| *side != 1) {
            return Err(self.unsupported(format_args!("samples in blocks of {block:?} within tiles")));
        }
        let predictor = self.image.unsigned(tag::PREDICTOR).unwrap_or(1);
        if predictor != 1 && self.compression() == UNCOMPRESSED {
            return Err(self.unsupported(format_args!("uncompressed samples with predictor {predictor}, expected 1 (none)")));
        }
        Ok(())
    }

    /// Restores the order of rows and columns that are stored in fields (all first rows of a cell,
    /// then all second ones), as a mosaic's colours are for JPEG XL, in the image's order.
    fn without_fields(&self, stored: Vec<u16>, [width, height]: [usize; 2], per_pixel: usize) -> Result<Vec<u16>, IoError> {
        let fields = |tag, length| Some(self.image.unsigned(tag).unwrap_or(1)).filter(|n| (1..length).contains(n)).unwrap_or(1);
        let (rows, columns) = (fields(tag::ROW_INTERLEAVE, height), fields(tag::COLUMN_INTERLEAVE, width));
        if (rows, columns) == (1, 1) {
            return Ok(stored);
        }
        let from_x: Vec<usize> = (0..width).map(|x| place_in_fields(x, columns, width) * per_pixel).collect();
        let mut out = self.input.zeroed::<u16>(stored.len())?;
        let row = width * per_pixel;
        for (y, out) in out.chunks_exact_mut(row).enumerate() {
            let from = stored.get(place_in_fields(y, rows, height) * row..).unwrap_or_default();
            for (out, &x) in out.chunks_exact_mut(per_pixel).zip(&from_x) {
                out.copy_from_slice(from.get(x..x + per_pixel).unwrap_or_default());
            }
        }
        Ok(out)
    }

    /// Returns the colours of the 2x2 cell at the active area's corner.
    fn cell(&self) -> Result<[u8; 4], IoError> {
        let repeat = self.image.unsigneds(tag::CFA_REPEAT).unwrap_or_else(|| vec![2, 2]);
        let pattern = self.image.bytes(tag::CFA_PATTERN).unwrap_or_default();
        match <[u8; 4]>::try_from(pattern) {
            Ok(cell) if repeat == [2, 2] && cell.iter().all(|c| *c < 3) => Ok(cell),
            _ => {
                Err(self
                    .unsupported(format_args!("a mosaic of {repeat:?} pixels with colours {pattern:?}, expected a Bayer cell of 2 x 2")))
            }
        }
    }

    /// Returns the black levels, by place in the cell or by channel.
    fn black(&self, per_pixel: usize) -> [f32; 4] {
        let values: Vec<f32> = self.image.numbers(tag::BLACK).unwrap_or_default().iter().map(|v| *v as f32).collect();
        let repeat = self.image.unsigneds(tag::BLACK_REPEAT).unwrap_or_else(|| vec![1, 1]);
        let (rows, columns) = (repeat.first().copied().unwrap_or(1).max(1), repeat.get(1).copied().unwrap_or(1).max(1));
        [0, 1, 2, 3].map(|i| {
            let at = if per_pixel == 1 { (i / 2 % rows) * columns + i % 2 % columns } else { i };
            values.get(at).or(values.first()).copied().unwrap_or(0.0)
        })
    }

    /// Reads all samples as stored.
    fn read_chunks(&self, [width, height]: [usize; 2], per_pixel: usize, bits: usize) -> Result<Vec<u16>, IoError> {
        let image = &self.image;
        let is_tiled = image.has(tag::TILE_OFFSETS);
        let (chunk_width, chunk_height) = if is_tiled {
            (image.unsigned(tag::TILE_WIDTH).unwrap_or(0), image.unsigned(tag::TILE_HEIGHT).unwrap_or(0))
        } else {
            (width, image.unsigned(tag::ROWS_PER_STRIP).unwrap_or(height).min(height))
        };
        // A tile may be larger than the image, but not larger than what its file can plausibly
        // hold.
        let [tile_width, tile_height] = [chunk_width as u64, chunk_height as u64];
        let tile_bytes = tile_width.saturating_mul(tile_height).saturating_mul((per_pixel * size_of::<u16>()) as u64);
        let size_of_tile = self.input.check_size([tile_width, tile_height]);
        // Flat tiles of JPEG XL take next to nothing.
        let is_block = self.compression() == JPEG_XL || self.input.check_block(tile_bytes).is_ok();
        if size_of_tile.is_err() || !is_block {
            let file_bytes = self.input.length();
            return Err(self.invalid(format_args!("tiles of {chunk_width} x {chunk_height} pixels in a file of {file_bytes} bytes")));
        }
        let tags = if is_tiled { [tag::TILE_OFFSETS, tag::TILE_BYTES] } else { [tag::STRIP_OFFSETS, tag::STRIP_BYTES] };
        let [offsets, lengths] = tags.map(|t| image.unsigneds(t).unwrap_or_default());
        let across = width.div_ceil(chunk_width);
        let expected = across * height.div_ceil(chunk_height);
        if offsets.len() != expected || lengths.len() != expected {
            return Err(self.invalid(format_args!("{} tiles of {} lengths, expected {expected}", offsets.len(), lengths.len())));
        }
        let row = width * per_pixel;
        let mut out = self.input.zeroed::<u16>(row * height)?;
        let chunk = Chunk { width: chunk_width, height: chunk_height, per_pixel, bits };
        out.par_chunks_mut(row * chunk_height).enumerate().try_for_each(|(down, band)| {
            let rows = band.len() / row;
            for (i, (&offset, &length)) in offsets.iter().zip(&lengths).enumerate().skip(down * across).take(across) {
                let bytes =
                    self.tags.slice(offset, length).ok_or_else(|| self.invalid(format_args!("tile {i} lies outside of the file")))?;
                let samples = contain(self.input.name, || self.decode_chunk(i, bytes, chunk, rows))?;
                let left = (i - down * across) * chunk_width * per_pixel;
                let wanted = (row - left).min(chunk_width * per_pixel);
                for (y, out) in band.chunks_exact_mut(row).enumerate() {
                    let from = samples.get(y * chunk_width * per_pixel..).and_then(|s| s.get(..wanted));
                    let from = from.ok_or_else(|| self.invalid(format_args!("tile {i} has too few samples")))?;
                    out[left..left + wanted].copy_from_slice(from);
                }
            }
            Ok(())
        })?;
        Ok(out)
    }

    /// Returns the samples of a strip or tile; of `rows` rows at least.
    fn decode_chunk(&self, i: usize, bytes: &[u8], chunk: Chunk, rows: usize) -> Result<Vec<u16>, IoError> {
        let row = chunk.width * chunk.per_pixel;
        match self.compression() {
            UNCOMPRESSED => unpack(bytes, row, rows, chunk.bits, self.tags.is_big_endian())
                .ok_or_else(|| self.invalid(format_args!("tile {i} is cut short"))),
            LOSSLESS_JPEG => {
                if let Some(bits) = lossless_jpeg::dct_precision(bytes) {
                    return Err(self.unsupported(format_args!("tiles of lossy JPEG (DCT) of {bits} bits, as compressed CinemaDNG has")));
                }
                let decoded = lossless_jpeg::decode(bytes, row * chunk.height).map_err(|e| self.invalid(format_args!("tile {i}: {e}")))?;
                if decoded.row != row || decoded.rows < rows {
                    return Err(self.invalid(format_args!("tile {i}: {} x {} samples, expected {row} x {rows}", decoded.row, decoded.rows)));
                }
                Ok(decoded.samples)
            }
            JPEG_XL => {
                let size = [chunk.width, chunk.height];
                jpeg_xl::decode(bytes, size, chunk.per_pixel).map_err(|e| self.invalid(format_args!("tile {i}: {e}")))
            }
            LOSSY_JPEG => Err(self.unsupported("lossy JPEG tiles of 8 bits")),
            other => Err(self.unsupported(format_args!("compression {other}, expected none, lossless JPEG (7) or JPEG XL (52546)"))),
        }
    }
}

/// Part of the stored image that counts.
struct Crop {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
    /// Left and top of the active area.
    area: [usize; 2],
}

/// The part of the active area whose codes are read.
#[derive(Clone, Copy)]
pub(super) struct ReadArea {
    /// Width of it, pixels.
    pub(super) width: usize,
    /// Columns and rows of the active area before it.
    pub(super) shift: [usize; 2],
    /// Samples per pixel.
    pub(super) per_pixel: usize,
}

/// Shape of strips and tiles.
#[derive(Clone, Copy)]
struct Chunk {
    width: usize,
    height: usize,
    per_pixel: usize,
    bits: usize,
}

fn largest_raw_image<'a>(tags: &Tags<'a>, first: &Ifd<'a>) -> Option<Ifd<'a>> {
    let mut candidates = vec![first.clone()];
    let below = first.unsigneds(tag::SUB_IFDS).unwrap_or_default();
    candidates.extend(below.iter().take(MAX_IFDS).filter_map(|at| tags.ifd(*at)));
    let mut next = first.next;
    for _ in 0..MAX_IFDS {
        let Some(ifd) = (next != 0).then(|| tags.ifd(next)).flatten() else { break };
        next = ifd.next;
        candidates.push(ifd);
    }
    let is_raw = |ifd: &Ifd<'_>| {
        matches!(ifd.unsigned(tag::PHOTOMETRIC), Some(LINEAR_RAW | CFA)) && ifd.unsigned(tag::NEW_SUBFILE_TYPE).unwrap_or(0) & 1 == 0
    };
    let area = |ifd: &Ifd<'_>| ifd.unsigned(tag::WIDTH).unwrap_or(0).saturating_mul(ifd.unsigned(tag::HEIGHT).unwrap_or(0));
    candidates.into_iter().filter(is_raw).max_by_key(area)
}
