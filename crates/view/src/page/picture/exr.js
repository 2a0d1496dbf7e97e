/**
 * OpenEXR of a picture that the page rendered, for a page without the program: one part of scan
 * lines, ZIP compression in blocks of 16 (openexr.com, "OpenEXR file layout"). Radiance is as it
 * was rendered: half floats, or single ones where they are multiplied by a power of two; A is half,
 * Z single.
 */

import { fromHalf } from "../math/half.js";

/** @typedef {import("../scene/scene.js").Frame} Frame */
/** A channel: its name, bytes of a number, and the number of a pixel as little-endian bits. @typedef {{ name: string, bytes: 2 | 4, put: (view: DataView, at: number, pixel: number) => void }} Channel */
/** @typedef {[number, number][]} Chromaticities */

/** The first bytes of every file: magic number and version. */
const MAGIC = [0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
/** Lines of a block, and the number of its compression. */
const ZIP = { lines: 16, number: 3 };
/** Depth where there is nothing, as the program writes it. */
const FAR_DEPTH = 1e10;

/** Channels in the order of their names. @param {Frame} frame @returns {Channel[]} */
function channelsOf({ head, rgb, alpha, depth }) {
  const isExact = head.scale === 1;
  /** @type {Channel[]} */
  const channels = ["B", "G", "R"].map((name) => {
    const c = "RGB".indexOf(name);
    return {
      name,
      bytes: isExact ? 2 : 4,
      put: (view, at, pixel) => (isExact ? view.setUint16(at, rgb[3 * pixel + c], true) : view.setFloat32(at, fromHalf(rgb[3 * pixel + c]) * head.scale, true)),
    };
  });
  if (alpha) channels.unshift({ name: "A", bytes: 2, put: (view, at, pixel) => view.setUint16(at, alpha[pixel], true) });
  if (depth) channels.push({ name: "Z", bytes: 4, put: (view, at, pixel) => view.setFloat32(at, Math.min(depth[pixel], FAR_DEPTH), true) });
  return channels;
}

/** Bytes that are written one after the other. */
class Writer {
  /** @type {number[]} */ bytes = [];

  /** @param {string} text */
  text(text) {
    this.bytes.push(...new TextEncoder().encode(text), 0);
  }

  /** @param {...number} values */
  ints(...values) {
    for (const value of values) this.bytes.push(value & 255, (value >> 8) & 255, (value >> 16) & 255, (value >> 24) & 255);
  }

  /** @param {...number} values */
  floats(...values) {
    this.bytes.push(...new Uint8Array(new Float32Array(values).buffer));
  }

  /** @param {string} name @param {string} type @param {(writer: Writer) => void} content */
  attribute(name, type, content) {
    const inner = new Writer();
    content(inner);
    this.text(name);
    this.text(type);
    this.ints(inner.bytes.length);
    this.bytes.push(...inner.bytes);
  }
}

/** @param {Frame} frame @param {Channel[]} channels @param {Chromaticities} chromaticities @param {string} space */
function header({ head: { width, height } }, channels, chromaticities, space) {
  const writer = new Writer();
  writer.bytes.push(...MAGIC);
  writer.attribute("channels", "chlist", (list) => {
    for (const { name, bytes } of channels) {
      list.text(name);
      list.ints(bytes === 2 ? 1 : 2, 0, 1, 1);
    }
    list.bytes.push(0);
  });
  writer.attribute("chromaticities", "chromaticities", (all) => all.floats(...chromaticities.flat()));
  writer.attribute("colorInteropID", "string", (one) => one.bytes.push(...new TextEncoder().encode(space)));
  writer.attribute("compression", "compression", (one) => one.bytes.push(ZIP.number));
  for (const name of ["dataWindow", "displayWindow"]) writer.attribute(name, "box2i", (box) => box.ints(0, 0, width - 1, height - 1));
  writer.attribute("lineOrder", "lineOrder", (one) => one.bytes.push(0));
  writer.attribute("pixelAspectRatio", "float", (one) => one.floats(1));
  writer.attribute("screenWindowCenter", "v2f", (two) => two.floats(0, 0));
  writer.attribute("screenWindowWidth", "float", (one) => one.floats(1));
  writer.bytes.push(0);
  return new Uint8Array(writer.bytes);
}

/** Deflates a block: bytes at even places, then those at odd ones, as differences. @param {Uint8Array<ArrayBuffer>} raw */
async function deflated(raw) {
  const turned = new Uint8Array(raw.length);
  const half = Math.ceil(raw.length / 2);
  for (let i = 0; i < raw.length; i++) turned[(i & 1 ? half : 0) + (i >> 1)] = raw[i];
  for (let i = raw.length - 1; i > 0; i--) turned[i] = turned[i] - turned[i - 1] + 128;
  const packed = new Uint8Array(await new Response(new Blob([turned]).stream().pipeThrough(new CompressionStream("deflate"))).arrayBuffer());
  // A block that does not become smaller stays as it was.
  return packed.length < raw.length ? packed : raw;
}

/** Encodes a picture whose colour space has these chromaticities of R, G, B and white. `space` is its name, of the Color Interop Forum. @param {Frame} frame @param {Chromaticities} chromaticities @param {string} space @returns {Promise<Blob>} */
export async function encodeExr(frame, chromaticities, space) {
  const { width, height } = frame.head;
  const channels = channelsOf(frame);
  const lineBytes = width * channels.reduce((sum, { bytes }) => sum + bytes, 0);
  const head = header(frame, channels, chromaticities, space);
  const starts = Array.from({ length: Math.ceil(height / ZIP.lines) }, (_, i) => i * ZIP.lines);
  const blocks = await Promise.all(starts.map(async (start) => {
    const lines = Math.min(ZIP.lines, height - start);
    const view = new DataView(new ArrayBuffer(lines * lineBytes));
    let at = 0;
    for (let y = start; y < start + lines; y++) {
      for (const { bytes, put } of channels) for (let x = 0; x < width; x++, at += bytes) put(view, at, y * width + x);
    }
    const content = await deflated(new Uint8Array(view.buffer));
    return [new Uint8Array(new Int32Array([start, content.length]).buffer), content];
  }));
  const places = new BigUint64Array(blocks.length);
  let at = head.length + places.byteLength;
  blocks.forEach(([two, content], i) => {
    places[i] = BigInt(at);
    at += two.length + content.length;
  });
  return new Blob([head, places, ...blocks.flat()], { type: "image/x-exr" });
}
