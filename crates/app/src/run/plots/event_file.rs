//! TensorBoard's event file: records of TFRecord, each a message `Event` of Protocol Buffers.
//!
//! In: scalars by name, with step and time. Out: bytes as `tensorflow/core/util/event.proto` and
//! the
//! TFRecord format describe them: length, its masked CRC-32C, message, its masked CRC-32C.

use std::io::{self, Write};

use crc::{CRC_32_ISCSI, Crc};

/// CRC-32C, which TFRecord calls by its inventor's name, Castagnoli.
const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);

/// Added to a rotated checksum, so that checksums of records that hold checksums are not weak.
const MASK: u32 = 0xa282_ead8;

/// Types of fields in Protocol Buffers.
const VARINT: u64 = 0;
const FIXED_64: u64 = 1;
const BYTES: u64 = 2;
const FIXED_32: u64 = 5;

/// A number of a step.
pub(super) struct Scalar<'a> {
    /// Its name, by which a plot shows it.
    pub(super) name: &'a str,
    /// Its value.
    pub(super) value: f32,
}

/// An event file that is being written.
pub(super) struct EventFile<W> {
    out: W,
}

impl<W: Write> EventFile<W> {
    /// Writes the first record, which names the version of the format.
    pub(super) fn begin(out: W, time_s: f64) -> io::Result<Self> {
        let mut this = Self { out };
        let mut event = Message::default();
        event.double(1, time_s);
        event.bytes(3, b"brain.Event:2");
        this.record(&event.0)?;
        Ok(this)
    }

    /// Writes the scalars of a step in one write.
    pub(super) fn append<'a>(&mut self, time_s: f64, step: u64, scalars: impl Iterator<Item = Scalar<'a>>) -> io::Result<()> {
        let mut summary = Message::default();
        for Scalar { name, value } in scalars {
            let mut scalar = Message::default();
            scalar.bytes(1, name.as_bytes());
            scalar.float(2, value);
            summary.bytes(1, &scalar.0);
        }
        let mut event = Message::default();
        event.double(1, time_s);
        event.varint(2, step);
        event.bytes(5, &summary.0);
        self.record(&event.0)
    }

    fn record(&mut self, message: &[u8]) -> io::Result<()> {
        let length = (message.len() as u64).to_le_bytes();
        let record = [&length[..], &masked_crc(&length), message, &masked_crc(message)].concat();
        self.out.write_all(&record)
    }
}

fn masked_crc(bytes: &[u8]) -> [u8; 4] {
    CRC.checksum(bytes).rotate_right(15).wrapping_add(MASK).to_le_bytes()
}

/// A message of Protocol Buffers.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn key(&mut self, field: u64, kind: u64) {
        self.raw_varint(field << 3 | kind);
    }

    fn raw_varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn varint(&mut self, field: u64, value: u64) {
        self.key(field, VARINT);
        self.raw_varint(value);
    }

    fn double(&mut self, field: u64, value: f64) {
        self.key(field, FIXED_64);
        self.0.extend(value.to_le_bytes());
    }

    fn float(&mut self, field: u64, value: f32) {
        self.key(field, FIXED_32);
        self.0.extend(value.to_le_bytes());
    }

    fn bytes(&mut self, field: u64, value: &[u8]) {
        self.key(field, BYTES);
        self.raw_varint(value.len() as u64);
        self.0.extend(value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_those_of_tensorboard() {
        let mut out = Vec::new();
        let mut file = EventFile::begin(&mut out, 1.5).unwrap();
        file.append(2.5, 300, std::iter::once(Scalar { name: "loss", value: 0.25 })).unwrap();
        let hex: String = out.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, GOLDEN);
    }

    /// Made by `tensorboard.summary.writer.record_writer` of TensorBoard 2.21.0.
    const GOLDEN: &str = "1800000000000000a37f4b2209000000000000f83f1a0d627261696e2e4576656e743a322a28646c1b00000000\
        0000001a0d9e1309000000000000044010ac022a0d0a0b0a046c6f7373150000803e205d3896";
}
