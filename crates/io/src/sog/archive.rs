//! ZIP archives without compression: pictures are compressed already.

use crc::{CRC_32_ISO_HDLC, Crc};

/// Checksum of ZIP.
pub(super) static CRC: Crc<u32, crc::Table<16>> = Crc::<u32, crc::Table<16>>::new(&CRC_32_ISO_HDLC);

/// First bytes of headers, of the directory's entries, and of its end.
pub(super) const LOCAL: u32 = 0x0403_4b50;
pub(super) const ENTRY: u32 = 0x0201_4b50;
pub(super) const END: u32 = 0x0605_4b50;
/// Version of ZIP that is needed: 1.0, without compression.
const VERSION: u16 = 10;
/// 1 January 1980, so that equal scenes make equal files.
const DATE: u16 = 0x21;

/// A file of an archive.
pub(super) struct File {
    pub(super) name: &'static str,
    pub(super) bytes: Vec<u8>,
}

/// Returns an archive of files; `None` if it has more than 4 GiB.
pub(super) fn archive(files: &[File]) -> Option<Vec<u8>> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for File { name, bytes } in files {
        let size = u32::try_from(bytes.len()).ok()?;
        let at = u32::try_from(out.len()).ok()?;
        let common =
            [&[0u16, 0, 0, DATE].map(u16::to_le_bytes).concat()[..], &[CRC.checksum(bytes), size, size].map(u32::to_le_bytes).concat()]
                .concat();
        let lengths = [(name.len() as u16).to_le_bytes(), 0u16.to_le_bytes()].concat();
        out.extend([&LOCAL.to_le_bytes()[..], &VERSION.to_le_bytes(), &common, &lengths, name.as_bytes(), bytes].concat());
        let versions = [VERSION; 2].map(u16::to_le_bytes).concat();
        directory.extend([&ENTRY.to_le_bytes()[..], &versions, &common, &lengths, &[0; 10], &at.to_le_bytes(), name.as_bytes()].concat());
    }
    let (at, count) = (u32::try_from(out.len()).ok()?, u16::try_from(files.len()).ok()?);
    let directory_bytes = u32::try_from(directory.len()).ok()?;
    out.extend(directory);
    out.extend(END.to_le_bytes());
    out.extend([0, 0, count, count].map(u16::to_le_bytes).concat());
    out.extend([directory_bytes, at].map(u32::to_le_bytes).concat());
    out.extend(0u16.to_le_bytes());
    Some(out)
}
