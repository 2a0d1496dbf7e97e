/** The flat surface that a picture shows around a pixel, from its depths, which are soft and rough. */

import { unproject } from "../math/lens.js";
import { add, cross, dot, length, sub, times, unit } from "../math/vectors.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../scene/scene.js").Frame} Frame */
/** A plane: a point on it, and its normal towards the camera. @typedef {{ point: Vec3, normal: Vec3 }} Plane */

/** Half of the side of the patch, as a part of the picture's width. */
const PATCH = 0.06;
/** Rounds of the fit, and the part of the pixels that each keeps. */
const [ROUNDS, KEPT] = [5, 0.6];
/** Least cosine with up from which on a surface is level. */
const LEVEL = 0.75;

/** Solves for three unknowns by Cramer's rule; null where they are not determined. @param {number[][]} rows of a symmetric matrix @param {number[]} right */
function solved([[a, b, c], [, d, e], [, , f]], [p, q, r]) {
  const determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d);
  if (!(Math.abs(determinant) > 1e-30)) return null;
  return [
    (p * (d * f - e * e) - b * (q * f - e * r) + c * (q * e - d * r)) / determinant,
    (a * (q * f - e * r) - p * (b * f - c * e) + c * (b * r - c * q)) / determinant,
    (a * (d * r - e * q) - b * (b * r - c * q) + p * (b * e - c * d)) / determinant,
  ];
}

/** The inverse depth of a plane is linear in the pixels of a pinhole: fits it, leaving out what is far from it. @param {number[][]} samples places around the pixel and inverse depths */
function fitted(samples) {
  let kept = samples;
  let plane = null;
  for (let round = 0; round < ROUNDS && kept.length >= 6; round++) {
    const sums = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
    const right = [0, 0, 0];
    for (const [u, v, w] of kept) {
      const row = [u, v, 1];
      row.forEach((a, i) => {
        row.forEach((b, j) => (sums[i][j] += a * b));
        right[i] += a * w;
      });
    }
    const found = solved(sums, right);
    if (!found) return plane;
    plane = found;
    const off = (/** @type {number[]} */ [u, v, w]) => Math.abs(found[0] * u + found[1] * v + found[2] - w);
    kept = [...samples].sort((a, b) => off(a) - off(b)).slice(0, Math.ceil(samples.length * KEPT));
  }
  return plane;
}

/**
 * The surface at a pixel; null where there is none. One that is about level is level.
 * @param {Frame} frame @param {Lens} lens a pinhole @param {number} x @param {number} y @param {Vec3} up @returns {Plane | null}
 */
export function surfaceAt({ head, depth }, lens, x, y, up) {
  if (!depth || lens.projection.kind !== "pinhole") return null;
  const half = Math.max(4, Math.round(head.width * PATCH));
  const samples = [];
  for (let row = Math.max(0, y - half); row < Math.min(head.height, y + half + 1); row++) {
    for (let column = Math.max(0, x - half); column < Math.min(head.width, x + half + 1); column++) {
      const z = depth[row * head.width + column];
      if (z < 1e30) samples.push([(column - x) / half, (row - y) / half, 1 / z]);
    }
  }
  const plane = fitted(samples);
  if (!plane) return null;
  const at = (/** @type {number} */ u, /** @type {number} */ v) => {
    const inverse = plane[0] * u + plane[1] * v + plane[2];
    return inverse > 0 ? unproject(lens, x + 0.5 + u * half, y + 0.5 + v * half, 1 / inverse) : null;
  };
  const [point, right, below] = [at(0, 0), at(0.5, 0), at(0, 0.5)];
  if (!point || !right || !below) return null;
  const across = cross(sub(right, point), sub(below, point));
  if (!(length(across) > 0)) return null;
  const facing = unit(across);
  const normal = dot(facing, sub(lens.eye, point)) < 0 ? times(facing, -1) : facing;
  return { point, normal: dot(normal, up) > LEVEL ? up : normal };
}

/** Where a ray meets a plane; null if it does not. @param {Plane} plane @param {Vec3} eye @param {Vec3} ray @returns {Vec3 | null} */
export function meeting({ point, normal }, eye, ray) {
  const away = dot(sub(point, eye), normal) / dot(ray, normal);
  return Number.isFinite(away) && away > 0 ? add(eye, times(ray, away)) : null;
}
