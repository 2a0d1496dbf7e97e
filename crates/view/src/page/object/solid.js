/** A mesh that stands in the scene: how it is seen, and how it casts its shadow. */

import { fromHalf, toHalf } from "../math/half.js";
import { unproject } from "../math/lens.js";
import { add, cross, dot, length, sub, times, unit } from "../math/vectors.js";
import { NEARER } from "./ball.js";
import { Tree } from "./bvh.js";
import { GOLDEN, spread, visibility } from "./lamps.js";
import { NONE, rasterise, SIDE } from "./raster.js";
import { radianceTowardsEye } from "./shading.js";
import { boxOf, coveredByBall } from "./shadow.js";

/** @typedef {import("./lamps.js").Lamp} Lamp */
/** @typedef {import("./lamps.js").Light} Light */
/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../scene/scene.js").Frame} Frame */
/** Place of a mesh: half of its longest side in world units, and its axes in the world. @typedef {{ origin: Vec3, right: Vec3, up: Vec3, front: Vec3, scale: number }} Pose */

/** Points of a lamp that rays go to, from the surfaces around the object and from the object itself. */
const [SHADOW_POINTS, OWN_POINTS] = [16, 6];
/** Points of a lamp, at its edge, that are looked at first. */
const FIRST_POINTS = 4;
/** Directions by which the sky is looked at. */
const SKY_RAYS = 64;
/** Corners of a mesh up to which the sky is looked at from each. */
const MOST_SKY = 20_000;
/** Distance from a surface at which rays from it begin, parts of half of the longest side. */
const LIFT = 1e-3;
/** Side of the table of what is covered of the sky around the object, and how far it reaches, in half longest sides. */
const [GROUND, GROUND_REACH] = [65, 4];

/** Directions to the sky about y, as a matt surface weights them. @type {readonly Vec3[]} */
const SKY = Array.from({ length: SKY_RAYS }, (_, i) => {
  const [part, angle] = [(i + 0.5) / SKY_RAYS, 2 * Math.PI * GOLDEN * i];
  return /** @type {Vec3} */ ([Math.sqrt(part) * Math.cos(angle), Math.sqrt(1 - part), Math.sqrt(part) * Math.sin(angle)]);
});

/** The place of a coordinate in the table, which is finer near the object; and back. */
const toGround = (/** @type {number} */ x) => ((1 + Math.sign(x) * Math.sqrt(Math.abs(x) / GROUND_REACH)) * (GROUND - 1)) / 2;
const fromGround = (/** @type {number} */ i) => {
  const t = (2 * i) / (GROUND - 1) - 1;
  return t * Math.abs(t) * GROUND_REACH;
};

export class Solid {
  /** What the table of the ground holds, once it is asked for. @type {Float32Array | null} */ ground = null;
  /** The part of the sky that each corner sees, once it is asked for. @type {Float32Array | null} */ skies = null;

  /** @param {import("./mesh.js").StandingMesh} mesh */
  constructor(mesh) {
    this.mesh = mesh;
    this.tree = new Tree(mesh.positions, mesh.indices);
  }

  /** The part of the sky about a normal that is free. @param {Vec3} point @param {Vec3} normal */
  free(point, normal) {
    const side = unit(Math.abs(normal[0]) < 0.9 ? [0, -normal[2], normal[1]] : [normal[2], 0, -normal[0]]);
    const other = cross(normal, side);
    const [x, y, z] = add(point, times(normal, LIFT));
    let free = 0;
    for (const [a, b, c] of SKY) {
      const [dx, dy, dz] = [a * side[0] + b * normal[0] + c * other[0], a * side[1] + b * normal[1] + c * other[1], a * side[2] + b * normal[2] + c * other[2]];
      if (!this.tree.isHit(x, y, z, dx, dy, dz, Infinity)) free++;
    }
    return free / SKY_RAYS;
  }

  /** The part of the sky that is free at each corner; all of it for large meshes. */
  freeAtCorners() {
    const { positions, normals } = this.mesh;
    const count = positions.length / 3;
    const at = (/** @type {Float32Array} */ list, /** @type {number} */ i) => /** @type {Vec3} */ ([list[3 * i], list[3 * i + 1], list[3 * i + 2]]);
    this.skies ??= Float32Array.from({ length: count }, (_, i) => (count > MOST_SKY ? 1 : this.free(at(positions, i), at(normals, i))));
    return this.skies;
  }

  /** The part of the sky that the mesh covers of the plane it stands on; null beyond the table. @param {number} x @param {number} z */
  coveredAt(x, z) {
    this.ground ??= Float32Array.from({ length: GROUND * GROUND }, (_, i) => 1 - this.free([fromGround(i % GROUND), 0, fromGround(Math.floor(i / GROUND))], [0, 1, 0]));
    const [u, v] = [toGround(x), toGround(z)];
    if (!(u >= 0 && v >= 0 && u < GROUND - 1 && v < GROUND - 1)) return null;
    const [i, j] = [Math.floor(u), Math.floor(v)];
    const row = (/** @type {number} */ k) => (this.ground?.[k * GROUND + i] ?? 0) * (i + 1 - u) + (this.ground?.[k * GROUND + i + 1] ?? 0) * (u - i);
    return row(j) * (j + 1 - v) + row(j + 1) * (v - j);
  }
}

/** A mesh at its place, in the light there. */
export class PlacedSolid {
  /** @param {Solid} solid @param {Pose} pose @param {Light} light */
  constructor(solid, pose, light) {
    this.solid = solid;
    this.pose = pose;
    this.light = light;
    this.center = add(pose.origin, times(pose.up, (solid.mesh.height / 2) * pose.scale));
    this.radius = solid.mesh.reach * pose.scale;
    const points = (/** @type {number} */ count) => light.lamps.map((lamp) => spread(lamp, this.center, count).map((point) => this.toMesh(point)));
    /** Points of each lamp, in the coordinates of the mesh. */ this.lampPoints = points(SHADOW_POINTS);
    this.ownPoints = points(OWN_POINTS);
  }

  /** @param {Vec3} point of the world @returns {Vec3} */
  toMesh(point) {
    return this.turnedToMesh(times(sub(point, this.pose.origin), 1 / this.pose.scale));
  }

  /** @param {Vec3} v @returns {Vec3} */
  turnedToMesh(v) {
    return [dot(v, this.pose.right), dot(v, this.pose.up), dot(v, this.pose.front)];
  }

  /** @param {Vec3} v @returns {Vec3} */
  turnedToWorld([x, y, z]) {
    const { right, up, front } = this.pose;
    return add(add(times(right, x), times(up, y)), times(front, z));
  }

  /** The part of a lamp's points that nothing of the mesh is before; where that is the same for the first ones, it is for all. @param {readonly Vec3[]} points @param {Vec3} from both of the mesh */
  seen(points, [x, y, z]) {
    let free = 0;
    for (let i = 0; i < points.length; i++) {
      const [a, b, c] = points[i];
      if (!this.solid.tree.isHit(x, y, z, a - x, b - y, c - z, 1)) free++;
      if (i + 1 === FIRST_POINTS && free % FIRST_POINTS === 0) return free / FIRST_POINTS;
    }
    return free / points.length;
  }

  /** The part of a lamp that a point sees past the mesh. @param {number} index @param {Lamp} lamp @param {Vec3} point */
  visibility(index, lamp, point) {
    const isNear = length(sub(point, this.center)) <= this.radius;
    if (!isNear && visibility(lamp, point, this.center, this.radius) === 1) return 1;
    const [x, y, z] = this.toMesh(point);
    return this.seen(this.lampPoints[index], [x, y + LIFT, z]);
  }

  /** The part of the sky that the mesh covers of a surface. @param {Vec3} point @param {Vec3} normal */
  covered(point, normal) {
    const [x, y, z] = this.toMesh(point);
    const found = Math.abs(y) < LIFT ? this.solid.coveredAt(x, z) : null;
    return found ?? coveredByBall(point, normal, this.center, this.radius * this.solidity());
  }

  /** Radius of a ball of about the same outline, parts of that around the mesh. */
  solidity() {
    const { height, reach } = this.solid.mesh;
    return Math.min(1, Math.sqrt(Math.max(height, 0.1) / (2 * reach)));
  }

  /** Draws the mesh where nothing is before it; `isFull` is with its shadow on itself. @param {Frame} frame @param {Lens} lens @param {boolean} isFull */
  draw(frame, lens, isFull) {
    const { rgb, depth, head } = frame;
    const { pose, solid } = this;
    const box = boxOf(frame, lens, this.center, this.radius);
    const { positions, indices } = solid.mesh;
    const points = new Float64Array(positions.length);
    for (let i = 0; i < positions.length; i += 3) points.set(add(pose.origin, times(this.turnedToWorld([positions[i], positions[i + 1], positions[i + 2]]), pose.scale)), i);
    const { triangles, nearest, width } = rasterise(lens, points, indices, box);
    const skies = isFull ? solid.freeAtCorners() : null;
    const own = new Uint32Array(SIDE * SIDE);
    for (let y = box.top; y < box.bottom; y++) {
      for (let x = box.left; x < box.right; x++) {
        const i = y * head.width + x;
        let hits = 0;
        for (let n = 0; n < SIDE * SIDE; n++) {
          const at = (SIDE * (y - box.top) + Math.floor(n / SIDE)) * width + SIDE * (x - box.left) + (n % SIDE);
          own[n] = depth && depth[i] < 1 / nearest[at] - NEARER * pose.scale ? NONE : triangles[at];
          if (own[n] !== NONE) hits++;
        }
        if (hits === 0) continue;
        const sum = this.ofPixel(lens, x, y, own, skies);
        const rest = 1 - hits / own.length;
        for (let c = 0; c < 3; c++) rgb[3 * i + c] = toHalf(fromHalf(rgb[3 * i + c]) * rest + sum[c] / (own.length * head.scale));
      }
    }
  }

  /** The sum of the light of the places of a pixel, once for each triangle there. @param {Lens} lens @param {number} x @param {number} y @param {Uint32Array} own triangle at each place @param {Float32Array | null} skies @returns {Vec3} */
  ofPixel(lens, x, y, own, skies) {
    /** @type {Vec3} */ let sum = [0, 0, 0];
    own.forEach((triangle, n) => {
      if (triangle === NONE || own.indexOf(triangle) !== n) return;
      let [u, v, count] = [0, 0, 0];
      for (let k = n; k < own.length; k++) {
        if (own[k] !== triangle) continue;
        [u, v, count] = [u + (k % SIDE) + 0.5, v + Math.floor(k / SIDE) + 0.5, count + 1];
      }
      const place = unproject(lens, x + u / (count * SIDE), y + v / (count * SIDE), 1);
      if (place) sum = add(sum, times(this.radianceOf(triangle, lens.eye, unit(sub(place, lens.eye)), skies), count));
    });
    return sum;
  }

  /** The light of a triangle where a ray of the world meets its plane. @param {number} triangle @param {Vec3} eye @param {Vec3} ray @param {Float32Array | null} skies @returns {Vec3} */
  radianceOf(triangle, eye, ray, skies) {
    const { mesh, tree } = this.solid;
    const corners = [0, 1, 2].map((k) => mesh.indices[3 * triangle + k]);
    const at = (/** @type {Float32Array} */ list, /** @type {number} */ corner) => /** @type {Vec3} */ ([list[3 * corner], list[3 * corner + 1], list[3 * corner + 2]]);
    const [a, b, c] = corners.map((corner) => at(mesh.positions, corner));
    const facet = cross(sub(b, a), sub(c, a));
    const [from, towards] = [this.toMesh(eye), this.turnedToMesh(ray)];
    const met = add(from, times(towards, dot(sub(a, from), facet) / dot(towards, facet)));
    const weights = weightsAt(met, a, b, c, facet);
    const mixed = weights.reduce((sum, weight, k) => add(sum, times(at(mesh.normals, corners[k]), weight)), /** @type {Vec3} */ ([0, 0, 0]));
    // Both sides of a triangle are seen.
    const side = dot(facet, towards) > 0 ? -1 : 1;
    const face = times(unit(facet), side);
    const smooth = times(unit(mixed), dot(mixed, facet) < 0 ? -side : side);
    const start = add(skies ? this.rounded(met, weights, corners, side) : met, times(face, LIFT));
    const sky = skies ? weights.reduce((sum, weight, k) => sum + weight * skies[corners[k]], 0) : 1;
    const normal = this.turnedToWorld(smooth);
    const lamps = this.light.lamps.map((lamp, i) => (!skies ? 1 : dot(sub(lamp.middle, this.center), normal) <= -this.radius ? 0 : this.seen(this.ownPoints[i], start)));
    const seesItself = (/** @type {Vec3} */ direction) => skies !== null && tree.isHit(...start, ...this.turnedToMesh(direction), Infinity);
    const material = mesh.materials[mesh.materialOf[triangle]];
    const point = add(this.pose.origin, times(this.turnedToWorld(met), this.pose.scale));
    return radianceTowardsEye(this.light, material, { point, normal, ray, lamps, sky, seesItself });
  }

  /** A point of a triangle on the round surface that it stands for, so that its edges cast no shadow (Hanika, "Hacking the shadow terminator", 2021). @param {Vec3} point @param {readonly number[]} weights @param {readonly number[]} corners @param {number} side @returns {Vec3} */
  rounded(point, weights, corners, side) {
    const { positions, normals } = this.solid.mesh;
    return corners.reduce((sum, corner, k) => {
      const normal = /** @type {Vec3} */ ([normals[3 * corner] * side, normals[3 * corner + 1] * side, normals[3 * corner + 2] * side]);
      const away = dot(sub(point, [positions[3 * corner], positions[3 * corner + 1], positions[3 * corner + 2]]), normal);
      return add(sum, times(sub(point, times(normal, Math.min(0, away))), weights[k]));
    }, /** @type {Vec3} */ ([0, 0, 0]));
  }
}

/** Weights of the corners at a point in the plane of a triangle, none below 0. @param {Vec3} point @param {Vec3} a @param {Vec3} b @param {Vec3} c @param {Vec3} facet */
function weightsAt(point, a, b, c, facet) {
  const area = Math.max(dot(facet, facet), 1e-30);
  const part = (/** @type {Vec3} */ p, /** @type {Vec3} */ q) => Math.max(0, dot(cross(sub(p, point), sub(q, point)), facet) / area);
  const parts = [part(b, c), part(c, a), part(a, b)];
  const all = parts[0] + parts[1] + parts[2];
  return all > 0 ? parts.map((value) => value / all) : [1 / 3, 1 / 3, 1 / 3];
}
