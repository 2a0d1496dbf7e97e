//! TIFF, and camera RAW that looks like it.

use exr::prelude::f16;

use super::*;

#[test]
fn a_flat_mask_in_fax_codes_is_read() {
    let (width, height) = (8192u32, 5464u32);
    // Group 4: a bit says that a line is as the white one before it; then the end of the block.
    let data = [&vec![0xff; height as usize / 8][..], &[0x00, 0x10, 0x01]].concat();
    let entries = [
        (256, width),
        (257, height),
        (258, 1),
        (259, 4),
        (262, 0),
        (273, 134),
        (277, 1),
        (278, height),
        (279, data.len() as u32),
        (266, 1),
    ];
    let mut entries: Vec<(u16, u32)> = entries.to_vec();
    entries.sort_unstable();
    let entry =
        |(tag, value): (u16, u32)| [&tag.to_le_bytes()[..], &4u16.to_le_bytes(), &1u32.to_le_bytes(), &value.to_le_bytes()].concat();
    let entries: Vec<u8> = entries.into_iter().flat_map(entry).collect();
    let file = [&b"II*\0\x08\0\0\0\x0a\0"[..], &entries, &[0; 4], &data].concat();
    let mask = luxel_io::decode_mask(Path::new("white.tif"), &file, [width as usize, height as usize]).unwrap();
    assert!(mask.weights.iter().all(|weight| *weight == 1.0));
}

#[test]
fn tiffs_of_few_bits_are_masks_and_floats_of_which_zero_is_white_are_refused() {
    // 3 x 2 pixels of one bit: 1 0 1, 0 1 1.
    let entry =
        |tag: u16, kind: u16, value: u32| [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1u32.to_le_bytes(), &value.to_le_bytes()].concat();
    let file = |bits: u32, format: u32, photometric: u32, data: &[u8]| {
        let entries = [
            (256, 3),
            (257, 2),
            (258, bits),
            (259, 1),
            (262, photometric),
            (273, 8 + 2 + 12 * 10 + 4),
            (277, 1),
            (278, 2),
            (279, data.len() as u32),
            (339, format),
        ];
        let entries: Vec<u8> = entries.iter().flat_map(|(tag, value)| entry(*tag, 4, *value)).collect();
        [&b"II*\0\x08\0\0\0\x0a\0"[..], &entries, &[0; 4], data].concat()
    };
    let bits = decode(&file(1, 1, 1, &[0b1010_0000, 0b0110_0000]), &LINEAR).unwrap();
    assert_eq!(bits.image.pixels.iter().map(|p| p[0]).collect::<Vec<_>>(), [1.0, 0.0, 1.0, 0.0, 1.0, 1.0]);
    let four = decode(&file(4, 1, 1, &[0x0f, 0x50, 0xf0, 0xa0]), &LINEAR).unwrap();
    assert_eq!(four.image.pixels.iter().map(|p| (p[0] * 15.0).round() as u32).collect::<Vec<_>>(), [0, 15, 5, 15, 0, 10]);
    let floats: Vec<u8> = [0.0f32, 0.5, 1.0, 2.0, 3.0, 4.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(decode(&file(32, 3, 1, &floats), &UNSAID).unwrap().image.pixels[5], [4.0; 3]);
    let error = decode(&file(32, 3, 0, &floats), &UNSAID).unwrap_err();
    assert!(error.message.contains("WhiteIsZero") && error.kind == IoErrorKind::Unsupported, "{error}");
}

pub(super) fn tiff_bytes<C: tiff::encoder::colortype::ColorType>(
    size: (u32, u32),
    data: &[C::Inner],
    compression: tiff::encoder::Compression,
) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut out = Cursor::new(Vec::new());
    tiff::encoder::TiffEncoder::new(&mut out).unwrap().with_compression(compression).write_image::<C>(size.0, size.1, data).unwrap();
    out.into_inner()
}

#[test]
fn tiff_of_every_sample_and_compression_is_read() {
    use tiff::encoder::{Compression, colortype as kind};
    let compressions = [Compression::Uncompressed, Compression::Lzw, Compression::Deflate(Default::default()), Compression::Packbits];
    for compression in compressions {
        let float = [0.0f32, 1e-6, 1e6, f32::NAN, -3.0, f32::INFINITY];
        let decoded = decode(&tiff_bytes::<kind::RGB32Float>((2, 1), &float, compression), &UNSAID).unwrap();
        let found: Vec<u32> = decoded.image.pixels.iter().flatten().map(|v| v.to_bits()).collect();
        assert_eq!((found, decoded.depth), (float.map(f32::to_bits).to_vec(), SampleDepth::Float));

        let decoded = decode(&tiff_bytes::<kind::Gray64Float>((2, 1), &[0.5, 1e9], compression), &UNSAID).unwrap();
        assert_eq!(decoded.image.pixels, [[0.5; 3], [1e9; 3]]);
        let decoded = decode(&tiff_bytes::<kind::RGBA32Float>((1, 1), &[1.0, 2.0, 3.0, 0.5], compression), &UNSAID).unwrap();
        assert_eq!((decoded.image.pixels, decoded.alpha), (vec![[1.0, 2.0, 3.0]], Some(vec![0.5])));

        let bytes = tiff_bytes::<kind::RGB16>((2, 1), &[0, 65535, 32768, 1, 2, 3], compression);
        let decoded = decode(&bytes, &LINEAR).unwrap();
        assert_eq!(decoded.image.pixels[0], [0.0, 1.0, (32768.0f64 / 65535.0) as f32]);
        assert_eq!((decoded.depth, decoded.warnings.len()), (SampleDepth::Integer16, 0));
        assert!((decode(&bytes, &SRGB).unwrap().image.pixels[0][2] - 0.214_05).abs() < 1e-4);
        let error = decode(&bytes, &UNSAID).unwrap_err();
        assert!(error.message.contains("16-bit"), "{error}");
        assert!(error.remedy.is_some_and(|remedy| remedy.options().eq(["transfer"; 2])));

        let bytes = tiff_bytes::<kind::Gray8>((2, 1), &[0, 255], compression);
        let decoded = decode(&bytes, &LINEAR).unwrap();
        assert_eq!((decoded.image.pixels, decoded.depth), (vec![[0.0; 3], [1.0; 3]], SampleDepth::Integer8));
        assert_eq!(decoded.warnings, ["8 bits: not HDR"]);
        assert!(decode(&bytes, &UNSAID).unwrap_err().message.contains("8-bit"));
    }
    let error = decode(&tiff_bytes::<kind::CMYK8>((1, 1), &[0; 4], Compression::Uncompressed), &LINEAR).unwrap_err();
    assert_eq!(error.kind, IoErrorKind::Unsupported);
}

#[test]
fn tiff_of_half_floats_is_read() {
    // The encoder has none: a hand-made little-endian file of one strip, 2 x 1 grey.
    let entry =
        |tag: u16, kind: u16, value: u32| [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1u32.to_le_bytes(), &value.to_le_bytes()].concat();
    let (short, long) = (3, 4);
    let entries = [
        (256, long, 2),
        (257, long, 1),
        (258, short, 16),
        (259, short, 1),
        (262, short, 1),
        (273, long, 8),
        (277, short, 1),
        (278, long, 1),
        (279, long, 4),
        (339, short, 3),
    ];
    let mut bytes = b"II*\0\x0c\0\0\0".to_vec();
    bytes.extend([f16::from_f32(0.5), f16::from_f32(1000.0)].iter().flat_map(|v| v.to_le_bytes()));
    bytes.extend((entries.len() as u16).to_le_bytes());
    bytes.extend(entries.iter().flat_map(|&(tag, kind, value)| entry(tag, kind, value)));
    bytes.extend([0; 4]);
    assert_eq!(decode(&bytes, &UNSAID).unwrap().image.pixels, [[0.5; 3], [1000.0; 3]]);
}

#[test]
fn camera_raw_and_thumbnails_in_tiff_are_refused() {
    use tiff::encoder::{TiffEncoder, colortype::RGB8};
    use tiff::tags::Tag;
    for (tag, value) in [(Tag::Unknown(50706), 0x0104u32), (Tag::NewSubfileType, 1)] {
        let mut out = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut out).unwrap();
        let mut image = encoder.new_image::<RGB8>(1, 1).unwrap();
        image.encoder().write_tag(tag, value).unwrap();
        image.write_data(&[1, 2, 3]).unwrap();
        let error = decode(&out.into_inner(), &LINEAR).unwrap_err();
        assert!(error.message.contains("camera RAW"), "{error}");
    }
}

#[test]
fn primaries_of_tiff_are_settled() {
    use tiff::encoder::{Rational, TiffEncoder, colortype::RGB32Float};
    use tiff::tags::Tag;
    let bytes = |primaries: [u32; 6], white: [u32; 2]| {
        let mut out = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut out).unwrap();
        let mut image = encoder.new_image::<RGB32Float>(1, 1).unwrap();
        for (tag, values) in [(318, white.as_slice()), (319, &primaries)] {
            let values: Vec<Rational> = values.iter().map(|&n| Rational { n, d: 10_000 }).collect();
            image.encoder().write_tag(Tag::Unknown(tag), values.as_slice()).unwrap();
        }
        image.write_data(&[2.0, 2.0, 2.0]).unwrap();
        out.into_inner()
    };
    let decoded = |bytes: &[u8]| decode(bytes, &UNSAID).unwrap();
    let rec2020 = decoded(&bytes([7080, 2920, 1700, 7970, 1310, 460], [3127, 3290]));
    assert_eq!((rec2020.color_space, rec2020.image.pixels[0]), (Some(ColorSpace::LinearRec2020), [2.0; 3]));
    // DCI-P3 under its own white: converted, with a warning.
    let converted = decoded(&bytes([6800, 3200, 2650, 6900, 1500, 600], [3140, 3510]));
    assert_eq!((converted.color_space, converted.warnings.len()), (Some(ColorSpace::LinearRec709), 1));
    assert!(converted.image.pixels[0].iter().all(|c| (c - 2.0).abs() < 1e-5));
    // Tags that say nothing do not cost the image.
    let nothing = decoded(&bytes([0; 6], [0; 2]));
    assert_eq!((nothing.color_space, nothing.image.pixels[0]), (None, [2.0; 3]));
    assert!(nothing.warnings[0].contains("not a colour space"), "{:?}", nothing.warnings);
}

/// A TIFF by hand: little-endian, rows of codes or floats of `bits` bits, in one strip or in tiles.
struct RawTiff<'a> {
    /// `[H, W, C]`.
    samples: &'a [f32],
    size: [usize; 2],
    channels: usize,
    bits: usize,
    extra: &'a [u16],
    predictor: u16,
    tile: Option<usize>,
    fill_order: u16,
}

impl RawTiff<'_> {
    /// Returns a row of samples as bytes, after the predictor.
    fn row(&self, row: &[f32]) -> Vec<u8> {
        let c = self.channels;
        let before = |i: usize| if self.predictor == 2 && i >= c { row[i - c] } else { 0.0 };
        let mut bytes: Vec<u8> = match self.bits {
            8 => (0..row.len()).map(|i| (row[i] as u8).wrapping_sub(before(i) as u8)).collect(),
            16 => (0..row.len()).flat_map(|i| (row[i] as u16).wrapping_sub(before(i) as u16).to_le_bytes()).collect(),
            32 if self.predictor == 3 => {
                let planes: Vec<u8> = (0..4).flat_map(|byte| row.iter().map(move |v| v.to_be_bytes()[byte])).collect();
                (0..planes.len()).map(|i| planes[i].wrapping_sub(if i >= c { planes[i - c] } else { 0 })).collect()
            }
            32 => row.iter().flat_map(|v| v.to_le_bytes()).collect(),
            bits => {
                let mut packed = vec![0u8; (row.len() * bits).div_ceil(8)];
                let of_row = row.iter().flat_map(|v| (0..bits).rev().map(move |bit| *v as u32 >> bit & 1));
                of_row.enumerate().filter(|(_, bit)| *bit == 1).for_each(|(i, _)| packed[i / 8] |= 0x80 >> (i % 8));
                packed
            }
        };
        if self.fill_order == 2 {
            bytes.iter_mut().for_each(|byte| *byte = byte.reverse_bits());
        }
        bytes
    }

    fn blocks(&self) -> Vec<Vec<u8>> {
        let [width, height] = self.size;
        let [across, down] = self.tile.map_or(self.size, |tile| [tile; 2]);
        let sample =
            |x: usize, y: usize, c: usize| if x < width && y < height { self.samples[(y * width + x) * self.channels + c] } else { 0.0 };
        let row = |left: usize, y: usize| {
            let samples: Vec<f32> =
                (left..left + across).flat_map(|x| (0..self.channels).map(move |c| (x, c))).map(|(x, c)| sample(x, y, c)).collect();
            self.row(&samples)
        };
        let corners = (0..height).step_by(down).flat_map(|top| (0..width).step_by(across).map(move |left| (left, top)));
        corners.map(|(left, top)| (top..top + down).flat_map(|y| row(left, y)).collect()).collect()
    }

    fn bytes(&self) -> Vec<u8> {
        let blocks = self.blocks();
        let (mut file, mut offsets) = (b"II*\0\0\0\0\0".to_vec(), Vec::new());
        for block in &blocks {
            offsets.push(file.len() as u32);
            file.extend(block);
        }
        let lengths: Vec<u32> = blocks.iter().map(|block| block.len() as u32).collect();
        let (c, format) = (self.channels, if self.bits == 32 { 3 } else { 1 });
        let mut tags: Vec<(u16, Vec<u32>)> = vec![
            (256, vec![self.size[0] as u32]),
            (257, vec![self.size[1] as u32]),
            (258, vec![self.bits as u32; c]),
            (259, vec![1]),
            (262, vec![if c >= 3 { 2 } else { 1 }]),
            (266, vec![self.fill_order.into()]),
            (277, vec![c as u32]),
            (284, vec![1]),
            (317, vec![self.predictor.into()]),
            (339, vec![format; c]),
        ];
        if !self.extra.is_empty() {
            tags.push((338, self.extra.iter().map(|v| u32::from(*v)).collect()));
        }
        match self.tile {
            Some(tile) => tags.extend([(322, vec![tile as u32]), (323, vec![tile as u32]), (324, offsets), (325, lengths)]),
            None => tags.extend([(273, offsets), (278, vec![self.size[1] as u32]), (279, lengths)]),
        }
        tags.sort();
        let directory = file.len();
        file[4..8].copy_from_slice(&(directory as u32).to_le_bytes());
        let mut behind: Vec<u8> = Vec::new();
        let start = directory + 2 + 12 * tags.len() + 4;
        file.extend((tags.len() as u16).to_le_bytes());
        for (tag, values) in tags {
            // Sizes and places are of 32 bits, all else of 16.
            let is_long = [256, 257, 273, 278, 279, 322, 323, 324, 325].contains(&tag);
            let bytes: Vec<u8> = if is_long {
                values.iter().flat_map(|v| v.to_le_bytes()).collect()
            } else {
                values.iter().flat_map(|v| (*v as u16).to_le_bytes()).collect()
            };
            file.extend(tag.to_le_bytes());
            file.extend(if is_long { 4u16 } else { 3 }.to_le_bytes());
            file.extend((values.len() as u32).to_le_bytes());
            if bytes.len() <= 4 {
                file.extend(bytes.iter().chain(&[0; 4]).take(4));
            } else {
                file.extend(((start + behind.len()) as u32).to_le_bytes());
                behind.extend(&bytes);
            }
        }
        file.extend([0; 4]);
        file.extend(behind);
        file
    }
}

/// Returns whole codes below `most`, different in each channel.
fn codes([width, height]: [usize; 2], channels: usize, most: usize) -> Vec<f32> {
    (0..width * height * channels).map(|i| ((i * 37 + i / width * 11 + i % channels * 5) % most) as f32).collect()
}

#[test]
fn extra_samples_do_not_move_the_colours() {
    let size = [37, 19];
    for (channels, extra) in [(4, &[0u16][..]), (5, &[2, 0]), (5, &[1, 0]), (5, &[0, 2]), (6, &[0, 0, 0])] {
        for (bits, predictor) in [(8, 1), (8, 2), (16, 2), (32, 1), (32, 3)] {
            for tile in [None, Some(16)] {
                let samples = codes(size, channels, if bits == 8 { 256 } else { 40_000 });
                let raw = RawTiff { samples: &samples, size, channels, bits, extra, predictor, tile, fill_order: 1 };
                let decoded = decode(&raw.bytes(), &LINEAR).unwrap();
                let top = if bits == 32 { 1.0 } else { ((1u32 << bits) - 1) as f32 };
                let context = format!("{channels} channels, {extra:?}, {bits} bits, predictor {predictor}, tile {tile:?}");
                for (found, expected) in decoded.image.pixels.iter().zip(samples.chunks(channels)) {
                    assert!(
                        (0..3).all(|c| (found[c] - expected[c] / top).abs() <= 1e-6 * expected[c]),
                        "{context}: {found:?} {expected:?}"
                    );
                }
                // The opacity is wherever the file says.
                let at = extra.iter().position(|kind| *kind != 0);
                assert_eq!(decoded.alpha.is_some(), at.is_some(), "{context}");
                if let (Some(alpha), Some(at)) = (&decoded.alpha, at) {
                    let expected = samples.chunks(channels).map(|pixel| pixel[3 + at] / top);
                    assert!(alpha.iter().zip(expected).all(|(a, e)| (a - e).abs() <= 1e-6 * e), "{context}");
                }
            }
        }
    }
    // Beside grey, too.
    let samples = codes(size, 2, 256);
    let raw = RawTiff { samples: &samples, size, channels: 2, bits: 8, extra: &[0], predictor: 1, tile: None, fill_order: 1 };
    let decoded = decode(&raw.bytes(), &LINEAR).unwrap();
    assert!(decoded.alpha.is_none() && (decoded.image.pixels[7][1] - samples[14] / 255.0).abs() < 1e-6);
}

#[test]
fn grey_of_any_number_of_bits_is_read_in_both_orders_of_bits() {
    let size = [37, 19];
    for bits in [1usize, 2, 3, 4, 5, 6, 7, 8, 16] {
        let most = (1usize << bits) - 1;
        let samples = codes(size, 1, most + 1);
        for fill_order in [1, 2] {
            let raw = RawTiff { samples: &samples, size, channels: 1, bits, extra: &[], predictor: 1, tile: None, fill_order };
            let decoded = decode(&raw.bytes(), &LINEAR).unwrap();
            // Half a code of 16 bits: what fewer than 8 become.
            let worst = decoded.image.pixels.iter().zip(&samples).map(|(f, e)| (f[0] - e / most as f32).abs()).fold(0.0, f32::max);
            assert!(worst <= 0.51 / 65535.0, "{bits} bits, order {fill_order}: {worst}");
            assert_eq!((decoded.depth.integer_bits(), decoded.depth.is_low()), (Some(bits as u8), bits <= 8));
            assert_eq!(decoded.warnings.contains(&format!("{bits} bits: not HDR")), bits <= 8);
        }
    }
}
