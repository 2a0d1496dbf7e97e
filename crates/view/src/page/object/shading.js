/**
 * The light of a surface towards the eye, by the materials of glTF 2.0, appendix B: matt, metal, gloss.
 * Gloss is an approximation: lamps are points of GGX, and the map is seen through a lobe about the
 * mirrored direction (Karis, "Real shading in Unreal Engine 4", 2013, and its fit for phones of 2014).
 */

import { add, dot, length, sub, times, unit } from "../math/vectors.js";
import { GOLDEN, irradianceFrom, lampAlong, radianceFrom, reach } from "./lamps.js";
import { partsOf } from "./meshlamp.js";

/** @typedef {import("./lamps.js").Light} Light */
/** @typedef {import("./lamps.js").LightMap} LightMap */
/** @typedef {import("./mesh.js").Material} Material */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/**
 * A place of a surface: unit vectors; the part of each lamp and of the map that is seen from it; whether
 * the object itself is what is mirrored there.
 * @typedef {{ point: Vec3, normal: Vec3, ray: Vec3, lamps: readonly number[], sky: number, seesItself: (direction: Vec3) => boolean }} Place
 */

/** Roughness up to which a surface is a mirror. */
const MIRROR = 0.05;
/** Reflectance of what is no metal, seen head-on. */
const DIELECTRIC = 0.04;
/** Directions of the lobe through which a rough surface sees the map. */
const LOBE = 48;
/** Width of a map that is seen through a lobe, pixels. */
const BLURRED_PX = 32;

/** Maps as they are seen through lobes, by roughness in hundredths. @type {WeakMap<LightMap, Map<number, LightMap>>} */
const blurredMaps = new WeakMap();

/** A direction about `axis`, of the lobe of GGX. @param {Vec3} axis @param {number} alpha @param {number} i */
function ofLobe(axis, alpha, i) {
  const part = (i + 0.5) / LOBE;
  // Normals of small mirrors about the axis, which see twice the angle.
  const cosine = Math.sqrt((1 - part) / (1 + (alpha * alpha - 1) * part));
  const angle = 2 * Math.PI * GOLDEN * i;
  const side = unit(Math.abs(axis[0]) < 0.9 ? [0, -axis[2], axis[1]] : [axis[2], 0, -axis[0]]);
  const other = /** @type {Vec3} */ ([axis[1] * side[2] - axis[2] * side[1], axis[2] * side[0] - axis[0] * side[2], axis[0] * side[1] - axis[1] * side[0]]);
  const sine = Math.sqrt(Math.max(0, 1 - cosine * cosine));
  const mirror = add(times(axis, cosine), add(times(side, sine * Math.cos(angle)), times(other, sine * Math.sin(angle))));
  return sub(times(mirror, 2 * dot(axis, mirror)), axis);
}

/** @param {LightMap} map @param {number} roughness @returns {LightMap} */
function blurred(map, roughness) {
  const known = blurredMaps.get(map) ?? new Map();
  blurredMaps.set(map, known);
  const key = Math.round(100 * roughness);
  const made = known.get(key);
  if (made) return made;
  // In the axes of the map itself.
  const plain = { ...map, map_from_world: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] };
  const [width, height] = [BLURRED_PX, BLURRED_PX / 2];
  const rgb = Array.from({ length: width * height }, (_, at) => {
    const [latitude, longitude] = [Math.PI * (0.5 - (Math.floor(at / width) + 0.5) / height), Math.PI * (1 - (2 * ((at % width) + 0.5)) / width)];
    const axis = /** @type {Vec3} */ ([Math.sin(longitude) * Math.cos(latitude), Math.sin(latitude), Math.cos(longitude) * Math.cos(latitude)]);
    /** @type {Vec3} */ let sum = [0, 0, 0];
    let all = 0;
    for (let i = 0; i < LOBE; i++) {
      const direction = ofLobe(axis, roughness * roughness, i);
      const weight = Math.max(0, dot(axis, direction));
      sum = add(sum, times(radianceFrom(plain, direction), weight));
      all += weight;
    }
    return times(sum, 1 / Math.max(all, 1e-9));
  }).flat();
  const found = { ...map, width, height, rgb };
  known.set(key, found);
  return found;
}

/** The share of even light that gloss returns, as a factor of the reflectance head-on and a rest. @param {number} roughness @param {number} cosine */
function glossOf(roughness, cosine) {
  const x = 1 - roughness;
  const y = 0.0425 - 0.0275 * roughness;
  const part = Math.min(x * x, 2 ** (-9.28 * cosine)) * x + y;
  return [1.04 * (1 - part) - 0.572 * roughness, 1.04 * part - 0.04 + 0.022 * roughness];
}

/** What a lamp adds to the gloss, for each reflectance of one. @param {import("./lamps.js").Lamp} lamp @param {Place} place @param {number} roughness @returns {Vec3} */
function lampGloss(lamp, { point, normal, ray }, roughness) {
  const way = sub(lamp.middle, point);
  const towards = unit(way);
  const half = unit(sub(towards, ray));
  // A lamp that is not small widens the lobe.
  const alpha = Math.min(1, roughness * roughness + reach(lamp) / (2 * Math.max(length(way), 1e-9)));
  const cosine = Math.max(0, dot(normal, half));
  const lobe = alpha * alpha / (Math.PI * (cosine * cosine * (alpha * alpha - 1) + 1) ** 2);
  const shared = Math.max(dot(towards, half), 0.1);
  return times(irradianceFrom(lamp, point, normal), lobe / (4 * shared * shared));
}

/** The light that gloss shows, for each reflectance of one. @param {Light} light @param {Place} place @param {number} roughness @returns {Vec3} */
function glossLight({ lamps, map, fromMap }, place, roughness) {
  const { point, normal, ray } = place;
  const mirrored = sub(ray, times(normal, 2 * dot(ray, normal)));
  // What the object shows of itself is as bright as a matt surface in the light of the map.
  if (place.seesItself(mirrored)) return times(fromMap(normal), 1 / Math.PI);
  if (roughness < MIRROR) return lampAlong(lamps, point, mirrored) ?? radianceFrom(map, mirrored);
  const sky = times(radianceFrom(blurred(map, roughness), mirrored), place.sky);
  const gloss = (/** @type {import("./lamps.js").Lamp} */ lamp) => partsOf(lamp).reduce((sum, part) => add(sum, lampGloss(part, place, roughness)), /** @type {Vec3} */ ([0, 0, 0]));
  return lamps.reduce((sum, lamp, i) => (place.lamps[i] > 0 ? add(sum, times(gloss(lamp), place.lamps[i])) : sum), sky);
}

/** Radiance towards the eye. @param {Light} light @param {Material} material @param {Place} place @returns {Vec3} */
export function radianceTowardsEye(light, { base, metallic, roughness, specular }, place) {
  const { point, normal, ray } = place;
  const lit = light.lamps.reduce((sum, lamp, i) => add(sum, times(irradianceFrom(lamp, point, normal), place.lamps[i])), times(light.fromMap(normal), place.sky));
  const strength = specular + (1 - specular) * metallic;
  const [factor, rest] = glossOf(roughness, Math.max(0, -dot(ray, normal)));
  const gloss = base.map((value) => strength * ((DIELECTRIC + (value - DIELECTRIC) * metallic) * factor + rest));
  const shine = strength > 0 ? glossLight(light, place, roughness) : [0, 0, 0];
  return /** @type {Vec3} */ ([0, 1, 2].map((c) => (lit[c] * base[c] * (1 - metallic) * (1 - gloss[c])) / Math.PI + shine[c] * gloss[c]));
}
