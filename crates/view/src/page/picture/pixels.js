/** Numbers of a picture: the value of a pixel, the histogram, an exposure that suits it. */

import { fromHalf } from "../math/half.js";
import { unproject } from "../math/lens.js";

/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../scene/scene.js").Frame} Frame */
/** @typedef {import("../math/lens.js").Lens} Lens */
/**
 * What a pixel holds, in the units of the data set.
 * @typedef {{ x: number, y: number, radiance: Vec3, luminance: number, depth: number | null, alpha: number | null, position: Vec3 | null }} Sample
 */

/** Luminance of middle grey, as a part of white. */
export const MIDDLE_GREY = 0.18;

/** @param {Frame} frame @param {number} i @returns {Vec3} */
const radianceAt = (frame, i) => [fromHalf(frame.rgb[3 * i]) * frame.head.scale, fromHalf(frame.rgb[3 * i + 1]) * frame.head.scale, fromHalf(frame.rgb[3 * i + 2]) * frame.head.scale];

/** @param {Vec3} rgb @param {Vec3} weights */
const luminanceOf = (rgb, weights) => rgb[0] * weights[0] + rgb[1] * weights[1] + rgb[2] * weights[2];

/** The pixel at a place of the picture, 0 to 1 each; null outside. @param {Frame} frame @param {Lens | null} lens @param {number} u @param {number} v @param {Vec3} weights @returns {Sample | null} */
export function sampleAt(frame, lens, u, v, weights) {
  const { width, height } = frame.head;
  const [x, y] = [Math.floor(u * width), Math.floor(v * height)];
  if (x < 0 || y < 0 || x >= width || y >= height) return null;
  const i = y * width + x;
  const radiance = radianceAt(frame, i);
  const z = frame.depth ? frame.depth[i] : Infinity;
  const depth = z < 1e30 ? z : null;
  const position = depth !== null && lens ? unproject(lens, x + 0.5, y + 0.5, depth) : null;
  return { x, y, radiance, luminance: luminanceOf(radiance, weights), depth, alpha: frame.alpha ? fromHalf(frame.alpha[i]) : null, position };
}

/** Luminances of about `count` pixels, spread over the picture. @param {Frame} frame @param {Vec3} weights @param {number} count */
function luminances(frame, weights, count) {
  const pixels = frame.head.width * frame.head.height;
  // No divisor of the width, so that samples do not line up in columns.
  const step = Math.max(1, Math.floor(pixels / count)) | 1;
  const values = [];
  for (let i = 0; i < pixels; i += step) values.push(luminanceOf(radianceAt(frame, i), weights));
  return values;
}

/** Counts by stops of luminance relative to `unit`. @param {Frame} frame @param {Vec3} weights @param {{ unit: number, low: number, high: number, bins: number }} range */
export function histogram(frame, weights, { unit, low, high, bins }) {
  const counts = new Float64Array(bins);
  for (const value of luminances(frame, weights, 15000)) {
    if (!(value > 0)) continue;
    const at = ((Math.log2(value / unit) - low) / (high - low)) * bins;
    counts[Math.min(bins - 1, Math.max(0, Math.floor(at)))]++;
  }
  return counts;
}

/** The exposure at which the mean of the logarithm of luminance is middle grey; null for a black picture. @param {Frame} frame @param {Vec3} weights @param {number} unit radiance that is 1 at exposure 0 */
export function suitableExposure(frame, weights, unit) {
  let [sum, count] = [0, 0];
  for (const value of luminances(frame, weights, 8000)) {
    if (!(value > unit * 1e-6)) continue;
    sum += Math.log2(value / unit);
    count++;
  }
  return count === 0 ? null : Math.log2(MIDDLE_GREY) - sum / count;
}

/** The error of a luminance against another, of a kind. @param {number} a @param {number} b @param {import("../display/falsecolor.js").ErrorKind} kind */
const errorOf = (a, b, kind) => (kind === "relative" ? Math.abs(a - b) / b : kind === "signed" ? Math.log2(a / b) : Math.abs(Math.log2(a / b)));

/**
 * Numbers of a map of errors: the mean, the size that 95 % do not exceed, and the share that the mask
 * hides; null where nothing counts. `mask` has weights of the other picture's pixels, `weights` are
 * those of R, G, B in each luminance, which is at least `least`.
 * @param {Frame} frame @param {Frame} other
 * @param {{ weights: [Vec3, Vec3], mask: Uint16Array | null, kind: import("../display/falsecolor.js").ErrorKind, least: number }} how
 */
export function errorFacts(frame, other, { weights, mask, kind, least }) {
  const { width, height } = other.head;
  const pixels = width * height;
  const step = Math.max(1, Math.ceil(pixels / 200000)) | 1;
  let [sum, total, hidden, all] = [0, 0, 0, 0];
  /** @type {{ value: number, weight: number }[]} */
  const sizes = [];
  for (let i = 0; i < pixels; i += step) {
    const weight = mask ? fromHalf(mask[i]) : 1;
    all++;
    hidden += 1 - weight;
    if (weight === 0) continue;
    const [x, y] = [(i % width) + 0.5, Math.floor(i / width) + 0.5];
    const at = Math.floor((y / height) * frame.head.height) * frame.head.width + Math.floor((x / width) * frame.head.width);
    const [a, b] = [luminanceOf(radianceAt(frame, at), weights[0]), luminanceOf(radianceAt(other, i), weights[1])].map((value) => Math.max(value, least));
    const error = errorOf(a, b, kind);
    if (!Number.isFinite(error)) continue;
    sum += weight * error;
    total += weight;
    sizes.push({ value: Math.abs(error), weight });
  }
  if (total === 0) return null;
  return { mean: sum / total, high: quantile(sizes, 0.95), masked: hidden / all };
}

/** The least value that this part of all weight does not exceed; sorts the values. @param {{ value: number, weight: number }[]} values @param {number} part */
export function quantile(values, part) {
  values.sort((a, b) => a.value - b.value);
  const total = values.reduce((sum, { weight }) => sum + weight, 0);
  let below = 0;
  return values.find(({ weight }) => (below += weight) >= part * total)?.value ?? 0;
}

/** A number for people: four digits, without a row of zeros. @param {number | null | undefined} v */
export function text(v) {
  if (v === null || v === undefined || Number.isNaN(v)) return "–";
  const size = Math.abs(v);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return v.toExponential(2);
  return v.toPrecision(4);
}

/** A number with its sign. @param {number} v */
export const signed = (v, digits = 1) => (Number.isFinite(v) ? `${v < 0 ? "−" : "+"}${Math.abs(v).toFixed(digits)}` : "–");
