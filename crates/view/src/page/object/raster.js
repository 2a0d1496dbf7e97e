/** Draws triangles of a mesh into a buffer of depth: which triangle is seen at each of four places of a pixel. */

import { dot, sub } from "../math/vectors.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */

/** Places along each side of a pixel. */
export const SIDE = 2;
/** No triangle. */
export const NONE = 0xffffffff;

/** Rows and columns of a picture. @typedef {{ left: number, top: number, right: number, bottom: number }} Box */

/** Pixels and depths of points of the world. @param {Lens} lens a pinhole @param {Float64Array} points */
function seen(lens, points) {
  const places = new Float64Array(points.length);
  const { right, up, back } = lens.axes;
  for (let i = 0; i < points.length; i += 3) {
    const p = sub([points[i], points[i + 1], points[i + 2]], lens.eye);
    const z = -dot(p, back);
    [places[i], places[i + 1], places[i + 2]] = [lens.cx + (lens.fx * dot(p, right)) / z, lens.cy - (lens.fy * dot(p, up)) / z, z];
  }
  return places;
}

/**
 * The triangles that are seen in a box of the picture, by `SIDE` x `SIDE` places of each pixel, row by row.
 * @param {Lens} lens a pinhole @param {Float64Array} points corners in the world @param {Uint32Array} indices @param {Box} box
 */
export function rasterise(lens, points, indices, box) {
  const places = seen(lens, points);
  const [width, height] = [SIDE * (box.right - box.left), SIDE * (box.bottom - box.top)];
  const triangles = new Uint32Array(Math.max(0, width * height)).fill(NONE);
  const nearest = new Float32Array(triangles.length);
  for (let i = 0; i < indices.length; i += 3) {
    const [a, b, c] = [3 * indices[i], 3 * indices[i + 1], 3 * indices[i + 2]];
    // One that reaches behind the eye is left out.
    if (!(Math.min(places[a + 2], places[b + 2], places[c + 2]) > 0)) continue;
    const column = (/** @type {number} */ at) => (places[at] - box.left) * SIDE;
    const row = (/** @type {number} */ at) => (places[at + 1] - box.top) * SIDE;
    const [ax, ay, bx, by, cx, cy] = [column(a), row(a), column(b), row(b), column(c), row(c)];
    const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
    if (area === 0) continue;
    const [first, last] = [Math.max(0, Math.ceil(Math.min(ax, bx, cx) - 0.5)), Math.min(width - 1, Math.floor(Math.max(ax, bx, cx) - 0.5))];
    const [top, bottom] = [Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5)), Math.min(height - 1, Math.floor(Math.max(ay, by, cy) - 0.5))];
    // Inverse depth is linear in the picture.
    const [za, zb, zc] = [1 / places[a + 2], 1 / places[b + 2], 1 / places[c + 2]];
    for (let y = top; y <= bottom; y++) {
      for (let x = first; x <= last; x++) {
        const [px, py] = [x + 0.5, y + 0.5];
        const v = ((px - ax) * (cy - ay) - (py - ay) * (cx - ax)) / area;
        const w = ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / area;
        if (v < 0 || w < 0 || v + w > 1) continue;
        const z = za + v * (zb - za) + w * (zc - za);
        const at = y * width + x;
        if (z <= nearest[at]) continue;
        nearest[at] = z;
        triangles[at] = i / 3;
      }
    }
  }
  return { triangles, nearest, width };
}
