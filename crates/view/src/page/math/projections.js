/**
 * Projections of a picture, as the program has them (core/projection.rs): how a direction becomes a
 * place on the image plane, which focal lengths scale to pixels, and back. Camera axes are x right,
 * y down, z forward. Depth is z for the pinhole, the distance for the others.
 */

/** @typedef {import("./vectors.js").Vec3} Vec3 */
/** @typedef {import("../scene/scene.js").ViewCamera} ViewCamera */
/** @typedef {"pinhole" | "fisheye" | "equirectangular"} Kind */
/** A projection; a fisheye with OpenCV's k1 to k4 and the angle to its axis up to which it sees, radians. @typedef {{ kind: "pinhole" } | { kind: "equirectangular" } | { kind: "fisheye", k: readonly number[], angle: number }} Projection */

/** @type {readonly Kind[]} */
export const KINDS = ["pinhole", "fisheye", "equirectangular"];
/** @type {Projection} */
export const PINHOLE = { kind: "pinhole" };
/** @type {Projection} */
export const PANORAMA = { kind: "equirectangular" };
/** Largest angle to the axis of a fisheye, radians, and that of one for which none is stated. */
const [MOST, USUAL] = [(150 * Math.PI) / 180, (100 * Math.PI) / 180];
/** Steps of Newton's method within brackets. */
const STEPS = 60;

/** Radius of a fisheye at an angle to its axis, for a focal length of 1. @param {readonly number[]} k @param {number} angle */
export function radius([k1, k2, k3, k4], angle) {
  const t2 = angle * angle;
  return angle * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
}

/** Its derivative. @param {readonly number[]} k @param {number} angle */
function slope([k1, k2, k3, k4], angle) {
  const t2 = angle * angle;
  return 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)));
}

/** Angle of a fisheye at a radius; null beyond its field. @param {{ k: readonly number[], angle: number }} lens @param {number} at */
export function angleAt({ k, angle: most }, at) {
  if (!(at >= 0 && at <= radius(k, most))) return null;
  let [low, high, angle] = [0, most, Math.min(at, most)];
  for (let n = 0; n < STEPS; n++) {
    const excess = radius(k, angle) - at;
    if (excess > 0) high = angle;
    else low = angle;
    const newton = angle - excess / slope(k, angle);
    const next = newton > low && newton < high ? newton : (low + high) / 2;
    if (Math.abs(next - angle) <= 1e-12) return next;
    angle = next;
  }
  return angle;
}

/** Place on the plane and depth of a point; null where it is not seen. @param {Projection} projection @param {Vec3} point @returns {{ u: number, v: number, depth: number } | null} */
export function placeOf(projection, [x, y, z]) {
  if (projection.kind === "pinhole") return z > 0 ? { u: x / z, v: y / z, depth: z } : null;
  const depth = Math.hypot(x, y, z);
  if (depth === 0) return null;
  if (projection.kind === "equirectangular") return { u: Math.atan2(x, z), v: Math.atan2(y, Math.hypot(x, z)), depth };
  const across = Math.hypot(x, y);
  const angle = Math.atan2(across, z);
  if (angle > projection.angle) return null;
  const scale = across > 0 ? radius(projection.k, angle) / across : 0;
  return { u: x * scale, v: y * scale, depth };
}

/** The point at depth 1 that a place on the plane shows; null where it shows nothing. @param {Projection} projection @param {number} u @param {number} v @returns {Vec3 | null} */
export function rayOf(projection, u, v) {
  if (projection.kind === "pinhole") return [u, v, 1];
  if (projection.kind === "equirectangular") return Math.abs(v) <= Math.PI / 2 + 1e-9 ? [Math.sin(u) * Math.cos(v), Math.sin(v), Math.cos(u) * Math.cos(v)] : null;
  const across = Math.hypot(u, v);
  const angle = angleAt(projection, across);
  if (angle === null) return null;
  const scale = across > 0 ? Math.sin(angle) / across : 0;
  return [u * scale, v * scale, Math.cos(angle)];
}

/** Projection and focal lengths of a camera of the data set, whose panoramas have nerfstudio's: the pixels of half a turn. @param {ViewCamera} camera @returns {{ projection: Projection, fx: number, fy: number }} */
export function opticsOf({ camera_model: model, fl_x, fl_y, fisheye_crop_radius: crop = 0, k1 = 0, k2 = 0, k3 = 0, k4 = 0 }) {
  if (model === "EQUIRECTANGULAR") return { projection: PANORAMA, fx: fl_x / Math.PI, fy: fl_y / Math.PI };
  if (model !== "OPENCV_FISHEYE") return { projection: PINHOLE, fx: fl_x, fy: fl_y };
  const k = [k1, k2, k3, k4];
  // The field ends within the angles to which the radius grows.
  let n = 1;
  while (n <= 2000 && slope(k, (MOST * n) / 2000) >= 0.02) n++;
  const most = n > 2000 ? MOST : (MOST * (n - 1)) / 2000;
  const angle = crop > 0 ? angleAt({ k, angle: most }, crop / Math.min(fl_x, fl_y)) : Math.min(most, USUAL);
  return { projection: { kind: "fisheye", k, angle: angle ?? most }, fx: fl_x, fy: fl_y };
}

/** The fields of a frame of transforms.json that name a projection with its focal lengths. @param {Projection} projection @param {number} fx @param {number} fy */
export function fieldsOf(projection, fx, fy) {
  if (projection.kind === "pinhole") return { fl_x: fx, fl_y: fy };
  if (projection.kind === "equirectangular") return { camera_model: "EQUIRECTANGULAR", fl_x: fx * Math.PI, fl_y: fy * Math.PI };
  const [k1, k2, k3, k4] = projection.k;
  return { camera_model: "OPENCV_FISHEYE", fl_x: fx, fl_y: fy, k1, k2, k3, k4, fisheye_crop_radius: radius(projection.k, projection.angle) * Math.min(fx, fy) };
}

/** The camera as a pinhole of 90 degrees at its place, if it is none: its image is not that of the pinhole. @param {ViewCamera} camera @returns {ViewCamera} */
export function asPinhole(camera) {
  const { name, split, transform_matrix, w, h } = camera;
  if (opticsOf(camera).projection.kind === "pinhole") return camera;
  return { name, split, transform_matrix, w, h, fl_x: w / 2, fl_y: w / 2, cx: w / 2, cy: h / 2, has_ground_truth: false };
}

/** Directions around the edge of a camera's field, camera axes, at distance 1: of a panorama its horizon. @param {Projection} projection @param {number} count @returns {Vec3[]} */
export function ring(projection, count) {
  return Array.from({ length: count }, (_, i) => {
    const turn = (2 * Math.PI * i) / count;
    if (projection.kind !== "fisheye") return [Math.sin(turn), 0, Math.cos(turn)];
    const [s, c] = [Math.sin(projection.angle), Math.cos(projection.angle)];
    return [s * Math.cos(turn), s * Math.sin(turn), c];
  });
}

/** The inverse projection for the shader of the picture: `point(place on the plane, depth)`. @param {Kind} kind */
export const pointShader = (kind) =>
  ({
    pinhole: `vec3 point(vec2 p, float depth) { return vec3(p * depth, depth); }`,
    equirectangular: `vec3 point(vec2 p, float depth) { return depth * vec3(sin(p.x) * cos(p.y), sin(p.y), cos(p.x) * cos(p.y)); }`,
    fisheye: `
uniform vec4 fisheye;
vec3 point(vec2 p, float depth) {
  float r = length(p), angle = r;
  for (int n = 0; n < 8; n++) {
    float t2 = angle * angle;
    float excess = angle * (1.0 + t2 * (fisheye.x + t2 * (fisheye.y + t2 * (fisheye.z + t2 * fisheye.w)))) - r;
    angle -= excess / max(1.0 + t2 * (3.0 * fisheye.x + t2 * (5.0 * fisheye.y + t2 * (7.0 * fisheye.z + t2 * 9.0 * fisheye.w))), 0.02);
  }
  return depth * vec3(r > 0.0 ? p * (sin(angle) / r) : vec2(0.0), cos(angle));
}`,
  })[kind];
