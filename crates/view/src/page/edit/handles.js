/** Handles of boxes and spheres in the picture: the centre, the faces, the radius. */

import { project, unproject } from "../math/lens.js";
import { add, dot, length, sub, times } from "../math/vectors.js";
import { DRAG } from "./edits.js";
import { formatTests, shape, shapeText } from "./selection.js";

/** @typedef {import("./edits.js").Edits} Edits */
/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../viewer/overlay.js").Overlay} Overlay */
/** @typedef {import("../viewer/part.js").Grip} Grip */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */
/** A point to drag: along an axis, or in the plane of the picture; `moved` returns the shape's numbers after a movement in the world. @typedef {{ at: Vec3, axis: Vec3 | null, moved: (by: Vec3) => number[] }} Handle */
/** A shape of the current entry: which test, its name, its numbers. @typedef {{ test: number, name: "box" | "sphere", numbers: number[] }} Shape */

/** Distance from which a handle is taken, pixels. */
const REACH = 11;
/** Segments of a circle. */
const SEGMENTS = 48;
/** @type {Vec3[]} */
const AXES = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
/** Edges of a box by its corners, whose bits are sides of x, y, z. */
const EDGES = [[0, 1], [0, 2], [0, 4], [1, 3], [1, 5], [2, 3], [2, 6], [3, 7], [4, 5], [4, 6], [5, 7], [6, 7]];

/** @param {Shape} shape @returns {Handle[]} */
function handlesOf({ name, numbers }) {
  if (name === "sphere") {
    const [center, radius] = [/** @type {Vec3} */ (numbers.slice(0, 3)), numbers[3]];
    const whole = { at: center, axis: null, moved: (/** @type {Vec3} */ by) => [...add(center, by), radius] };
    const sides = AXES.flatMap((axis) => [1, -1].map((sign) => {
      const out = times(axis, sign);
      return { at: add(center, times(out, radius)), axis: out, moved: (/** @type {Vec3} */ by) => [...center, Math.max(1e-6, radius + dot(by, out))] };
    }));
    return [whole, ...sides];
  }
  const [low, high] = [/** @type {Vec3} */ (numbers.slice(0, 3)), /** @type {Vec3} */ (numbers.slice(3))];
  const center = times(add(low, high), 0.5);
  const whole = { at: center, axis: null, moved: (/** @type {Vec3} */ by) => [...add(low, by), ...add(high, by)] };
  const faces = AXES.flatMap((axis, a) => [0, 1].map((side) => {
    const at = /** @type {Vec3} */ (center.map((value, k) => (k === a ? (side ? high : low)[a] : value)));
    const moved = (/** @type {Vec3} */ by) => {
      const next = [...low, ...high];
      next[a + 3 * side] = side ? Math.max(low[a], high[a] + by[a]) : Math.min(high[a], low[a] + by[a]);
      return next;
    };
    return { at, axis, moved };
  }));
  return [whole, ...faces];
}

/** @implements {Part} */
export class Handles {
  /** @param {Viewer} viewer @param {Edits} edits */
  constructor(viewer, edits) {
    this.viewer = viewer;
    this.edits = edits;
  }

  /** Boxes and spheres of the current entry. @returns {Shape[]} */
  shapes() {
    return (this.edits.tests()?.tests ?? []).flatMap(({ body }, test) => {
      const found = /** @type {const} */ (["box", "sphere"]).map((name) => ({ test, name, numbers: shape(body, name) }));
      return /** @type {Shape[]} */ (found.filter(({ numbers }) => numbers));
    });
  }

  /** @param {Shape} shape @param {number[]} numbers */
  put({ test, name }, numbers) {
    const tests = this.edits.tests();
    if (!tests) return;
    const next = tests.tests.map((known, i) => (i === test ? { ...known, body: shapeText(name, numbers) } : known));
    this.edits.update(this.edits.current, { where: formatTests({ ...tests, tests: next }) }, `${DRAG} ${test}`);
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event @returns {Grip | null} */
  grab(x, y, event) {
    if (event.button !== 0) return null;
    const lens = this.viewer.lens(this.viewer.box.width, this.viewer.box.height);
    let [best, nearest] = [/** @type {{ shape: Shape, handle: Handle } | null} */ (null), REACH];
    for (const shape of this.shapes()) {
      for (const handle of handlesOf(shape)) {
        const place = project(lens, handle.at);
        const away = place ? Math.hypot(place.x - x, place.y - y) : Infinity;
        if (away < nearest) [best, nearest] = [{ shape, handle }, away];
      }
    }
    if (!best) return null;
    const { shape, handle } = best;
    return { move: (nx, ny) => this.put(shape, handle.moved(this.movement(lens, handle, nx - x, ny - y))), end: () => (this.edits.lastTag = "") };
  }

  /** A movement in the world for one on the screen. @param {Lens} lens @param {Handle} handle @param {number} dx @param {number} dy @returns {Vec3} */
  movement(lens, { at, axis }, dx, dy) {
    const place = project(lens, at);
    if (!place) return [0, 0, 0];
    if (!axis) {
      const to = unproject(lens, place.x + dx, place.y + dy, place.depth);
      return to ? sub(to, at) : [0, 0, 0];
    }
    const step = Math.max(1e-9, length(sub(at, lens.eye)) * 1e-3);
    const ahead = project(lens, add(at, times(axis, step)));
    if (!ahead) return [0, 0, 0];
    const [ax, ay] = [(ahead.x - place.x) / step, (ahead.y - place.y) / step];
    const steep = ax * ax + ay * ay;
    // An axis that points at the eye cannot be dragged along.
    return steep * step * step < 1e-8 ? [0, 0, 0] : times(axis, (dx * ax + dy * ay) / steep);
  }

  /** @param {Overlay} overlay @param {Lens} lens */
  draw(overlay, lens) {
    const { context } = overlay;
    for (const shape of this.shapes()) {
      for (const [width, color] of /** @type {[number, string][]} */ ([[3, "#0008"], [1, "#fff"]])) {
        [context.lineWidth, context.strokeStyle] = [width, color];
        this.outline(overlay, lens, shape);
      }
      for (const { at, axis } of handlesOf(shape)) {
        const place = project(lens, at);
        if (!place) continue;
        context.beginPath();
        context.arc(place.x, place.y, axis ? 4 : 6, 0, 2 * Math.PI);
        context.fillStyle = axis ? "#fff" : "#161616";
        context.fill();
        context.stroke();
      }
    }
    context.lineWidth = 1;
  }

  /** @param {Overlay} overlay @param {Lens} lens @param {Shape} shape */
  outline(overlay, lens, { name, numbers }) {
    if (name === "box") {
      const corner = (/** @type {number} */ bits) => /** @type {Vec3} */ ([0, 1, 2].map((a) => numbers[a + (bits & (1 << a) ? 3 : 0)]));
      for (const [a, b] of EDGES) overlay.path([corner(a), corner(b)], lens);
      return;
    }
    const center = /** @type {Vec3} */ (numbers.slice(0, 3));
    for (const [u, v] of [[0, 1], [1, 2], [2, 0]]) {
      const points = Array.from({ length: SEGMENTS + 1 }, (_, i) => {
        const angle = (2 * Math.PI * i) / SEGMENTS;
        return add(center, add(times(AXES[u], numbers[3] * Math.cos(angle)), times(AXES[v], numbers[3] * Math.sin(angle))));
      });
      overlay.path(points, lens);
    }
  }
}
