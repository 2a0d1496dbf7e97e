/** A ball, grey or chrome, of which all is known without rays to anything. */

import { fromHalf, toHalf } from "../math/half.js";
import { unproject } from "../math/lens.js";
import { add, dot, sub, times, unit } from "../math/vectors.js";
import { irradianceFrom, lampAlong, radianceFrom, visibility } from "./lamps.js";
import { boxOf, coveredByBall } from "./shadow.js";

/** @typedef {import("./lamps.js").Light} Light */
/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../scene/scene.js").Frame} Frame */

/** Reflectance of the grey ball, and of other grey objects. */
export const GREY = 0.5;
/** Rays along each side of a pixel. */
const RAYS = 2;
/** A surface hides an object if it is nearer by this part of its radius: depths of splats are soft. */
export const NEARER = 0.5;

/** The ball as it casts its shadow. @param {Vec3} center @param {number} radius @returns {import("./shadow.js").Caster} */
export const ballCaster = (center, radius) => ({
  center,
  radius,
  visibility: (_, lamp, point) => visibility(lamp, point, center, radius),
  covered: (point, normal) => coveredByBall(point, normal, center, radius),
});

/** Radiance of the ball towards the eye. @param {Light} light @param {Vec3} point @param {Vec3} normal @param {Vec3} ray @param {boolean} isChrome @returns {Vec3} */
function radianceOf({ lamps, map, fromMap }, point, normal, ray, isChrome) {
  if (isChrome) {
    const mirrored = sub(ray, times(normal, 2 * dot(ray, normal)));
    return lampAlong(lamps, point, mirrored) ?? radianceFrom(map, mirrored);
  }
  const all = lamps.reduce((sum, lamp) => add(sum, irradianceFrom(lamp, point, normal)), fromMap(normal));
  return times(all, GREY / Math.PI);
}

/** Draws the ball where nothing is before it. @param {Frame} frame @param {Lens} lens @param {Light} light @param {{ center: Vec3, radius: number }} ball @param {boolean} isChrome */
export function drawBall(frame, lens, light, { center, radius }, isChrome) {
  const { rgb, depth, head } = frame;
  const { left, top, right, bottom } = boxOf(frame, lens, center, radius);
  const from = sub(lens.eye, center);
  for (let y = top; y < bottom; y++) {
    for (let x = left; x < right; x++) {
      const i = y * head.width + x;
      /** @type {Vec3} */ let sum = [0, 0, 0];
      let hits = 0;
      for (let n = 0; n < RAYS * RAYS; n++) {
        const place = unproject(lens, x + ((n % RAYS) + 0.5) / RAYS, y + (Math.floor(n / RAYS) + 0.5) / RAYS, 1);
        if (!place) continue;
        const ray = unit(sub(place, lens.eye));
        const b = dot(ray, from);
        const under = b * b - dot(from, from) + radius * radius;
        const t = -b - Math.sqrt(Math.max(0, under));
        if (under <= 0 || t <= 0) continue;
        const point = add(lens.eye, times(ray, t));
        if (depth && depth[i] < -t * dot(ray, lens.axes.back) - NEARER * radius) continue;
        hits++;
        sum = add(sum, radianceOf(light, point, unit(sub(point, center)), ray, isChrome));
      }
      if (hits === 0) continue;
      const rest = 1 - hits / (RAYS * RAYS);
      for (let c = 0; c < 3; c++) rgb[3 * i + c] = toHalf(fromHalf(rgb[3 * i + c]) * rest + sum[c] / (RAYS * RAYS * head.scale));
    }
  }
}
