/** The shadow of an object on what a picture shows. */

import { fromHalf, toHalf } from "../math/half.js";
import { project, unproject } from "../math/lens.js";
import { add, dot, length, sub, times } from "../math/vectors.js";
import { irradianceFrom } from "./lamps.js";
import { meeting } from "./surface.js";

/** @typedef {import("./lamps.js").Lamp} Lamp */
/** @typedef {import("./lamps.js").Light} Light */
/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../scene/scene.js").Frame} Frame */
/** @typedef {import("./surface.js").Plane} Plane */
/**
 * What casts a shadow, in a ball of the world: the part of a lamp that a point sees past it, and the part
 * of the sky, weighted by the cosine, that it covers of a surface.
 * @typedef {{ center: Vec3, radius: number, visibility: (index: number, lamp: Lamp, point: Vec3) => number, covered: (point: Vec3, normal: Vec3) => number }} Caster
 */

/** Distance from an object up to which its shadow is drawn, radii. */
const REACH = 8;
/** Distance from the plane under an object up to which what is seen counts as lying on it, radii. */
const ON_PLANE = 0.7;

/** Rows and columns of a picture that a ball of the world may cover. @param {Frame} frame @param {Lens} lens @param {Vec3} center @param {number} radius @returns {import("./raster.js").Box} */
export function boxOf({ head }, lens, center, radius) {
  const place = project(lens, center);
  const whole = { left: 0, top: 0, right: head.width, bottom: head.height };
  if (!place || place.depth <= radius) return whole;
  const around = (1.5 * radius * Math.max(lens.fx, lens.fy)) / (place.depth - radius);
  const within = (/** @type {number} */ v, /** @type {number} */ most) => Math.max(0, Math.min(most, Math.floor(v)));
  return { left: within(place.x - around, head.width), top: within(place.y - around, head.height), right: within(place.x + around + 1, head.width), bottom: within(place.y + around + 1, head.height) };
}

/** The part of the sky that a ball covers of a surface, weighted by the cosine. @param {Vec3} point @param {Vec3} normal @param {Vec3} center @param {number} radius */
export function coveredByBall(point, normal, center, radius) {
  const way = sub(center, point);
  const away = Math.max(length(way), radius);
  return Math.min(1, (radius / away) ** 2 * Math.max(0, dot(times(way, 1 / away), normal)));
}

/** The factor that an object has on the light of a matt surface; `sky` is the irradiance from the map. @param {readonly Lamp[]} lamps @param {Vec3} sky @param {Caster} caster @param {Vec3} point @param {Vec3} normal @returns {Vec3} */
function factorAt(lamps, sky, caster, point, normal) {
  let [lit, all] = [times(sky, 1 - caster.covered(point, normal)), sky];
  lamps.forEach((lamp, i) => {
    const part = irradianceFrom(lamp, point, normal);
    [lit, all] = [add(lit, times(part, caster.visibility(i, lamp, point))), add(all, part)];
  });
  return /** @type {Vec3} */ ([0, 1, 2].map((c) => (all[c] > 0 ? lit[c] / all[c] : 1)));
}

/** Darkens what an object keeps light from; depths are rough, so what is seen near the plane under it lies on it, and all is turned as it is. @param {Frame} frame @param {Lens} lens @param {Light} light @param {Caster} caster @param {Plane} under */
export function drawShadow(frame, lens, light, caster, under) {
  const { rgb, depth, head } = frame;
  const { center, radius } = caster;
  if (!depth) return;
  const sky = light.fromMap(under.normal);
  const { left, top, right, bottom } = boxOf(frame, lens, center, REACH * radius);
  for (let y = top; y < bottom; y++) {
    for (let x = left; x < right; x++) {
      const i = y * head.width + x;
      const seen = depth[i] < 1e30 ? unproject(lens, x + 0.5, y + 0.5, depth[i]) : null;
      if (!seen || length(sub(seen, center)) > REACH * radius) continue;
      const isOnPlane = Math.abs(dot(sub(seen, under.point), under.normal)) < ON_PLANE * radius;
      const point = (isOnPlane && meeting(under, lens.eye, sub(seen, lens.eye))) || seen;
      const factor = factorAt(light.lamps, sky, caster, point, under.normal);
      if (Math.min(...factor) < 1) for (let c = 0; c < 3; c++) rgb[3 * i + c] = toHalf(fromHalf(rgb[3 * i + c]) * factor[c]);
    }
  }
}
