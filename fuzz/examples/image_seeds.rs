//! Writes small valid images of every kind to `corpus/image_*`, where the fuzzer starts from.

use std::error::Error;
use std::io::Cursor;
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image as Exr, Layer, LayerAttributes, LineOrder, Vec2,
    WritableImage, f16,
};
use image::ImageEncoder;
use tiff::encoder::colortype::{ColorType, Gray16, Gray32Float, RGB8, RGB32Float, RGBA16};
use tiff::encoder::{Compression as TiffCompression, TiffEncoder, TiffValue};

type Outcome<T = ()> = Result<T, Box<dyn Error>>;

const WIDTH: usize = 9;
const HEIGHT: usize = 5;

fn main() -> Outcome {
    let values: Vec<f32> = (0..WIDTH * HEIGHT * 4).map(|i| (i * 7 % 31) as f32 * 0.5).collect();
    let bytes: Vec<u8> = values.iter().map(|v| (v * 16.0) as u8).collect();
    exr_seeds(&values)?;
    tiff_seeds(&values)?;
    raster_seeds(&bytes)?;
    dng_seeds(&bytes)?;
    let pixels: Vec<_> = values.as_chunks().0.iter().take(WIDTH * HEIGHT).map(|&rgb| image::Rgb(rgb)).collect();
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({HEIGHT}, {WIDTH}, 3), }}\n");
    let samples: Vec<u8> = values[..WIDTH * HEIGHT * 3].iter().flat_map(|v| v.to_le_bytes()).collect();
    let length = (header.len() as u16).to_le_bytes();
    seed("image_npy", "float", &[&b"\x93NUMPY\x01\x00"[..], &length, header.as_bytes(), &samples].concat())?;
    let mut hdr = Vec::new();
    image::codecs::hdr::HdrEncoder::new(&mut hdr).encode(&pixels, WIDTH, HEIGHT)?;
    seed("image_hdr", "rle", &hdr)?;
    seed(
        "image_hdr",
        "flat",
        b"#?RGBE\nEXPOSURE=2\nPRIMARIES=.64 .33 .3 .6 .15 .06 .3127 .329\n\n-Y 1 +X 2\n\x80\x40\x00\x81\x80\x40\x00\x81",
    )
}

fn seed(target: &str, name: &str, bytes: &[u8]) -> Outcome {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
    std::fs::create_dir_all(&folder)?;
    Ok(std::fs::write(folder.join(name), bytes)?)
}

fn exr_seeds(values: &[f32]) -> Outcome {
    use Compression::{B44, B44A, DWAA, DWAB, PIZ, PXR24, RLE, Uncompressed, ZIP1, ZIP16};
    let plane = |c: usize, is_half: bool| {
        let samples = values.iter().skip(c).step_by(4);
        if is_half { FlatSamples::F16(samples.map(|v| f16::from_f32(*v)).collect()) } else { FlatSamples::F32(samples.copied().collect()) }
    };
    for (i, compression) in [Uncompressed, RLE, ZIP1, ZIP16, PIZ, PXR24, B44, B44A, DWAA(None), DWAB(None)].into_iter().enumerate() {
        for (blocks, layout) in [(Blocks::ScanLines, "lines"), (Blocks::Tiles(Vec2(4, 4)), "tiles")] {
            let channels =
                ["A", "B", "G", "R"].iter().enumerate().map(|(c, name)| AnyChannel::new(*name, plane(c, layout == "lines"))).collect();
            let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
            let file = Exr::from_layer(Layer::new((WIDTH, HEIGHT), LayerAttributes::named("a"), encoding, AnyChannels::sort(channels)));
            let mut out = Cursor::new(Vec::new());
            file.write().non_parallel().to_buffered(&mut out)?;
            seed("image_exr", &format!("{i}-{layout}"), out.get_ref())?;
        }
    }
    Ok(())
}

fn tiff_seeds(values: &[f32]) -> Outcome {
    let words: Vec<u16> = values.iter().map(|v| (v * 1000.0) as u16).collect();
    let bytes: Vec<u8> = values.iter().map(|v| (v * 16.0) as u8).collect();
    let kinds =
        [TiffCompression::Uncompressed, TiffCompression::Lzw, TiffCompression::Deflate(Default::default()), TiffCompression::Packbits];
    for (i, compression) in kinds.into_iter().enumerate() {
        tiff_seed::<RGB32Float>(&format!("{i}-rgb32f"), values, 3, compression)?;
        tiff_seed::<Gray32Float>(&format!("{i}-grey32f"), values, 1, compression)?;
        tiff_seed::<RGBA16>(&format!("{i}-rgba16"), &words, 4, compression)?;
        tiff_seed::<Gray16>(&format!("{i}-grey16"), &words, 1, compression)?;
        tiff_seed::<RGB8>(&format!("{i}-rgb8"), &bytes, 3, compression)?;
    }
    Ok(())
}

fn tiff_seed<C: ColorType>(name: &str, samples: &[C::Inner], channels: usize, compression: TiffCompression) -> Outcome
where
    [C::Inner]: TiffValue,
{
    let mut out = Cursor::new(Vec::new());
    let samples = samples.get(..WIDTH * HEIGHT * channels).ok_or("too few samples")?;
    TiffEncoder::new(&mut out)?.with_compression(compression).write_image::<C>(WIDTH as u32, HEIGHT as u32, samples)?;
    seed("image_tiff", name, out.get_ref())
}

fn raster_seeds(bytes: &[u8]) -> Outcome {
    use image::ExtendedColorType::{L8, L16, La16, Rgb8, Rgb16, Rgba8};
    for (kind, size) in [(L8, 1), (Rgb8, 3), (Rgba8, 4), (L16, 2), (La16, 4)] {
        let mut png = Vec::new();
        let samples = bytes.get(..WIDTH * HEIGHT * size).ok_or("too few samples")?;
        image::codecs::png::PngEncoder::new(&mut png).write_image(samples, WIDTH as u32, HEIGHT as u32, kind)?;
        seed("image_png", &format!("{kind:?}"), &png)?;
    }
    let samples = bytes.get(..WIDTH * HEIGHT * 3).ok_or("too few samples")?;
    seed("image_png", "srgb", &luxel_io::encode_png(WIDTH, HEIGHT, samples)?)?;
    let mut png = Vec::new();
    image::codecs::png::PngEncoder::new(&mut png).write_image(
        &[bytes, bytes].concat()[..WIDTH * HEIGHT * 6],
        WIDTH as u32,
        HEIGHT as u32,
        Rgb16,
    )?;
    seed("image_png", "rgb16", &png)?;
    for (kind, size) in [(L8, 1), (Rgb8, 3)] {
        let mut jpeg = Vec::new();
        let samples = bytes.get(..WIDTH * HEIGHT * size).ok_or("too few samples")?;
        image::codecs::jpeg::JpegEncoder::new(&mut jpeg).encode(samples, WIDTH as u32, HEIGHT as u32, kind)?;
        seed("image_jpeg", &format!("{kind:?}"), &jpeg)?;
    }
    Ok(())
}

/// Returns the mosaics and LinearRaw: uncompressed, and lossless JPEG of zeros.
fn dng_seeds(bytes: &[u8]) -> Outcome {
    // Two components of half the width, one code of one bit for "no difference", 22 such codes.
    let lossless = [
        &[0xff, 0xd8, 0xff, 0xc3, 0, 14, 12, 0, 4, 0, 2, 2, 0, 0x11, 0, 1, 0x11, 0][..],
        &[0xff, 0xc4, 0, 20, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
        &[0xff, 0xda, 0, 10, 2, 0, 0, 1, 0, 1, 0, 0, 0, 0, 0x7f, 0xff, 0xd9],
    ]
    .concat();
    let linear: Vec<u8> = bytes.iter().copied().cycle().take(4 * 4 * 3 * 2).collect();
    let mosaic = &linear[..4 * 4 * 2];
    for (name, per_pixel, compression, data) in
        [("linear", 3u16, 1u16, &linear[..]), ("mosaic", 1, 1, mosaic), ("lossless", 1, 7, &lossless[..])]
    {
        let photometric = if per_pixel == 1 { 32803u32 } else { 34892 };
        let mut entries: Vec<(u16, u16, u32, u32)> = vec![
            (256, 4, 1, 4),
            (257, 4, 1, 4),
            (258, 3, 1, if compression == 7 { 12 } else { 16 }),
            (259, 3, 1, compression.into()),
            (262, 4, 1, photometric),
            (273, 4, 1, 0),
            (277, 3, 1, per_pixel.into()),
            (278, 4, 1, 4),
            (279, 4, 1, data.len() as u32),
            (33421, 3, 2, 2 | 2 << 16),
            (33422, 1, 4, u32::from_le_bytes([0, 1, 1, 2])),
            (34855, 3, 1, 200),
            (50706, 1, 4, 0x0401),
        ];
        entries[5].3 = (8 + 2 + 12 * entries.len() + 4) as u32;
        let mut file = b"II*\0\x08\0\0\0".to_vec();
        file.extend((entries.len() as u16).to_le_bytes());
        for (tag, kind, count, value) in entries {
            file.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
            file.extend([count.to_le_bytes(), value.to_le_bytes()].concat());
        }
        file.extend([0; 4]);
        file.extend(data);
        seed("photo_dng", name, &file)?;
    }
    Ok(())
}
