//! Radiance HDR.

use super::*;

#[test]
fn old_hdr_files_without_run_lengths_are_read_whatever_their_codes_are() {
    // Codes that mark runs in files that have them.
    let codes = [[1u8, 1, 1, 129], [128, 64, 32, 129], [2, 2, 32, 129], [0, 0, 0, 0], [1, 1, 1, 200], [255, 255, 255, 128]];
    let file = [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 3 +X 2\n"[..], codes.as_flattened()].concat();
    let light = |[r, g, b, e]: [u8; 4]| [r, g, b].map(|m| if e == 0 { 0.0 } else { f32::from(m) * 2f32.powi(i32::from(e) - 136) });
    assert_eq!(decode(&file, &UNSAID).unwrap().image.pixels, codes.map(light));
}

#[test]
fn radiance_hdr_is_read_and_its_exposure_divided_out() {
    let mut body = Vec::new();
    let pixels: Vec<_> = (0..20 * 6).map(|i| image::Rgb([i as f32, 0.5, 1000.0])).collect();
    image::codecs::hdr::HdrEncoder::new(&mut body).encode(&pixels, 20, 6).unwrap();
    let decoded = decode(&body, &UNSAID).unwrap();
    let expected = Radiance { width: 20, height: 6, pixels: pixels.iter().map(|p| p.0).collect() };
    // 8 bits of mantissa shared by the largest channel: half a step of 1024 / 256.
    for (f, e) in decoded.image.pixels.iter().zip(&expected.pixels) {
        assert!((0..3).all(|c| (f[c] - e[c]).abs() <= 4.0), "{f:?} expected {e:?}");
    }
    assert_eq!((decoded.depth, decoded.color_space), (SampleDepth::Float, None));

    // Flat pixels; (128, 64, 0) * 2^(129 - 136) = (1, 0.5, 0).
    let file = |header: &str| [header.as_bytes(), b"\n-Y 1 +X 2\n\x80\x40\x00\x81\x80\x40\x00\x81"].concat();
    for (header, expected) in [
        ("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", [1.0, 0.5, 0.0]),
        ("#?RGBE\nFORMAT=32-bit_rle_rgbe\n", [1.0, 0.5, 0.0]),
        ("#?RADIANCE\nEXPOSURE=4\nFORMAT=32-bit_rle_rgbe\nEXPOSURE= 0.5\n", [0.5, 0.25, 0.0]),
        ("#?RADIANCE\nCOLORCORR=2 4 1\nEXPOSURE=0.5\n", [1.0, 0.25, 0.0]),
        ("#?RADIANCE\nPRIMARIES= .64 .33 .30 .60 .15 .06 .3127 .3290\n", [1.0, 0.5, 0.0]),
    ] {
        assert_eq!(decode(&file(header), &UNSAID).unwrap().image.pixels, [expected; 2], "{header}");
    }
    for header in ["#?RADIANCE\nPRIMARIES=1 2\n", "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n"] {
        assert!(decode(&file(header), &UNSAID).is_err(), "{header}");
    }
    // Numbers that say nothing.
    for (header, part) in [
        ("#?RADIANCE\nEXPOSURE=0\n", "EXPOSURE=0 is no positive factor"),
        ("#?RADIANCE\nEXPOSURE=NaN\n", "EXPOSURE=NaN"),
        ("#?RADIANCE\nCOLORCORR=0 0 0\n", "COLORCORR=0"),
        ("#?RADIANCE\nPRIMARIES=0 0 0 0 0 0 0 0\n", "not a colour space"),
        ("#?RADIANCE\nPIXASPECT=0.75\n", "pixel aspect ratio is 1.3333"),
    ] {
        let decoded = decode(&file(header), &UNSAID).unwrap();
        assert_eq!((decoded.image.pixels[0], decoded.color_space), ([1.0, 0.5, 0.0], None), "{header}");
        assert!(decoded.warnings[0].contains(part), "{:?}", decoded.warnings);
    }
    let turned = b"#?RADIANCE\n\n+X 2 -Y 1\n\x80\x40\x00\x81\x80\x40\x00\x81";
    assert_eq!(decode(turned, &UNSAID).unwrap_err().kind, IoErrorKind::Unsupported);
}
