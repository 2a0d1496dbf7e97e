// Reads PNG files of 8 or 16 bits without an interlace, and writes grey ones.

import { deflateSync, inflateSync } from "node:zlib";

/** Channels by the type of colour. */
const CHANNELS = { 0: 1, 2: 3, 4: 2, 6: 4 };

/** The pixels of a PNG: its head, and the numbers of a pixel. */
export function pixelsOf(png) {
  let [at, data, head] = [8, [], null];
  while (at < png.length) {
    const [length, kind] = [png.readUInt32BE(at), png.toString("latin1", at + 4, at + 8)];
    const content = png.subarray(at + 8, at + 8 + length);
    if (kind === "IHDR") head = { width: content.readUInt32BE(0), height: content.readUInt32BE(4), bits: content[8], channels: CHANNELS[content[9]] };
    if (kind === "IDAT") data.push(content);
    at += 12 + length;
  }
  const raw = inflateSync(Buffer.concat(data));
  const { channels } = head;
  const step = (head.bits / 8) * channels;
  const stride = step * head.width;
  const out = Buffer.alloc(stride * head.height);
  for (let y = 0; y < head.height; y++) {
    const filter = raw[y * (stride + 1)];
    for (let x = 0; x < stride; x++) {
      const a = x >= step ? out[y * stride + x - step] : 0;
      const b = y ? out[(y - 1) * stride + x] : 0;
      const c = y && x >= step ? out[(y - 1) * stride + x - step] : 0;
      const p = a + b - c;
      const paeth = Math.abs(p - a) <= Math.abs(p - b) && Math.abs(p - a) <= Math.abs(p - c) ? a : Math.abs(p - b) <= Math.abs(p - c) ? b : c;
      out[y * stride + x] = raw[y * (stride + 1) + 1 + x] + [0, a, b, (a + b) >> 1, paeth][filter];
    }
  }
  const number = (x, y, c) => (head.bits === 8 ? out[y * stride + x * step + c] : out.readUInt16BE(y * stride + x * step + 2 * c));
  return { ...head, at: (x, y) => Array.from({ length: Math.min(3, channels) }, (_, c) => number(x, y, c)), all: (x, y) => Array.from({ length: channels }, (_, c) => number(x, y, c)) };
}

/** A grey picture of 8 bits. */
export function greyPng(width, height, grey) {
  const raw = Buffer.alloc(height * (width + 1));
  for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) raw[y * (width + 1) + 1 + x] = grey(x, y);
  const chunk = (kind, content) => {
    const [length, end] = [Buffer.alloc(4), Buffer.alloc(4)];
    length.writeUInt32BE(content.length);
    const body = Buffer.concat([Buffer.from(kind, "latin1"), content]);
    end.writeUInt32BE(crcOf(body));
    return Buffer.concat([length, body, end]);
  };
  const head = Buffer.alloc(13);
  head.writeUInt32BE(width, 0);
  head.writeUInt32BE(height, 4);
  head[8] = 8;
  return Buffer.concat([Buffer.from([137, 80, 78, 71, 13, 10, 26, 10]), chunk("IHDR", head), chunk("IDAT", deflateSync(raw)), chunk("IEND", Buffer.alloc(0))]);
}

/** The check sum of PNG. */
function crcOf(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) {
    crc ^= byte;
    for (let k = 0; k < 8; k++) crc = crc & 1 ? (crc >>> 1) ^ 0xedb88320 : crc >>> 1;
  }
  return (crc ^ 0xffffffff) >>> 0;
}
