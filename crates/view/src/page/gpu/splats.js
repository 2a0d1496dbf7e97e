/** Splats as the server packs them (splats.rs): the head, and the rows of parameters. */

import { fromHalf } from "../math/half.js";

/**
 * @typedef {object} Options
 * @property {number} minAlpha
 * @property {number | null} minContribution null for none
 * @property {number} alphaFloor
 * @property {number} minTransmittance
 * @property {number} maxAlpha
 * @property {number} near
 * @property {number} dilationPx2
 * @property {boolean} compensatesOpacity
 * @property {boolean} smooths
 * @property {number} samples along the side of a pixel
 * @property {number} activeDegree
 * @property {[number, number, number]} background normalised units
 */
/** @typedef {{ splats: number, colorModel: string, parameters: number, rows: ("f32" | "f16")[], isDisplay: boolean, radianceScale: number, depthUnit: number, options: Options }} Head */
/** Splats: `row(n)` reads one parameter of all of them. @typedef {{ head: Head, row: (n: number) => Float32Array | Uint16Array }} Splats */

/** Numbers of half or single precision. @typedef {"f32" | "f16"} Kind */
/**
 * What edits change of splats: those that are gone; rows of which some numbers are new, those of
 * `changed` splats in their order. @typedef {{ removed: number[], changed: number[], rows: { row: number, values: Float32Array | Uint16Array }[] }} Changes
 */

/** Row of the opacity, before its logistic function, and a value at which nothing is seen. */
const OPACITY = { row: 10, none: -80 };

/** @param {string} what */
const broken = (what) => new Error(`the scene came damaged: ${what}`);

/** The head of a body, and where what follows it begins. @param {ArrayBuffer} bytes */
function headOf(bytes) {
  if (bytes.byteLength < 4) throw broken(`${bytes.byteLength} bytes`);
  const length = new DataView(bytes).getUint32(0, true);
  if (4 + length > bytes.byteLength) throw broken(`a head of ${length} bytes in ${bytes.byteLength}`);
  return { head: JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length))), at: 4 + length };
}

/** Bytes of a row, padded. @param {Kind} kind @param {number} count */
const rowBytes = (kind, count) => Math.ceil((count * (kind === "f16" ? 2 : 4)) / 4) * 4;

/** @param {ArrayBuffer} bytes @param {Kind} kind @param {number} at @param {number} count */
const numbers = (bytes, kind, at, count) => (kind === "f16" ? new Uint16Array(bytes, at, count) : new Float32Array(bytes, at, count));

/** @param {ArrayBuffer} bytes @returns {Splats} */
export function parseSplats(bytes) {
  const found = headOf(bytes);
  /** @type {Head} */
  const head = found.head;
  let { at } = found;
  const starts = head.rows.map((kind) => {
    const start = at;
    at += rowBytes(kind, head.splats);
    return start;
  });
  if (at !== bytes.byteLength) throw broken(`${bytes.byteLength} bytes, expected ${at}`);
  return { head, row: (n) => numbers(bytes, head.rows[n], starts[n], head.splats) };
}

/** The changes that edits make, as the server packs them (changes.rs), of so many splats. @param {ArrayBuffer} bytes @param {number} splats @returns {Changes} */
export function parseChanges(bytes, splats) {
  const found = headOf(bytes);
  /** @type {{ splats: number, removed: number, changed: number, rows: { row: number, kind: Kind }[] }} */
  const head = found.head;
  let { at } = found;
  if (head.splats !== splats) throw new Error(`the server's scene has ${head.splats} splats, the one in this page ${splats}; load the page again`);
  const maskBytes = Math.ceil(splats / 32) * 4;
  const sum = [head.removed, head.changed].filter(Boolean).length * maskBytes + head.rows.reduce((total, { kind }) => total + rowBytes(kind, head.changed), 0);
  if (at + sum !== bytes.byteLength) throw broken(`${bytes.byteLength} bytes, expected ${at + sum}`);
  const named = (/** @type {number} */ count) => {
    /** @type {number[]} */ const indices = [];
    if (count === 0) return indices;
    const mask = new Uint8Array(bytes, at, maskBytes);
    at += maskBytes;
    for (let i = 0; i < splats; i++) if ((mask[i >> 3] >> (i & 7)) & 1) indices.push(i);
    if (indices.length !== count) throw broken(`${indices.length} splats, expected ${count}`);
    return indices;
  };
  const [removed, changed] = [named(head.removed), named(head.changed)];
  const rows = head.rows.map(({ row, kind }) => {
    const values = numbers(bytes, kind, at, head.changed);
    at += rowBytes(kind, head.changed);
    return { row, values };
  });
  return { removed, changed, rows };
}

/** Whole rows with changes in them, by their numbers. @param {Splats} splats @param {Changes} changes @returns {Map<number, Float32Array<ArrayBuffer>>} */
export function changedRows(splats, { removed, changed, rows }) {
  /** @type {Map<number, Float32Array<ArrayBuffer>>} */
  const found = new Map();
  for (const { row, values } of rows) {
    const whole = wholeRow(splats, row);
    changed.forEach((splat, i) => (whole[splat] = values instanceof Float32Array ? values[i] : fromHalf(values[i])));
    found.set(row, whole);
  }
  if (removed.length) {
    const opacity = wholeRow(splats, OPACITY.row);
    for (const splat of removed) opacity[splat] = OPACITY.none;
    found.set(OPACITY.row, opacity);
  }
  return found;
}

/** One row of all splats. @param {Splats} splats @param {number} n */
export function wholeRow(splats, n) {
  const row = new Float32Array(splats.head.splats);
  copyRow(splats, n, 0, row);
  return row;
}

/** Writes numbers of splats from `first` on to a row of parameters. @param {Splats} splats @param {number} n @param {number} first @param {Float32Array} out */
export function copyRow(splats, n, first, out) {
  // Gains, the row behind that of the 3D filter, are 1 where there are none.
  if (n >= splats.head.rows.length) return void (n > splats.head.parameters && out.fill(1));
  const from = splats.row(n);
  if (from instanceof Float32Array) return out.set(from.subarray(first, first + out.length));
  for (let i = 0; i < out.length; i++) out[i] = fromHalf(from[first + i]);
}
