//! Deep images as OpenEXR files of scan lines.
//!
//! In: [`DeepImage`] in the units of the file. Out: channels A, B, G, R (premultiplied by each
//! sample's opacity), Z and ZBack, with ZIPS compression. Source: OpenEXR's documentation, "OpenEXR
//! File Layout" and "Interpreting OpenEXR Deep Pixels". The library writes flat images only:
//! headers and attributes are the library's, chunks are written here. Degenerate: a line without
//! samples is a chunk without sample data.

use std::io::Write as _;
use std::path::Path;

use ::exr::meta::attribute::{
    self, AttributeValue, BlockType, ChannelDescription, Chromaticities, Compression, LineOrder, SampleType, Text,
};
use ::exr::meta::header::{Header, standard_names};
use ::exr::meta::{BlockDescription, Requirements, magic_number};
use ::exr::prelude::{SmallVec, Vec2};
use flate2::write::ZlibEncoder;
use luxel_core::engine::{DeepImage, DeepSample};
use rayon::prelude::*;

use super::exr_header::sort_attributes;
use super::exr_options::{ExrOptions, ExrSample, HALF_MAX, to_half};
use super::write::attributes;
use crate::{IoError, write_atomically};

/// Longest name of an attribute without a flag for long names.
const SHORT_NAME: usize = 31;

/// Sums of samples are stored as signed numbers of 32 bits.
const MOST_SAMPLES_OF_A_LINE: usize = i32::MAX as usize;

impl ExrSample {
    /// Returns half floats, or 32 bits where a sample's radiance is beyond their range.
    pub fn smallest_for_deep(image: &DeepImage) -> Self {
        if out_of_range(image, Self::Half) > 0 { Self::Float } else { Self::Half }
    }
}

/// Writes a deep image; [`ExrOptions::alpha`] and [`ExrOptions::depth`] are those of flat images
/// and not used. Returns how many values were above the range of [`ExrSample::Half`] and are
/// written as its largest number.
///
/// # Errors
/// The system's, or the image is empty, has too many samples in a line, or an attribute's name is
/// empty or longer than 255 bytes.
pub fn write_deep_exr(path: &Path, image: &DeepImage, options: &ExrOptions) -> Result<usize, IoError> {
    let bytes = encode_deep_exr(path, image, options)?;
    write_atomically(path, |out| out.write_all(&bytes).map_err(|e| IoError::system(path, "write", &e)))?;
    Ok(out_of_range(image, options.sample))
}

/// Encodes a deep image as [`write_deep_exr`] writes it, into memory; `name` is for messages only.
///
/// # Errors
/// The same as [`write_deep_exr`].
pub fn encode_deep_exr(name: &Path, image: &DeepImage, options: &ExrOptions) -> Result<Vec<u8>, IoError> {
    let (width, height) = (image.width, image.height);
    if width == 0 || height == 0 || image.pixels.len() != width * height {
        return Err(IoError::invalid(name, format!("{} pixels in an image of {width} x {height}, nothing to write", image.pixels.len())));
    }
    let invalid = |message: String| IoError::invalid(name, message);
    let mut file = header(image, options).map_err(invalid)?;
    sort_attributes(&mut file);
    let lines = image.pixels.par_chunks(width).enumerate();
    let chunks: Vec<Vec<u8>> = lines.map(|(y, line)| chunk(y, line, options.sample)).collect::<Result<_, _>>().map_err(invalid)?;
    let mut place = file.len() + height * size_of::<u64>();
    for chunk in &chunks {
        file.extend((place as u64).to_le_bytes());
        place += chunk.len();
    }
    chunks.iter().for_each(|chunk| file.extend_from_slice(chunk));
    Ok(file)
}

/// Returns everything in front of the table of chunks.
fn header(image: &DeepImage, options: &ExrOptions) -> Result<Vec<u8>, String> {
    let color = match options.sample {
        ExrSample::Half => SampleType::F16,
        ExrSample::Float => SampleType::F32,
    };
    let channels = [("A", color), ("B", color), ("G", color), ("R", color), ("Z", SampleType::F32), ("ZBack", SampleType::F32)];
    let channels = channels.into_iter().map(|(name, kind)| ChannelDescription::named(name, kind)).collect::<SmallVec<_>>();
    let mut header = Header::new(Text::from("deep"), (image.width, image.height), channels);
    header.own_attributes = attributes(options)?;
    header.own_attributes.layer_name = Some(Text::from("deep"));
    let [red, green, blue, white] = options.color_space.chromaticities().map(|[x, y]| Vec2(x, y));
    header.shared_attributes.chromaticities = Some(Chromaticities { red, green, blue, white });
    header.compression = Compression::ZIP1;
    header.blocks = BlockDescription::ScanLines;
    header.line_order = LineOrder::Increasing;
    header.chunk_count = image.height;
    header.deep = true;
    header.deep_data_version = Some(1);
    header.max_samples_per_pixel = Some(image.most_samples());
    let mut out = Vec::new();
    let mut write = || {
        magic_number::write(&mut out)?;
        let has_long_names = header.all_named_attributes().any(|(name, _)| name.len() > SHORT_NAME);
        let requirements = Requirements {
            file_format_version: 2,
            is_single_layer_and_tiled: false,
            has_long_names,
            has_deep_data: true,
            has_multiple_layers: false,
        };
        requirements.write(&mut out)?;
        for (name, value) in header.all_named_attributes() {
            // The library knows the type of flat scan lines only.
            let is_type = name == standard_names::BLOCK_TYPE;
            let value = if is_type { AttributeValue::BlockType(BlockType::DeepScanLine) } else { value };
            attribute::write(name, &value, &mut out)?;
        }
        ::exr::error::UnitResult::Ok(())
    };
    write().map_err(|error| format!("OpenEXR: {error}"))?;
    out.push(0);
    Ok(out)
}

/// Returns the chunk of a line: its number, three sizes, the sums of samples, the samples.
fn chunk(y: usize, line: &[Vec<DeepSample>], sample: ExrSample) -> Result<Vec<u8>, String> {
    if line.iter().map(Vec::len).sum::<usize>() > MOST_SAMPLES_OF_A_LINE {
        return Err(format!("line {y} has more samples than OpenEXR can count; write fewer samples per pixel"));
    }
    let sums = line.iter().scan(0i32, |sum, samples| {
        *sum += samples.len() as i32;
        Some(sum.to_le_bytes())
    });
    let sums = sums.flatten().collect::<Vec<u8>>();
    let all = || line.iter().flatten();
    let mut data = Vec::new();
    let mut channel = |of: &dyn Fn(&DeepSample) -> f32| match sample {
        ExrSample::Half => data.extend(all().flat_map(|s| to_half(of(s)).to_le_bytes())),
        ExrSample::Float => data.extend(all().flat_map(|s| of(s).to_le_bytes())),
    };
    channel(&|s| s.alpha);
    [2, 1, 0].into_iter().for_each(|c| channel(&|s| s.radiance[c]));
    for end in 0..2 {
        data.extend(all().flat_map(|s| s.depth[end].to_le_bytes()));
    }
    let (packed_sums, packed_data) = (packed(&sums), packed(&data));
    let mut out = (y as i32).to_le_bytes().to_vec();
    for size in [packed_sums.len(), packed_data.len(), data.len()] {
        out.extend((size as u64).to_le_bytes());
    }
    out.extend(packed_sums);
    out.extend(packed_data);
    Ok(out)
}

/// Compresses bytes as ZIPS does: even ones before odd ones, differences, zlib. They stay as they
/// are if that is no smaller.
fn packed(bytes: &[u8]) -> Vec<u8> {
    let halves = bytes.iter().step_by(2).chain(bytes.iter().skip(1).step_by(2));
    let mut differences = Vec::with_capacity(bytes.len());
    let mut before = None;
    for byte in halves {
        differences.push(before.map_or(*byte, |before: u8| byte.wrapping_sub(before).wrapping_add(128)));
        before = Some(*byte);
    }
    let mut encoder = ZlibEncoder::new(Vec::new(), flate2::Compression::new(4));
    match encoder.write_all(&differences).and_then(|()| encoder.finish()) {
        Ok(packed) if packed.len() < bytes.len() => packed,
        _ => bytes.to_vec(),
    }
}

fn out_of_range(image: &DeepImage, sample: ExrSample) -> usize {
    let values = || image.pixels.iter().flatten().flat_map(|sample| sample.radiance);
    match sample {
        ExrSample::Half => values().filter(|value| value.abs() > HALF_MAX).count(),
        ExrSample::Float => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Undoes [`packed`].
    fn unpacked(bytes: &[u8], len: usize) -> Vec<u8> {
        if bytes.len() == len {
            return bytes.to_vec();
        }
        let mut all = Vec::new();
        std::io::Read::read_to_end(&mut flate2::read::ZlibDecoder::new(bytes), &mut all).unwrap();
        for i in 1..all.len() {
            all[i] = all[i].wrapping_add(all[i - 1]).wrapping_sub(128);
        }
        let (even, odd) = all.split_at(len.div_ceil(2));
        (0..len).map(|i| if i % 2 == 0 { even[i / 2] } else { odd[i / 2] }).collect()
    }

    fn image() -> DeepImage {
        let sample = |n: usize| DeepSample { radiance: [n as f32, 0.5, 2.0], alpha: 0.25, depth: [1.0, 1.0 + n as f32] };
        let pixels = (0..6).map(|n| (0..n % 4).map(sample).collect()).collect();
        DeepImage { width: 3, height: 2, pixels }
    }

    #[test]
    fn lines_hold_sums_and_channels_by_name() {
        let image = image();
        let file = encode_deep_exr(Path::new("a.exr"), &image, &ExrOptions { sample: ExrSample::Float, ..ExrOptions::default() }).unwrap();
        assert_eq!(file[..8], [0x76, 0x2f, 0x31, 1, 2, 0x08, 0, 0]);
        let chunks: Vec<Vec<u8>> = (0..2).map(|y| chunk(y, &image.pixels[3 * y..3 * y + 3], ExrSample::Float).unwrap()).collect();
        assert!(file.ends_with(&chunks.concat()));
        let number = |bytes: &[u8]| u64::from_le_bytes(bytes.try_into().unwrap()) as usize;
        let second = &chunks[1];
        let (sums, data, len) = (number(&second[4..12]), number(&second[12..20]), number(&second[20..28]));
        assert_eq!(second.len(), 28 + sums + data);
        let found = unpacked(&second[28..28 + sums], 12);
        assert_eq!(found, [3i32, 3, 4].map(i32::to_le_bytes).concat());
        let found = unpacked(&second[28 + sums..], len);
        let floats: Vec<f32> = found.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        assert_eq!(floats.len(), 6 * 4);
        assert_eq!(floats[..4], [0.25; 4]);
        assert_eq!(floats[12..16], [0.0, 1.0, 2.0, 0.0]);
        assert_eq!(floats[20..], [1.0, 2.0, 3.0, 1.0]);
    }

    #[test]
    fn radiance_beyond_half_floats_is_counted() {
        let mut image = image();
        assert_eq!(ExrSample::smallest_for_deep(&image), ExrSample::Half);
        image.pixels[1][0].radiance[1] = 7e4;
        assert_eq!(ExrSample::smallest_for_deep(&image), ExrSample::Float);
        assert_eq!(out_of_range(&image, ExrSample::Half), 1);
    }

    #[test]
    fn images_of_other_sizes_than_their_pixels_are_refused() {
        let error = encode_deep_exr(Path::new("a.exr"), &DeepImage { width: 4, ..image() }, &ExrOptions::default()).unwrap_err();
        assert!(error.to_string().contains("6 pixels in an image of 4 x 2"), "{error}");
    }
}
