/** Lamps that are meshes: their parts as balls, points over them, their outline, and rays that meet them. */

import { add, cross, dot, length, sub, times } from "../math/vectors.js";

/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("./lamps.js").Lamp} Lamp */
/** A lamp with a mesh. @typedef {Lamp & { points: Vec3[], triangles: [number, number, number][], mean_area: number }} MeshLamp */
/** A triangle: its middle and its area. @typedef {{ middle: Vec3, area: number }} Tile */

/** Halvings of a mesh into parts. */
const HALVINGS = 3;

/** @param {Lamp} lamp @returns {lamp is MeshLamp} */
export const isMesh = (lamp) => lamp.shape === "mesh";

/** @param {MeshLamp} lamp @param {[number, number, number]} corners @returns {Vec3[]} */
const cornersOf = (lamp, corners) => corners.map((corner) => lamp.points[corner]);

/** Parts and reach of a lamp, found once. @type {WeakMap<Lamp, { parts: Lamp[], reach: number }>} */
const known = new WeakMap();

/** @param {MeshLamp} lamp */
function factsOf(lamp) {
  const facts = known.get(lamp) ?? { parts: madeParts(lamp), reach: Math.max(...lamp.points.map((point) => length(sub(point, lamp.middle)))) };
  known.set(lamp, facts);
  return facts;
}

/** Balls that shine as the parts of a mesh do; a lamp of another shape itself. @param {Lamp} lamp @returns {Lamp[]} */
export const partsOf = (lamp) => (isMesh(lamp) ? factsOf(lamp).parts : [lamp]);

/** Radius of the ball around a lamp. @param {MeshLamp} lamp */
export const reachOf = (lamp) => factsOf(lamp).reach;

/** @param {MeshLamp} lamp @returns {Lamp[]} */
function madeParts(lamp) {
  const tiles = lamp.triangles.map((triangle) => {
    const [a, b, c] = cornersOf(lamp, triangle);
    return { middle: times(add(add(a, b), c), 1 / 3), area: length(cross(sub(b, a), sub(c, a))) / 2 };
  });
  let groups = [tiles];
  for (let i = 0; i < HALVINGS; i++) groups = groups.flatMap(halves);
  const whole = areaOf(tiles);
  return groups.filter((group) => areaOf(group) > 0).map((group) => {
    const share = areaOf(group) / whole;
    const middle = times(group.reduce((sum, tile) => add(sum, times(tile.middle, tile.area)), /** @type {Vec3} */ ([0, 0, 0])), 1 / areaOf(group));
    const radius = Math.sqrt((share * lamp.mean_area) / Math.PI);
    return { shape: /** @type {const} */ ("sphere"), middle, radius, radiance: lamp.radiance, intensity: times(lamp.intensity, share), power: times(lamp.power, share) };
  });
}

/** @param {readonly Tile[]} tiles */
const areaOf = (tiles) => tiles.reduce((sum, { area }) => sum + area, 0);

/** Two halves of equal area, across the longest side of the box of the middles. @param {Tile[]} tiles @returns {Tile[][]} */
function halves(tiles) {
  if (tiles.length < 2) return [tiles];
  const side = (/** @type {number} */ axis) => Math.max(...tiles.map(({ middle }) => middle[axis])) - Math.min(...tiles.map(({ middle }) => middle[axis]));
  const axis = [0, 1, 2].reduce((best, axis) => (side(axis) > side(best) ? axis : best));
  const sorted = [...tiles].sort((a, b) => a.middle[axis] - b.middle[axis]);
  let [sum, at] = [0, 0];
  while (at < sorted.length - 1 && sum < areaOf(tiles) / 2) sum += sorted[at++].area;
  return [sorted.slice(0, at), sorted.slice(at)];
}

/** Corners of a lamp, each the farthest from those before it. @param {MeshLamp} lamp @param {number} count @returns {Vec3[]} */
export function spreadOver({ points, middle }, count) {
  const distances = points.map((point) => length(sub(point, middle)));
  /** @type {Vec3[]} */ const found = [];
  while (found.length < count) {
    const next = points[distances.indexOf(Math.max(...distances))];
    found.push(next);
    points.forEach((point, i) => {
      const away = length(sub(point, next));
      distances[i] = found.length === 1 ? away : Math.min(distances[i], away);
    });
  }
  return found;
}

/** The outline of a lamp from `eye`, in closed lines: the sides that part what faces it from what does not. @param {MeshLamp} lamp @param {Vec3} eye @returns {Vec3[][]} */
export function outlines(lamp, eye) {
  const faces = lamp.triangles.filter((triangle) => {
    const [a, b, c] = cornersOf(lamp, triangle);
    return dot(cross(sub(b, a), sub(c, a)), sub(eye, a)) > 0;
  });
  const sides = faces.flatMap(([a, b, c]) => [[a, b], [b, c], [c, a]]);
  const all = new Set(sides.map(String));
  /** The corners that follow a corner. @type {Map<number, number[]>} */ const next = new Map();
  for (const [from, to] of sides) if (!all.has(String([to, from]))) next.set(from, [...(next.get(from) ?? []), to]);
  const lines = [];
  for (const [start, ends] of next) {
    while (ends.length) {
      const line = [lamp.points[start]];
      for (let at = ends.pop(); at !== undefined && at !== start; at = next.get(at)?.pop()) line.push(lamp.points[at]);
      lines.push(line);
    }
  }
  return lines;
}

/** Whether a ray meets a lamp. @param {MeshLamp} lamp @param {Vec3} from @param {Vec3} direction of unit length */
export function isMet(lamp, from, direction) {
  return lamp.triangles.some((triangle) => {
    const [a, b, c] = cornersOf(lamp, triangle);
    const [e, f] = [sub(b, a), sub(c, a)];
    const p = cross(direction, f);
    const inverse = 1 / dot(e, p);
    const t = sub(from, a);
    const u = dot(t, p) * inverse;
    const q = cross(t, e);
    const v = dot(direction, q) * inverse;
    return u >= 0 && v >= 0 && u + v <= 1 && dot(f, q) * inverse > 0;
  });
}
