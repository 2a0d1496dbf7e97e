//! OpenUSD's binary form (crate files, `.usdc`) and packages (`.usdz`): the parts of them that
//! splats, meshes, lights and cameras need.
//!
//! A file has tables of tokens, strings, fields, sets of fields, paths and specs, each compressed,
//! and values in between, which fields point to. Written is version 0.8.0, which OpenUSD reads
//! since 2018; arrays of floats are not compressed, since their bits do not repeat. Versions 0.7 to
//! 0.13 are read, with compressed arrays of single floats, too.
//!
//! Sizes in a file are claims: counts are compared with what the compressed bytes can hold before
//! memory is taken.

mod cameras;
mod integers;
mod lights;
mod mesh;
mod numbers;
mod package;
mod reader;
mod splats;
mod tables;
mod writer;
mod written_tables;

pub(super) use cameras::read_cameras;
pub(super) use mesh::write_mesh;
pub(super) use package::{PackagePart, layer_in_package, write_package};
pub(super) use splats::{read, write};

/// First bytes of a crate file.
pub(crate) const MAGIC: &[u8; 8] = b"PXR-USDC";
/// First bytes of a package, which is a ZIP archive.
pub(crate) const PACKAGE_MAGIC: &[u8; 4] = b"PK\x03\x04";

/// Length of the header: magic, version, place of the table of contents, and reserve.
const HEADER_BYTES: usize = 88;

/// Types of values that are written or read (OpenUSD's `crateDataTypes.h`).
mod kind {
    pub(super) const BOOL: u8 = 1;
    pub(super) const INT: u8 = 3;
    pub(super) const HALF: u8 = 7;
    pub(super) const FLOAT: u8 = 8;
    pub(super) const DOUBLE: u8 = 9;
    pub(super) const STRING: u8 = 10;
    pub(super) const TOKEN: u8 = 11;
    pub(super) const ASSET_PATH: u8 = 12;
    pub(super) const MATRIX4D: u8 = 15;
    pub(super) const QUATD: u8 = 16;
    pub(super) const QUATF: u8 = 17;
    pub(super) const QUATH: u8 = 18;
    pub(super) const VEC3D: u8 = 23;
    pub(super) const VEC3F: u8 = 24;
    pub(super) const VEC3H: u8 = 25;
    pub(super) const DICTIONARY: u8 = 31;
    pub(super) const TOKEN_LIST_OP: u8 = 32;
    pub(super) const PATH_LIST_OP: u8 = 34;
    pub(super) const TOKEN_VECTOR: u8 = 41;
    pub(super) const SPECIFIER: u8 = 42;
    pub(super) const VARIABILITY: u8 = 44;
    pub(super) const TIME_SAMPLES: u8 = 46;
    pub(super) const DOUBLE_VECTOR: u8 = 48;
    pub(super) const VALUE_BLOCK: u8 = 51;
}

/// Kinds of specs.
mod spec {
    pub(super) const ATTRIBUTE: u32 = 1;
    pub(super) const PRIM: u32 = 6;
    pub(super) const PSEUDO_ROOT: u32 = 7;
    pub(super) const RELATIONSHIP: u32 = 8;
}

/// A value's type with its bits, or where they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct ValueRep(u64);

impl ValueRep {
    const ARRAY: u64 = 1 << 63;
    const INLINED: u64 = 1 << 62;
    const COMPRESSED: u64 = 1 << 61;
    const PAYLOAD: u64 = (1 << 48) - 1;

    fn inlined(kind: u8, bits: u32) -> Self {
        Self(Self::INLINED | u64::from(kind) << 48 | u64::from(bits))
    }

    fn at(kind: u8, offset: u64) -> Self {
        Self(u64::from(kind) << 48 | offset & Self::PAYLOAD)
    }

    fn array_at(kind: u8, offset: u64) -> Self {
        Self(Self::ARRAY | Self::at(kind, offset).0)
    }

    fn kind(self) -> u8 {
        (self.0 >> 48) as u8
    }

    fn is_array(self) -> bool {
        self.0 & Self::ARRAY != 0
    }

    fn is_inlined(self) -> bool {
        self.0 & Self::INLINED != 0
    }

    fn is_compressed(self) -> bool {
        self.0 & Self::COMPRESSED != 0
    }

    /// Returns the bits of an inlined value, or the place of another one.
    fn payload(self) -> u64 {
        self.0 & Self::PAYLOAD
    }
}
