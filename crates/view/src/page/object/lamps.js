/** The light on an object: lamps at their places, and all other light as a map of directions. */

import { add, cross, dot, length, sub, times, unit } from "../math/vectors.js";
import { isMesh, isMet, outlines, partsOf, reachOf, spreadOver } from "./meshlamp.js";

/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** A lamp of `luxel lights`: world units, radiance in the units of the data set. @typedef {{ shape: "sphere" | "disk" | "rectangle" | "mesh", middle: Vec3, normal?: Vec3, radius?: number, size?: [number, number], along?: Vec3, points?: Vec3[], triangles?: [number, number, number][], mean_area?: number, radiance: Vec3, intensity: Vec3, power: Vec3 }} Lamp */
/** The light at a point: lamps, and all else as a map and as the irradiance that comes from it. @typedef {{ lamps: Lamp[], map: LightMap, fromMap: (normal: Vec3) => Vec3 }} Light */
/** A map of directions, OpenEXR's latitude and longitude; rows of the turn from the world to its axes. @typedef {{ width: number, height: number, rgb: number[], map_from_world: number[][] }} LightMap */

/** Factors of the bands of harmonics by which radiance becomes irradiance (Ramamoorthi and Hanrahan 2001). */
const BANDS = [Math.PI, ...Array(3).fill((2 * Math.PI) / 3), ...Array(5).fill(Math.PI / 4)];

/** Real harmonics of degree 0 to 2. @param {Vec3} v */
const harmonics = ([x, y, z]) => [0.282095, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z, 0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y)];

/** @param {LightMap} map @param {Vec3} v @returns {Vec3} */
const turned = ({ map_from_world: rows }, v) => /** @type {Vec3} */ (rows.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]));

/** Irradiance of a surface by its normal, from all of the map. @param {LightMap} map @returns {(normal: Vec3) => Vec3} */
export function irradianceOf(map) {
  const { width, height, rgb } = map;
  const sums = Array.from({ length: 9 }, () => [0, 0, 0]);
  for (let row = 0; row < height; row++) {
    const latitude = Math.PI * (0.5 - (row + 0.5) / height);
    const solidAngle = (Math.cos(latitude) * 2 * Math.PI * Math.PI) / (width * height);
    for (let column = 0; column < width; column++) {
      const longitude = Math.PI * (1 - (2 * (column + 0.5)) / width);
      const basis = harmonics([Math.sin(longitude) * Math.cos(latitude), Math.sin(latitude), Math.cos(longitude) * Math.cos(latitude)]);
      const at = 3 * (row * width + column);
      basis.forEach((value, k) => [0, 1, 2].forEach((c) => (sums[k][c] += value * solidAngle * rgb[at + c])));
    }
  }
  return (normal) => {
    const basis = harmonics(turned(map, normal));
    return /** @type {Vec3} */ ([0, 1, 2].map((c) => Math.max(0, basis.reduce((sum, value, k) => sum + BANDS[k] * value * sums[k][c], 0))));
  };
}

/** Radiance from a direction. @param {LightMap} map @param {Vec3} direction of unit length @returns {Vec3} */
export function radianceFrom(map, direction) {
  const [x, y, z] = turned(map, direction);
  const column = Math.min(map.width - 1, Math.floor((0.5 - Math.atan2(x, z) / (2 * Math.PI)) * map.width));
  const row = Math.min(map.height - 1, Math.floor((0.5 - Math.asin(Math.max(-1, Math.min(1, y))) / Math.PI) * map.height));
  const at = 3 * (row * map.width + column);
  return [map.rgb[at], map.rgb[at + 1], map.rgb[at + 2]];
}

/** Irradiance of a surface at a point from a lamp, taken for a point, or for one in each of its parts. @param {Lamp} lamp @param {Vec3} point @param {Vec3} normal @returns {Vec3} */
export function irradianceFrom(lamp, point, normal) {
  if (isMesh(lamp)) return partsOf(lamp).reduce((sum, part) => add(sum, irradianceFrom(part, point, normal)), /** @type {Vec3} */ ([0, 0, 0]));
  const way = sub(lamp.middle, point);
  const distance = Math.max(length(way), 1e-9);
  const towards = times(way, 1 / distance);
  const out = lamp.normal ? Math.max(0, -dot(towards, lamp.normal)) : 1;
  return times(lamp.intensity, (out * Math.max(0, dot(towards, normal))) / (distance * distance));
}

/** The radiance of the lamp that a ray meets; null if it meets none. @param {readonly Lamp[]} lamps @param {Vec3} point @param {Vec3} direction of unit length @returns {Vec3 | null} */
export function lampAlong(lamps, point, direction) {
  for (const lamp of lamps) {
    const way = sub(lamp.middle, point);
    if (!lamp.normal) {
      const along = dot(way, direction);
      const isNear = length(sub(way, times(direction, Math.max(0, along)))) < reach(lamp);
      if (isNear && (isMesh(lamp) ? isMet(lamp, point, direction) : along > 0)) return lamp.radiance;
      continue;
    }
    const facing = dot(direction, lamp.normal);
    const away = dot(way, lamp.normal) / facing;
    if (!(facing < 0) || !(away > 0)) continue;
    const from = sub(times(direction, away), way);
    const [w, h] = lamp.size ?? [0, 0];
    const along = lamp.along ?? [0, 0, 0];
    const isHit = lamp.size ? Math.abs(dot(from, along)) < w / 2 && Math.abs(dot(from, cross(lamp.normal, along))) < h / 2 : length(from) < (lamp.radius ?? 0);
    if (isHit) return lamp.radiance;
  }
  return null;
}

/** Part of a turn by which points are spread evenly: the golden section. */
export const GOLDEN = (Math.sqrt(5) - 1) / 2;

/** Radius of the ball around a lamp. @param {Lamp} lamp */
export const reach = (lamp) => (isMesh(lamp) ? reachOf(lamp) : lamp.radius ?? Math.hypot(...(lamp.size ?? [0, 0])) / 2);

/** The part of a lamp that a point sees past a ball, by the angles of both. @param {Lamp} lamp @param {Vec3} point @param {Vec3} center @param {number} radius @returns {number} */
export function visibility(lamp, point, center, radius) {
  if (isMesh(lamp)) {
    const parts = partsOf(lamp);
    return parts.reduce((sum, part) => sum + visibility(part, point, center, radius), 0) / parts.length;
  }
  const [toBall, toLamp] = [sub(center, point), sub(lamp.middle, point)];
  const [near, far] = [length(toBall), length(toLamp)];
  if (near <= radius || near >= far) return near <= radius ? 0 : 1;
  const [ball, light] = [Math.asin(radius / near), Math.atan2(reach(lamp), far)];
  const apart = Math.acos(Math.max(-1, Math.min(1, dot(toBall, toLamp) / (near * far))));
  const hidden = Math.max(0, Math.min(1, (ball + light - apart) / Math.max(2 * Math.min(ball, light), 1e-9)));
  return 1 - hidden * Math.min(1, (ball / Math.max(light, 1e-9)) ** 2);
}

/** The first points of a rectangle, parts of its sides. */
const CORNERS = [[-0.45, -0.45], [0.45, 0.45], [0.45, -0.45], [-0.45, 0.45]];

/** Points spread over a lamp, as it is seen from `eye`, those at its edge first. @param {Lamp} lamp @param {Vec3} eye @param {number} count @returns {Vec3[]} */
export function spread(lamp, eye, count) {
  if (isMesh(lamp)) return spreadOver(lamp, count);
  const { side, other } = acrossOf(lamp, eye);
  return Array.from({ length: count }, (_, i) => {
    const part = 1 - (i + 0.5) / count;
    if (lamp.size) {
      const [a, b] = i < CORNERS.length ? CORNERS[i] : [part - 0.5, ((i * GOLDEN + 0.5) % 1) - 0.5];
      return add(lamp.middle, add(times(side, a * lamp.size[0]), times(other, b * lamp.size[1])));
    }
    const [from, angle] = [Math.sqrt(part) * (lamp.radius ?? 0), 2 * Math.PI * GOLDEN * i];
    return add(lamp.middle, times(add(times(side, Math.cos(angle)), times(other, Math.sin(angle))), from));
  });
}

/** Two directions across a lamp, as it is seen from `eye`. @param {Lamp} lamp @param {Vec3} eye */
function acrossOf(lamp, eye) {
  const axis = lamp.normal ?? unit(sub(eye, lamp.middle));
  const side = lamp.along ?? unit(cross(axis, Math.abs(axis[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
  return { side, other: cross(axis, side) };
}

/** Closed lines around a lamp's edge, as it is seen from `eye`; a round one has `count` points. @param {Lamp} lamp @param {Vec3} eye @param {number} count @returns {Vec3[][]} */
export const outline = (lamp, eye, count) => (isMesh(lamp) ? outlines(lamp, eye) : [edge(lamp, eye, count)]);

/** @param {Lamp} lamp @param {Vec3} eye @param {number} count @returns {Vec3[]} */
function edge(lamp, eye, count) {
  const { side, other } = acrossOf(lamp, eye);
  if (lamp.size) {
    const [along, across] = [times(side, lamp.size[0] / 2), times(other, lamp.size[1] / 2)];
    return [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => add(lamp.middle, add(times(along, a), times(across, b))));
  }
  const angle = (/** @type {number} */ i) => (2 * Math.PI * i) / count;
  return Array.from({ length: count }, (_, i) => add(lamp.middle, times(add(times(side, Math.cos(angle(i))), times(other, Math.sin(angle(i)))), lamp.radius ?? 0)));
}
