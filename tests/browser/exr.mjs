// Reads OpenEXR files as the program and the page write them: scan lines, ZIP or no compression.

import { inflateSync } from "node:zlib";

const half = (bits) => {
  const [sign, exponent] = [bits & 0x8000 ? -1 : 1, (bits >> 10) & 31];
  return sign * (exponent === 0 ? (bits & 1023) * 2 ** -24 : exponent === 31 ? Infinity : (1 + (bits & 1023) / 1024) * 2 ** (exponent - 15));
};

/** Attributes by name, the size, and the numbers of each channel, line by line. */
export function exrOf(bytes) {
  let at = 8;
  const text = () => {
    const end = bytes.indexOf(0, at);
    const found = bytes.toString("latin1", at, end);
    at = end + 1;
    return found;
  };
  const attributes = {};
  for (let name = text(); name; name = text()) {
    const type = text();
    const size = bytes.readInt32LE(at);
    attributes[name] = { type, content: bytes.subarray(at + 4, at + 4 + size) };
    at += 4 + size;
  }
  const list = attributes.channels.content;
  const channels = [];
  for (let i = 0; list[i]; i += 16) {
    const end = list.indexOf(0, i);
    channels.push({ name: list.toString("latin1", i, end), bytes: list.readInt32LE(end + 1) === 1 ? 2 : 4 });
    i = end + 1;
  }
  const [left, top, right, bottom] = [0, 4, 8, 12].map((i) => attributes.dataWindow.content.readInt32LE(i));
  const [width, height] = [right - left + 1, bottom - top + 1];
  const compression = attributes.compression.content[0];
  const lines = { 0: 1, 2: 1, 3: 16 }[compression];
  const lineBytes = width * channels.reduce((sum, channel) => sum + channel.bytes, 0);
  const planes = Object.fromEntries(channels.map(({ name }) => [name, new Float64Array(width * height)]));
  for (let block = 0; block < Math.ceil(height / lines); block++) {
    const place = Number(bytes.readBigUInt64LE(at + 8 * block));
    const [first, size] = [bytes.readInt32LE(place) - top, bytes.readInt32LE(place + 4)];
    let data = bytes.subarray(place + 8, place + 8 + size);
    const expected = Math.min(lines, height - first) * lineBytes;
    if (size < expected) {
      const turned = inflateSync(data);
      for (let i = 1; i < turned.length; i++) turned[i] = turned[i] + turned[i - 1] - 128;
      const middle = Math.ceil(turned.length / 2);
      data = Buffer.from(turned.map((_, i) => turned[(i & 1 ? middle : 0) + (i >> 1)]));
    }
    let from = 0;
    for (let y = first; y < first + expected / lineBytes; y++) {
      for (const channel of channels) {
        for (let x = 0; x < width; x++, from += channel.bytes) planes[channel.name][y * width + x] = channel.bytes === 2 ? half(data.readUInt16LE(from)) : data.readFloatLE(from);
      }
    }
  }
  return { attributes, width, height, channels, planes };
}
