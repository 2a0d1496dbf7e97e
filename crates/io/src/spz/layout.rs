//! The numbers of SPZ: conversion from bytes and to bytes.

use glam::{DMat3, DVec3};
use luxel_core::{Similarity, Splats, sh};

/// "NGSP".
pub(super) const MAGIC: u32 = 0x5053_474e;
/// Flag: trained with anti-aliasing (Mip-splatting).
pub(super) const FLAG_ANTIALIASED: u8 = 1;
/// Flag: records of vendors between the header and the table of streams, in versions before 4 behind
/// the blocks.
pub(super) const FLAG_EXTENSIONS: u8 = 2;
/// Record of the axes, `SPZ_ADOBE_coordinate_system`: a u32 of the numbers of [`FileAxes`].
pub(super) const AXES_EXTENSION: u32 = 0xadbe_0003;
/// Right, up, back, of those numbers.
pub(super) const RIGHT_UP_BACK: u32 = 4;
/// Bytes of the header inside of the gzip stream.
pub(super) const LEGACY_HEADER: usize = 16;
/// Bytes of version 4's header.
pub(super) const HEADER: usize = 32;
/// Coefficient of the constant harmonic to colour bytes.
const COLOR_SCALE: f32 = 0.15;
/// Magnitude of 1 / sqrt 2 in a rotation's component.
const ROTATION_STEPS: f32 = 511.0;

/// Returns the change of axes between right, up, back and right, down, forward, which is its own
/// inverse.
pub(super) fn axes() -> Similarity {
    Similarity::turn(DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0))).unwrap_or(Similarity::IDENTITY)
}

/// The axes of a file: the directions of x, y and z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FileAxes([char; 3]);

impl FileAxes {
    /// The format's convention.
    pub(super) const RIGHT_UP_BACK: Self = Self(['R', 'U', 'B']);

    /// Returns the axes of a number of the extension: x to the left or right, y down or up, z back or
    /// forward; from 9 on y and z exchanged.
    pub(super) fn from_code(code: u32) -> Option<Self> {
        let at = code.checked_sub(1).filter(|at| *at < 16)?;
        let pick = |bit: u32, names: [char; 2]| if at >> bit & 1 == 1 { names[1] } else { names[0] };
        Some(Self(match at < 8 {
            true => [pick(0, ['L', 'R']), pick(1, ['D', 'U']), pick(2, ['B', 'F'])],
            false => [pick(0, ['L', 'R']), pick(2, ['F', 'B']), pick(1, ['D', 'U'])],
        }))
    }

    /// Takes splats to right, down, forward. Axes of a left hand are a turn and the inversion of all
    /// three, in which harmonics of odd degree change their sign.
    pub(super) fn apply(self, splats: &mut Splats) {
        let direction = |axis: char| match axis {
            'R' => DVec3::X,
            'L' => DVec3::NEG_X,
            'D' => DVec3::Y,
            'U' => DVec3::NEG_Y,
            'F' => DVec3::Z,
            _ => DVec3::NEG_Z,
        };
        let [x, y, z] = self.0.map(direction);
        let matrix = DMat3::from_cols(x, y, z);
        let is_mirrored = matrix.determinant() < 0.0;
        let turn = if is_mirrored { -1.0 * matrix } else { matrix };
        Similarity::turn(turn).unwrap_or(Similarity::IDENTITY).apply(splats);
        if is_mirrored {
            splats.position.iter_mut().for_each(|position| *position = position.map(|v| -v));
            let stride = 3 * splats.color_model.sh_coefficients();
            for (i, value) in splats.sh.iter_mut().enumerate() {
                // The coefficients of degree l are those from l squared on.
                if (i % stride / 3).isqrt() % 2 == 1 {
                    *value = -*value;
                }
            }
        }
    }
}

/// Returns the bytes per splat of each block, in the file's order: positions, opacities, colours,
/// scales, rotations, harmonics.
pub(super) fn block_bytes(version: u32, degree: usize) -> [usize; 6] {
    [9, 1, 3, 3, if version >= 3 { 4 } else { 3 }, 3 * (sh::coefficients(degree) - 1)]
}

fn to_byte(value: f32) -> u8 {
    // NaN and values below 0 become 0, values above 255 become 255.
    value.round() as u8
}

/// Largest number of 23 bits, as fixed-point coordinates have.
pub(super) const MAX_FIXED: f32 = 8_388_607.0;
/// Most bits behind the point.
pub(super) const MAX_FRACTIONAL_BITS: u8 = 20;

/// Returns the bits behind the point that the largest coordinate leaves of 23, at most 20.
pub(super) fn fractional_bits(largest: f32) -> u8 {
    let fits = |bits: &u8| largest * ((1u32 << bits) as f32) < MAX_FIXED;
    (0..=MAX_FRACTIONAL_BITS).rev().find(fits).unwrap_or(0)
}

pub(super) fn pack_coordinate(value: f32, bits: u8) -> [u8; 3] {
    let fixed = (f64::from(value) * f64::from(1u32 << bits)).round().clamp(-8_388_608.0, 8_388_607.0) as i32;
    let [a, b, c, _] = fixed.to_le_bytes();
    [a, b, c]
}

pub(super) fn unpack_coordinate([a, b, c]: [u8; 3], bits: u8) -> f32 {
    // Into the upper bytes and back, for the sign.
    let fixed = i32::from_le_bytes([0, a, b, c]) >> 8;
    fixed as f32 / (1u32 << bits) as f32
}

pub(super) fn pack_opacity(opacity: f32) -> u8 {
    to_byte(opacity * 255.0)
}

pub(super) fn unpack_opacity(byte: u8) -> f32 {
    f32::from(byte) / 255.0
}

pub(super) fn pack_color(dc: f32) -> u8 {
    to_byte(dc * (COLOR_SCALE * 255.0) + 127.5)
}

pub(super) fn unpack_color(byte: u8) -> f32 {
    (f32::from(byte) / 255.0 - 0.5) / COLOR_SCALE
}

pub(super) fn pack_log_scale(value: f32) -> u8 {
    to_byte((value + 10.0) * 16.0)
}

pub(super) fn unpack_log_scale(byte: u8) -> f32 {
    f32::from(byte) / 16.0 - 10.0
}

/// Packs a harmonic: degree 1 keeps 5 bits, others 4, rounded to the middle of their bucket, as the
/// reference does by default: what compresses well.
pub(super) fn pack_harmonic(value: f32, degree: usize) -> u8 {
    let bucket = if degree == 1 { 8 } else { 16 };
    let fine = (value * 128.0).round() as i32 + 128;
    ((fine + bucket / 2).div_euclid(bucket) * bucket).clamp(0, 255) as u8
}

pub(super) fn unpack_harmonic(byte: u8) -> f32 {
    (f32::from(byte) - 128.0) / 128.0
}

/// Packs a quaternion x y z w, of length 1, w >= 0.
pub(super) fn pack_rotation_first_three(q: [f32; 4]) -> [u8; 3] {
    let sign = if q[3] < 0.0 { -1.0 } else { 1.0 };
    [0, 1, 2].map(|i| to_byte(sign * q[i] * 127.5 + 127.5))
}

pub(super) fn unpack_rotation_first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|b| f32::from(b) / 127.5 - 1.0);
    [x, y, z, (1.0 - (x * x + y * y + z * z)).max(0.0).sqrt()]
}

/// Packs a quaternion x y z w, of length 1.
pub(super) fn pack_rotation_smallest_three(q: [f32; 4]) -> [u8; 4] {
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let mut word = largest as u32;
    for (i, value) in q.iter().enumerate().filter(|(i, _)| *i != largest) {
        debug_assert_ne!(i, largest);
        let is_negative = (*value < 0.0) != (q[largest] < 0.0);
        let magnitude = ((ROTATION_STEPS * value.abs() * std::f32::consts::SQRT_2 + 0.5) as u32).min(511);
        word = word << 10 | u32::from(is_negative) << 9 | magnitude;
    }
    word.to_le_bytes()
}

pub(super) fn unpack_rotation_smallest_three(bytes: [u8; 4]) -> [f32; 4] {
    let mut word = u32::from_le_bytes(bytes);
    let largest = (word >> 30) as usize;
    let mut q = [0f32; 4];
    let mut sum = 0.0;
    for i in (0..4).rev().filter(|i| *i != largest) {
        let magnitude = (word & 511) as f32 / ROTATION_STEPS * std::f32::consts::FRAC_1_SQRT_2;
        q[i] = if word >> 9 & 1 == 1 { -magnitude } else { magnitude };
        sum += magnitude * magnitude;
        word >>= 10;
    }
    if let Some(value) = q.get_mut(largest) {
        *value = (1.0 - sum).max(0.0).sqrt();
    }
    q
}
