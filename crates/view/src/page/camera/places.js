/** Places to look at a scene from, by its cameras and its splats. */

import { poseOf } from "../math/lens.js";
import { add, dot, length, looking, sub, times } from "../math/vectors.js";

/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../scene/scene.js").Scene} Scene */

/** A length that goes with the scene: between the cameras, else of the box around most splats. @param {Scene} scene */
export function sizeOf(scene) {
  const eyes = scene.cameras.map((camera) => poseOf(camera).eye);
  const reach = Math.max(0, ...eyes.map((eye) => length(sub(eye, eyes[0]))));
  const box = length(sub(scene.inner_bounds[1], scene.inner_bounds[0]));
  return reach > 0 ? Math.min(Math.max(reach, box * 0.05), Math.max(box, reach)) : box;
}

/** The whole scene from the front. @param {Scene} scene */
export function overview(scene) {
  const [low, high] = scene.inner_bounds;
  const pivot = times(add(low, high), 0.5);
  const size = Math.max(length(sub(high, low)), 1e-3);
  // A direction that is level: across the up axis.
  const aside = /** @type {Vec3} */ (Math.abs(scene.up[2]) < 0.9 ? [0, 0, 1] : [0, 1, 0]);
  const axes = looking(times(sub(aside, times(scene.up, dot(aside, scene.up))), -1), scene.up);
  return { axes, pivot, eye: add(pivot, times(axes.back, size)) };
}
