#!/usr/bin/env python3
"""Synthesise a capture of a rendered scene: what a camera would have written of it, with nothing said about poses.

needs: pip install numpy pillow OpenEXR tifffile imagecodecs

usage: synthesise_capture.py IMAGES OUT [--kind jpeg|dng] [--codec ljpeg|jxl] [--exposures 5] [--step-ev 2] [--white RADIANCE] [--iso 100] [--scale 1] [--seed 1]

IMAGES: a folder of linear Rec.709 OpenEXR files. OUT: photographs and truth.json with the radiance scale.
jpeg: exposures of each view through a camera's curve (a shoulder, then a gamma: not sRGB), photon and read noise, quality 95, EXIF with
exposure time, ISO speed, aperture and time of capture. dng: 12-bit LinearRaw of the same exposures, tiles of 64 x 64, in camera colours.
The scene's radiance is multiplied so that RADIANCE of it (default: the median of all pixels) is exposed to 0.18 of saturation by the middle exposure,
1/30 s at f/8 and ISO 100: the physical scale that luxel prepare should find is in truth.json.
"""
import argparse
import json
import pathlib

import numpy as np
import OpenEXR
from PIL import Image

SATURATION = 120.0  # cd/m2 at 1 s, f/1, ISO 1: ISO 12232, saturation-based
MIDDLE_SECONDS, F_NUMBER = 1 / 30, 8.0
ELECTRONS, READ = 20000.0, 4.0
# XYZ (D65) to camera colours, an invented camera; white of D65 is its neutral.
CAMERA_FROM_XYZ = np.array([[0.95, -0.35, -0.08], [-0.45, 1.30, 0.16], [-0.06, 0.18, 0.62]])
XYZ_FROM_REC709 = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def read_exr(path):
    with OpenEXR.File(str(path)) as file:
        channels = file.channels()
        if "RGB" in channels:
            return channels["RGB"].pixels.astype(np.float32)
        return np.stack([channels[c].pixels for c in "RGB"], -1).astype(np.float32)


def signals(radiance, exposure, iso, rng):
    """Noisy signal, 1 at saturation."""
    signal = radiance * exposure
    gain = iso / 100.0
    variance = np.maximum(signal, 0) * gain / ELECTRONS + (READ / ELECTRONS) ** 2 * gain
    return signal + rng.normal(size=signal.shape) * np.sqrt(variance)


def camera_curve(signal):
    light = (1 - np.exp(-2.2 * np.clip(signal, 0, 1))) / (1 - np.exp(-2.2))
    return light ** (1 / 2.0)


def exif(seconds, iso, stamp):
    block = Image.Exif()
    block[271], block[272] = "Luxel", "Synthetic 1"
    block[306] = stamp
    ifd = block.get_ifd(0x8769)
    ifd[0x829A], ifd[0x829D], ifd[0x8827] = seconds, F_NUMBER, int(iso)
    ifd[0x9003], ifd[0xA403] = stamp, 1
    return block.tobytes()


def write_dng(path, signal, neutral, seconds, iso, stamp, codec):
    import imagecodecs
    import tifffile

    white, black = 4095, 64
    codes = np.clip(np.round(signal * (white - black) + black), 0, white).astype(np.uint16)
    height, width, _ = codes.shape
    rational = lambda values: [int(v) for x in values for v in (round(x * 10000), 10000)]
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True), (50707, "B", 4, (1, 4, 0, 0), True), (50708, "s", 0, "Luxel Synthetic 2", True),
        (271, "s", 0, "Luxel", True), (272, "s", 0, "Synthetic 2", True), (306, "s", 0, stamp, True),
        (50721, "2i", 9, rational(CAMERA_FROM_XYZ.ravel()), True), (50728, "2I", 3, rational(neutral), True),
        (50778, "H", 1, 21, True), (50714, "H", 3, (black,) * 3, True), (50717, "H", 3, (white,) * 3, True),
        # Exposure, aperture and speed in the first directory: TIFF/EP, which readers take as they do Exif's.
        (33434, "2I", 1, (round(seconds * 1e6), 1000000), True), (33437, "2I", 1, (round(F_NUMBER * 10), 10), True),
        (34855, "H", 1, int(iso), True),
    ]
    pad = np.pad(codes, ((0, -height % 64), (0, -width % 64), (0, 0)), mode="edge")
    encode = {
        "ljpeg": lambda t: imagecodecs.jpeg_encode(t, lossless=True, predictor=1, bitspersample=12, colorspace="RGB", outcolorspace="RGB"),
        "jxl": lambda t: imagecodecs.jpegxl_encode(t, lossless=True, bitspersample=12),
    }[codec]
    tiles = (encode(np.ascontiguousarray(pad[y:y + 64, x:x + 64])) for y in range(0, pad.shape[0], 64) for x in range(0, pad.shape[1], 64))
    compression = {"ljpeg": 7, "jxl": 52546}[codec]
    tifffile.imwrite(path, tiles, shape=codes.shape, dtype=codes.dtype, tile=(64, 64), photometric=34892, compression=compression, extratags=tags, metadata=None)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--kind", choices=["jpeg", "dng"], default="jpeg")
    parser.add_argument("--codec", choices=["ljpeg", "jxl"], default="ljpeg")
    parser.add_argument("--exposures", type=int, default=5)
    parser.add_argument("--step-ev", type=float, default=2.5)
    parser.add_argument("--white", type=float)
    parser.add_argument("--iso", type=float, default=100)
    parser.add_argument("--scale", type=int, default=1, help="repeat pixels this many times a side")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(options.seed)
    paths = sorted(options.images.glob("*.exr"))
    white = options.white or float(np.median(np.concatenate([read_exr(p).mean(-1).ravel() for p in paths])))
    middle = MIDDLE_SECONDS * options.iso / (SATURATION * F_NUMBER**2)
    factor = 0.18 / (middle * white)
    neutral = CAMERA_FROM_XYZ @ XYZ_FROM_REC709 @ np.ones(3)
    neutral /= neutral[1]
    camera_from_rec709 = CAMERA_FROM_XYZ @ XYZ_FROM_REC709
    camera_from_rec709 /= (camera_from_rec709 @ np.ones(3))[1]
    for number, path in enumerate(paths):
        radiance = np.repeat(np.repeat(read_exr(path) * factor, options.scale, 0), options.scale, 1)
        for k in range(options.exposures):
            ev = (k - (options.exposures - 1) / 2) * options.step_ev
            seconds = MIDDLE_SECONDS * 2.0**ev
            minutes, moment = divmod(10 * number, 3600)
            stamp = f"2026:05:17 {10 + minutes:02}:{moment // 60:02}:{moment % 60:02}"
            exposure = seconds * options.iso / (SATURATION * F_NUMBER**2)
            name = f"IMG_{number * options.exposures + k + 1:04}"
            if options.kind == "jpeg":
                codes = np.round(255 * camera_curve(signals(radiance, exposure, options.iso, rng))).astype(np.uint8)
                Image.fromarray(codes).save(options.out / f"{name}.JPG", quality=95, subsampling=0, exif=exif(seconds, options.iso, stamp))
            else:
                camera = np.maximum(radiance @ camera_from_rec709.T, 0)
                write_dng(options.out / f"{name}.DNG", signals(camera, exposure, options.iso, rng), neutral, seconds, options.iso, stamp, options.codec)
    (options.out / "truth.json").write_text(json.dumps({"radiance_factor": factor, "views": [p.stem for p in paths], "neutral": neutral.tolist()}))


main()
