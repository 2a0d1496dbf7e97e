/** From what a user chooses to the camera of a picture, and from its pixels to the world. */

import { angleAt, asPinhole, fieldsOf, opticsOf, PANORAMA, PINHOLE, placeOf, rayOf } from "./projections.js";
import { add, dot, sub, times } from "./vectors.js";

/** @typedef {import("./vectors.js").Vec3} Vec3 */
/** @typedef {import("./vectors.js").Axes} Axes */
/** @typedef {import("./projections.js").Projection} Projection */
/** @typedef {import("../scene/scene.js").ViewCamera} ViewCamera */
/**
 * A posed camera of a picture of `width` x `height` pixels; focal lengths of a panorama are pixels per radian.
 * @typedef {{ eye: Vec3, axes: Axes, fx: number, fy: number, cx: number, cy: number, width: number, height: number, projection: Projection }} Lens
 */
/** What a user chooses of a lens: degrees, of a pinhole from top to bottom, of a fisheye across its circle. @typedef {{ projection: import("./projections.js").Kind, fov: number, circle: number }} Choice */

/** @param {ViewCamera} camera @returns {{ eye: Vec3, axes: Axes }} */
export function poseOf(camera) {
  const m = camera.transform_matrix;
  const column = (/** @type {number} */ c) => /** @type {Vec3} */ ([m[0][c], m[1][c], m[2][c]]);
  return { axes: { right: column(0), up: column(1), back: column(2) }, eye: column(3) };
}

/** Vertical field of view of a pinhole, degrees. @param {ViewCamera} camera */
export const fovOf = (camera) => (2 * Math.atan(camera.h / (2 * camera.fl_y)) * 180) / Math.PI;

/** The choice that looks most like a camera of the data set. @param {ViewCamera} camera @returns {Partial<Choice>} */
export function choiceOf(camera) {
  const { projection, fx, fy } = opticsOf(camera);
  const choice = { projection: projection.kind, fov: fovOf(asPinhole(camera)) };
  if (projection.kind !== "fisheye") return choice;
  const nearest = Math.min(camera.w / fx, camera.h / fy) / 2;
  return { ...choice, circle: (360 * (angleAt(projection, nearest) ?? projection.angle)) / Math.PI };
}

/** Camera of the data set, for a picture of `width` x `height` pixels. @param {ViewCamera} camera @param {number} width @param {number} height @returns {Lens} */
export function lensOfView(camera, width, height) {
  const [x, y] = [width / camera.w, height / camera.h];
  const { projection, fx, fy } = opticsOf(camera);
  return { ...poseOf(camera), fx: fx * x, fy: fy * y, cx: camera.cx * x, cy: camera.cy * y, width, height, projection };
}

/** @param {{ eye: Vec3, axes: Axes } & Choice} state @param {number} width @param {number} height @returns {Lens} */
export function lensOf({ eye, axes, projection, fov, circle }, width, height) {
  const place = { eye, axes, cx: width / 2, cy: height / 2, width, height };
  if (projection === "equirectangular") return { ...place, fx: width / (2 * Math.PI), fy: height / Math.PI, projection: PANORAMA };
  const angle = (circle * Math.PI) / 360;
  const f = projection === "fisheye" ? Math.min(width, height) / (2 * angle) : height / (2 * Math.tan((fov * Math.PI) / 360));
  return { ...place, fx: f, fy: f, projection: projection === "fisheye" ? { kind: "fisheye", k: [0, 0, 0, 0], angle } : PINHOLE };
}

/** The lens moved to its right. @param {Lens} lens @param {number} by world units @returns {Lens} */
export const aside = (lens, by) => (by ? { ...lens, eye: add(lens.eye, times(lens.axes.right, by)) } : lens);

/**
 * A lens of the world in the coordinates that the splats are held in, near their own origin, so that
 * single floats resolve them. @param {Lens} lens @param {import("../scene/scene.js").Frame3} frame @returns {Lens}
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
  return JSON.stringify({ transform_matrix: [row(0), row(1), row(2), [0, 0, 0, 1]], ...fieldsOf(lens.projection, lens.fx, lens.fy), cx: lens.cx, cy: lens.cy });
}

/** The point that a place in the picture (pixels) shows at a depth; null where the picture shows nothing. @param {Lens} lens @param {number} x @param {number} y @param {number} depth @returns {Vec3 | null} */
export function unproject(lens, x, y, depth) {
  const { right, up, back } = lens.axes;
  const ray = rayOf(lens.projection, (x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy);
  if (!ray) return null;
  const [u, v, w] = times(ray, depth);
  return add(lens.eye, add(add(times(right, u), times(up, -v)), times(back, -w)));
}

/** Pixel and depth of a point; null where it is not seen. @param {Lens} lens @param {Vec3} point */
export function project(lens, point) {
  const p = sub(point, lens.eye);
  const place = placeOf(lens.projection, [dot(p, lens.axes.right), -dot(p, lens.axes.up), -dot(p, lens.axes.back)]);
  return place && { x: lens.cx + lens.fx * place.u, y: lens.cy + lens.fy * place.v, depth: place.depth };
}

/** Pieces of a straight line where lines may be bent. */
const PIECES = 12;

/** Places of a line through points, in runs: a run ends where the line leaves the picture's field, or the edge of a panorama. @param {Lens} lens @param {readonly Vec3[]} points @param {boolean} closed */
export function runsOf(lens, points, closed) {
  const corners = closed && points.length ? [...points, points[0]] : points;
  const pieces = lens.projection.kind === "pinhole" ? 1 : PIECES;
  const between = (/** @type {Vec3} */ a, /** @type {Vec3} */ b, /** @type {number} */ t) => add(times(a, 1 - t), times(b, t));
  const line = corners.flatMap((corner, i) => (i === 0 ? [corner] : Array.from({ length: pieces }, (_, n) => (n + 1 === pieces ? corner : between(corners[i - 1], corner, (n + 1) / pieces)))));
  const around = lens.projection.kind === "equirectangular" ? lens.width / 2 : Infinity;
  /** @type {{ x: number, y: number }[][]} */
  const runs = [[]];
  for (const point of line) {
    const place = project(lens, point);
    const last = /** @type {{ x: number, y: number }[]} */ (runs.at(-1));
    if (!place) runs.push([]);
    else if (last.length && Math.abs(place.x - last[last.length - 1].x) > around) runs.push([place]);
    else last.push(place);
  }
  return runs.filter((run) => run.length > 1);
}
