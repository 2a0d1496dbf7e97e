/** Vectors of three numbers and camera axes: plain arrays, nothing is changed in place. */

/** @typedef {[number, number, number]} Vec3 */
/** Camera axes in the world, OpenGL's: right, up, back. @typedef {{ right: Vec3, up: Vec3, back: Vec3 }} Axes */

/** @param {Vec3} a @param {Vec3} b @returns {Vec3} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** @param {Vec3} a @param {Vec3} b @returns {Vec3} */
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** @param {Vec3} a @param {number} k @returns {Vec3} */
export const times = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
/** @param {Vec3} a @param {Vec3} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {Vec3} a @param {Vec3} b @returns {Vec3} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @param {Vec3} a */
export const length = (a) => Math.sqrt(dot(a, a));
/** Unit vector; the first axis in place of one without direction. @param {Vec3} a @returns {Vec3} */
export const unit = (a) => {
  const l = length(a);
  return l > 1e-12 ? times(a, 1 / l) : [1, 0, 0];
};

/** Turns `v` about the unit vector `axis` (Rodrigues). @param {Vec3} v @param {Vec3} axis @param {number} angle radians @returns {Vec3} */
export function turn(v, axis, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return add(add(times(v, c), times(cross(axis, v), s)), times(axis, dot(axis, v) * (1 - c)));
}

/** @param {Axes} axes @param {Vec3} axis @param {number} angle @returns {Axes} */
export function turnAxes(axes, axis, angle) {
  return orthonormal({ right: turn(axes.right, axis, angle), up: turn(axes.up, axis, angle), back: turn(axes.back, axis, angle) });
}

/** Removes the rounding that many turns add up. @param {Axes} axes @returns {Axes} */
function orthonormal(axes) {
  const back = unit(axes.back);
  const right = unit(cross(axes.up, back));
  return { right, up: cross(back, right), back };
}

/** Axes of a camera that looks along `forward`, level to `up`. @param {Vec3} forward @param {Vec3} up @returns {Axes} */
export function looking(forward, up) {
  const back = times(unit(forward), -1);
  let right = cross(up, back);
  if (length(right) < 1e-6) right = cross(Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], back);
  right = unit(right);
  return { right, up: cross(back, right), back };
}

/** @param {number} v @param {number} low @param {number} high */
export const clamp = (v, low, high) => Math.min(Math.max(v, low), high);
