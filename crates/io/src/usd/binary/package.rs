//! OpenUSD packages (`.usdz`): ZIP archives without compression, whose files begin at multiples of
//! 64 bytes. The first file is the scene.

use std::io::{self, Write};

use crc::{CRC_32_ISO_HDLC, Crc};

use super::tables::Cursor;

/// Checksum of ZIP.
static CRC: Crc<u32, crc::Table<16>> = Crc::<u32, crc::Table<16>>::new(&CRC_32_ISO_HDLC);

/// Alignment of files in a package, bytes.
const ALIGNMENT: usize = 64;
/// Length of a file's header without name and padding.
const LOCAL_BYTES: usize = 30;
/// First bytes of headers, of the directory's entries, and of its end.
const LOCAL: u32 = 0x0403_4b50;
const ENTRY: u32 = 0x0201_4b50;
const END: u32 = 0x0605_4b50;
/// Version of ZIP that is needed: 1.0, without compression.
const VERSION: u16 = 10;
/// 1 January 1980, so that equal scenes make equal files.
const DATE: u16 = 0x21;
/// A padding's number in a header's extra field; programs skip what they do not know.
const PADDING: u16 = 0x1986;

/// Checksum and length of what is written.
struct Sums {
    digest: crc::Digest<'static, u32, crc::Table<16>>,
    length: u64,
}

impl Write for Sums {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.digest.update(bytes);
        self.length += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A file of a package.
pub(in crate::usd) struct PackagePart<'a> {
    pub(in crate::usd) name: &'a str,
    /// Writes the file, the same each time.
    pub(in crate::usd) write: &'a dyn Fn(&mut dyn Write) -> io::Result<()>,
}

/// Writes a package; its first file is the scene.
pub(in crate::usd) fn write_package(out: &mut dyn Write, parts: &[PackagePart<'_>]) -> io::Result<()> {
    let too_large = |_| io::Error::other("a package holds at most 4 GiB; write .usdc");
    let common = [0u16, 0, 0, DATE].map(u16::to_le_bytes).concat();
    let (mut at, mut directory) = (0u64, Vec::new());
    for PackagePart { name, write } in parts {
        let mut sums = Sums { digest: CRC.digest(), length: 0 };
        write(&mut sums)?;
        let size = u32::try_from(sums.length).map_err(too_large)?;
        let header_at = u32::try_from(at).map_err(too_large)?;
        let behind_name = LOCAL_BYTES + name.len() + 4;
        let padding = (at as usize + behind_name).next_multiple_of(ALIGNMENT) - (at as usize + behind_name);
        let sizes = [sums.digest.finalize(), size, size].map(u32::to_le_bytes).concat();
        let lengths = |extra: usize| [name.len(), extra].map(|length| (length as u16).to_le_bytes()).concat();
        let mut local =
            [&LOCAL.to_le_bytes()[..], &VERSION.to_le_bytes(), &common, &sizes, &lengths(4 + padding), name.as_bytes()].concat();
        local.extend(PADDING.to_le_bytes());
        local.extend((padding as u16).to_le_bytes());
        local.resize(behind_name + padding, 0);
        out.write_all(&local)?;
        write(out)?;
        at += local.len() as u64 + u64::from(size);

        let versions = [VERSION; 2].map(u16::to_le_bytes).concat();
        directory.extend([&ENTRY.to_le_bytes()[..], &versions, &common, &sizes, &lengths(0), &[0; 10]].concat());
        directory.extend(header_at.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    out.write_all(&directory)?;
    let count = parts.len() as u16;
    let mut end = END.to_le_bytes().to_vec();
    end.extend([0, 0, count, count].map(u16::to_le_bytes).concat());
    end.extend([directory.len() as u32, u32::try_from(at).map_err(too_large)?].map(u32::to_le_bytes).concat());
    end.extend(0u16.to_le_bytes());
    out.write_all(&end)
}

/// Returns the bytes of the first file of a package, which is its scene.
///
/// # Errors
/// A file that is compressed, encrypted or truncated; sizes that are only behind it.
pub(in crate::usd) fn layer_in_package(bytes: &[u8]) -> Result<&[u8], String> {
    let mut at = Cursor { bytes, at: 0 };
    let header = at.take(LOCAL_BYTES)?;
    let u16_at = |i: usize| u16::from_le_bytes([header[i], header[i + 1]]);
    let (flags, method) = (u16_at(6), u16_at(8));
    if flags & 1 != 0 || method != 0 {
        return Err("the package's files are compressed or encrypted, expected neither; make it anew with usdzip".to_owned());
    }
    if flags & 8 != 0 {
        return Err("the package states the size of its scene behind it only; make it anew with usdzip".to_owned());
    }
    let size = u32::from_le_bytes([header[18], header[19], header[20], header[21]]) as usize;
    at.take(usize::from(u16_at(26)) + usize::from(u16_at(28)))?;
    at.take(size)
}
