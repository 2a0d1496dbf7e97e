/** Splats as the server packs them (splats.rs): the head, and the rows of parameters. */

import { fromHalf } from "../half.js";

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
/** @typedef {{ splats: number, colorModel: string, parameters: number, rows: ("f32" | "f16")[], radianceScale: number, depthUnit: number, options: Options }} Head */
/** Splats: `row(n)` reads one parameter of all of them. @typedef {{ head: Head, row: (n: number) => Float32Array | Uint16Array }} Splats */

/** @param {ArrayBuffer} bytes @returns {Splats} */
export function parseSplats(bytes) {
  const broken = (/** @type {string} */ what) => new Error(`the scene came damaged: ${what}`);
  if (bytes.byteLength < 4) throw broken(`${bytes.byteLength} bytes`);
  const length = new DataView(bytes).getUint32(0, true);
  if (4 + length > bytes.byteLength) throw broken(`a head of ${length} bytes in ${bytes.byteLength}`);
  /** @type {Head} */
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  let at = 4 + length;
  const starts = head.rows.map((kind) => {
    const start = at;
    at += Math.ceil((head.splats * (kind === "f16" ? 2 : 4)) / 4) * 4;
    return start;
  });
  if (at !== bytes.byteLength) throw broken(`${bytes.byteLength} bytes, expected ${at}`);
  const row = (/** @type {number} */ n) => (head.rows[n] === "f16" ? new Uint16Array(bytes, starts[n], head.splats) : new Float32Array(bytes, starts[n], head.splats));
  return { head, row };
}

/** Writes numbers of splats from `first` on to a row of parameters. @param {Splats} splats @param {number} n @param {number} first @param {Float32Array} out */
export function copyRow(splats, n, first, out) {
  if (n >= splats.head.rows.length) return;
  const from = splats.row(n);
  if (from instanceof Float32Array) return out.set(from.subarray(first, first + out.length));
  for (let i = 0; i < out.length; i++) out[i] = fromHalf(from[first + i]);
}
