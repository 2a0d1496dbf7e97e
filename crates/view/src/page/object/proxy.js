/** A proxy mesh of the scene (`luxel view --mesh`): a floor and walls to walk between, and a surface for the pivot. */

import { add, dot, length, sub, times } from "../math/vectors.js";
import { checked } from "../scene/server.js";
import { Tree } from "./bvh.js";
import { readGlb } from "./glb.js";

/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Scene} Scene */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** Distance kept from walls, heights of the eye. */
const MARGIN = 0.15;
/** Heights above the floor at which a walker meets walls, heights of the eye. */
const BODY = [0.5, 1];
/** Largest step up and down, heights of the eye. */
const STEP = 0.4;

/** @implements {Part} */
export class Proxy {
  /** @type {Tree | null} */ tree = null;
  /** Height of the eye above the floor, and the place where it was found. @type {{ height: number, eye: Vec3 } | null} */ stand = null;

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
  }

  /** @param {Scene} scene */
  sceneSet({ mesh }) {
    if (mesh && !this.tree) void this.load(mesh.world_from_file);
  }

  /** @param {number[][]} rows of the turn from the file to the world */
  async load(rows) {
    const { messages } = this.viewer;
    try {
      const { mesh } = readGlb(await (await checked(await fetch("/api/mesh"))).arrayBuffer(), (rgb) => rgb);
      const { positions } = mesh;
      for (let i = 0; i < positions.length; i += 3) {
        const [x, y, z] = positions.subarray(i, i + 3);
        positions.set(rows.map((row) => row[0] * x + row[1] * y + row[2] * z), i);
      }
      this.tree = new Tree(positions, mesh.indices);
      messages.set("mesh", "");
    } catch (error) {
      messages.set("mesh", `the proxy mesh cannot be used: ${/** @type {Error} */ (error).message}`);
    }
    this.viewer.changed();
  }

  /** Distance to the mesh along a direction of unit length; infinite where there is none. @param {Vec3} [from] @param {Vec3} [along] */
  distance([x, y, z] = [0, 0, 0], [dx, dy, dz] = [0, 0, 0]) {
    return this.tree ? this.tree.distance(x, y, z, dx, dy, dz, Infinity) : Infinity;
  }

  /** Where a walker who wants to move gets: not through walls, and at one height above the floor. @param {Vec3} eye @param {Vec3} by @param {Vec3} up @returns {Vec3} */
  walked(eye, by, up) {
    const down = times(up, -1);
    const rise = dot(by, up);
    if (!this.stand || length(sub(this.stand.eye, eye)) > 0) this.stand = { height: this.distance(eye, down), eye };
    const { height } = this.stand;
    if (!this.tree || height === Infinity || rise !== 0) {
      const to = add(eye, by);
      this.stand = { height: this.distance(to, down), eye: to };
      return to;
    }
    const far = length(by);
    if (!(far > 0)) return eye;
    const ahead = times(by, 1 / far);
    const free = Math.min(...BODY.map((part) => this.distance(add(eye, times(up, (part - 1) * height)), ahead))) - MARGIN * height;
    const level = add(eye, times(ahead, Math.min(far, Math.max(0, free))));
    const higher = height - this.distance(level, down);
    // A higher step is a wall; a hole and a deep drop leave the walker where the floor was.
    if (higher > STEP * height) return eye;
    const to = higher < -STEP * height ? level : add(level, times(up, higher));
    this.stand = { height, eye: to };
    return to;
  }
}
