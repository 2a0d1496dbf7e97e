/** From what a user chooses to the camera of a picture, and from its pixels to the world. */

import { add, dot, sub, times } from "./math.js";

/** @typedef {import("./math.js").Vec3} Vec3 */
/** @typedef {import("./math.js").Axes} Axes */
/** @typedef {import("./scene.js").ViewCamera} ViewCamera */
/**
 * A posed pinhole camera of a picture of `width` x `height` pixels.
 * @typedef {{ eye: Vec3, axes: Axes, fx: number, fy: number, cx: number, cy: number, width: number, height: number }} Lens
 */

/** @param {ViewCamera} camera @returns {{ eye: Vec3, axes: Axes }} */
export function poseOf(camera) {
  const m = camera.transform_matrix;
  const column = (/** @type {number} */ c) => /** @type {Vec3} */ ([m[0][c], m[1][c], m[2][c]]);
  return { axes: { right: column(0), up: column(1), back: column(2) }, eye: column(3) };
}

/** Vertical field of view of a camera, degrees. @param {ViewCamera} camera */
export const fovOf = (camera) => (2 * Math.atan(camera.h / (2 * camera.fl_y)) * 180) / Math.PI;

/** Camera of the data set, for a picture of `width` x `height` pixels. @param {ViewCamera} camera @param {number} width @param {number} height @returns {Lens} */
export function lensOfView(camera, width, height) {
  const [x, y] = [width / camera.w, height / camera.h];
  return { ...poseOf(camera), fx: camera.fl_x * x, fy: camera.fl_y * y, cx: camera.cx * x, cy: camera.cy * y, width, height };
}

/** @param {{ eye: Vec3, axes: Axes, fov: number }} state @param {number} width @param {number} height @returns {Lens} */
export function lensOf(state, width, height) {
  const f = height / (2 * Math.tan((state.fov * Math.PI) / 360));
  return { eye: state.eye, axes: state.axes, fx: f, fy: f, cx: width / 2, cy: height / 2, width, height };
}

/**
 * A lens of the world in the coordinates that the splats are held in, near their own origin, so that
 * single floats resolve them. @param {Lens} lens @param {import("./scene.js").Frame3} frame @returns {Lens}
 */
export function toLocal(lens, { rotation, scale, translation }) {
  const turned = (/** @type {Vec3} */ v) => /** @type {Vec3} */ ([0, 1, 2].map((c) => rotation[0][c] * v[0] + rotation[1][c] * v[1] + rotation[2][c] * v[2]));
  const { right, up, back } = lens.axes;
  const axes = { right: turned(right), up: turned(up), back: turned(back) };
  return { ...lens, axes, eye: times(turned(sub(lens.eye, translation)), 1 / scale) };
}

/** The camera as a frame of transforms.json. @param {Lens} lens */
export function toJson(lens) {
  const { right, up, back } = lens.axes;
  const row = (/** @type {0 | 1 | 2} */ i) => [right[i], up[i], back[i], lens.eye[i]];
  return JSON.stringify({ transform_matrix: [row(0), row(1), row(2), [0, 0, 0, 1]], fl_x: lens.fx, fl_y: lens.fy, cx: lens.cx, cy: lens.cy });
}

/** The point that a place in the picture (pixels) shows at a depth along the viewing axis. @param {Lens} lens @param {number} x @param {number} y @param {number} depth @returns {Vec3} */
export function unproject(lens, x, y, depth) {
  const { right, up, back } = lens.axes;
  const [u, v] = [((x - lens.cx) / lens.fx) * depth, ((y - lens.cy) / lens.fy) * depth];
  return add(lens.eye, add(add(times(right, u), times(up, -v)), times(back, -depth)));
}

/** Pixel and depth of a point; null behind the camera. @param {Lens} lens @param {Vec3} point */
export function project(lens, point) {
  const p = sub(point, lens.eye);
  const depth = -dot(p, lens.axes.back);
  if (depth <= 0) return null;
  return { x: lens.cx + (lens.fx * dot(p, lens.axes.right)) / depth, y: lens.cy - (lens.fy * dot(p, lens.axes.up)) / depth, depth };
}
