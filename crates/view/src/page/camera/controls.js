/** Moves the camera by mouse, touch and keyboard. Keys of movement are told by place, so that they are W, A, S, D on any keyboard. */

import { lensOf } from "../math/lens.js";
import { add, clamp, cross, dot, length, looking, sub, times, turn, turnAxes, unit } from "../math/vectors.js";

/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../viewer/part.js").Grip} Grip */
/** @typedef {import("../viewer/state.js").State} State */

const MOVES = new Set(["KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE", "ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight"]);
/** Radians per screen pixel of dragging. */
const TURN = 0.005;

export class Controls {
  /** @type {Map<number, { x: number, y: number }>} */ pointers = new Map();
  keys = new Set();
  fast = false;
  dragged = 0;
  /** Whether the pointer that was lifted had not been dragged. */ wasClick = false;
  /** A drag that a part of the viewer has taken hold of. @type {Grip | null} */ grip = null;
  /** Unit of speed: a part of the scene's size. */ size = 1;
  /** @type {Vec3} */ up = [0, 1, 0];
  /** Floor and walls. @type {import("../object/proxy.js").Proxy | null} */ proxy = null;

  /**
   * @param {HTMLElement} element @param {State} state
   * @param {{ moved: () => void, clicked: (x: number, y: number, event: PointerEvent) => void, pivoted: (x: number, y: number) => void,
   *   grabbed: (x: number, y: number, event: PointerEvent) => Grip | null, hovered: (x: number, y: number) => void }} on
   */
  constructor(element, state, on) {
    this.state = state;
    this.on = on;
    this.element = element;
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of /** @type {const} */ (["pointerup", "pointercancel"])) element.addEventListener(kind, (event) => this.lift(event));
    // The only event that counts clicks, which tells the second of a double click.
    element.addEventListener("click", (event) => this.wasClick && on.clicked(event.offsetX, event.offsetY, /** @type {PointerEvent} */ (event)));
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    element.addEventListener("dblclick", (event) => on.pivoted(event.offsetX, event.offsetY));
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    addEventListener("keydown", (event) => this.key(event, true));
    addEventListener("keyup", (event) => this.key(event, false));
    addEventListener("blur", () => this.keys.clear());
  }

  /** @param {KeyboardEvent} event @param {boolean} isDown */
  key(event, isDown) {
    this.fast = event.shiftKey;
    if (!MOVES.has(event.code) || event.ctrlKey || event.metaKey || event.altKey) return;
    if (!isDown) return void this.keys.delete(event.code);
    const target = /** @type {HTMLElement} */ (event.target);
    if (target.closest("input, select, textarea, button, dialog")) return;
    this.keys.add(event.code);
    event.preventDefault();
  }

  /** @param {PointerEvent} event */
  down(event) {
    this.element.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    if (this.pointers.size === 1) this.dragged = 0;
    this.grip?.end?.();
    this.grip = this.pointers.size === 1 ? this.on.grabbed(event.offsetX, event.offsetY, event) : null;
  }

  /** @param {PointerEvent} event */
  move(event) {
    const from = this.pointers.get(event.pointerId);
    if (!from) return this.on.hovered(event.offsetX, event.offsetY);
    const [x, y] = [event.offsetX, event.offsetY];
    const [dx, dy] = [x - from.x, y - from.y];
    this.dragged += Math.abs(dx) + Math.abs(dy);
    if (this.grip) {
      this.grip.move(x, y, event);
    } else if (this.pointers.size >= 2) {
      const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1] ?? from;
      const apart = (/** @type {{ x: number, y: number }} */ p) => Math.hypot(p.x - other.x, p.y - other.y);
      this.dolly(apart(from) / Math.max(1, apart({ x, y })));
      this.pan(dx / 2, dy / 2);
    } else if (this.dragged > 3) {
      if (event.buttons & 6 || event.shiftKey) this.pan(dx, dy);
      else this.rotate(dx, dy);
    }
    this.pointers.set(event.pointerId, { x, y });
    this.on.hovered(x, y);
  }

  /** @param {PointerEvent} event */
  lift(event) {
    const was = this.pointers.delete(event.pointerId);
    const { grip } = this;
    this.grip = null;
    grip?.end?.();
    this.wasClick = was && event.type === "pointerup" && this.dragged <= 3 && !grip;
  }

  /** @param {WheelEvent} event */
  wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === 0 ? event.deltaY / 100 : event.deltaY / 3;
    this.dolly(1.15 ** clamp(lines, -4, 4));
  }

  /** Turns about the pivot, or on the spot. @param {number} dx @param {number} dy */
  rotate(dx, dy) {
    const { state, up } = this;
    if (state.mode === "orbit") {
      const arm = sub(state.eye, state.pivot);
      const pitch = this.limited(-dy * TURN);
      const swing = (/** @type {Vec3} */ v) => turn(turn(v, state.axes.right, pitch), up, -dx * TURN);
      state.eye = add(state.pivot, swing(arm));
      state.axes = turnAxes(turnAxes(state.axes, state.axes.right, pitch), up, -dx * TURN);
    } else {
      state.axes = turnAxes(turnAxes(state.axes, state.axes.right, this.limited(-dy * TURN * 0.6)), up, -dx * TURN * 0.6);
    }
    this.left();
  }

  /** A pitch that does not go over the poles. @param {number} angle */
  limited(angle) {
    const back = turn(this.state.axes.back, this.state.axes.right, angle);
    return Math.abs(dot(back, this.up)) > 0.995 && Math.abs(dot(back, this.up)) > Math.abs(dot(this.state.axes.back, this.up)) ? 0 : angle;
  }

  /** Moves sideways, so that what is at the pivot follows the pointer. @param {number} dx @param {number} dy */
  pan(dx, dy) {
    const { state } = this;
    const perPixel = this.distance() / lensOf(state, Math.max(1, this.element.clientWidth), Math.max(1, this.element.clientHeight)).fy;
    const by = add(times(state.axes.right, -dx * perPixel), times(state.axes.up, dy * perPixel));
    state.eye = add(state.eye, by);
    state.pivot = add(state.pivot, by);
    this.left();
  }

  /** Changes the distance to the pivot, or moves along the view. @param {number} factor */
  dolly(factor) {
    const { state } = this;
    if (state.mode === "orbit") {
      const arm = times(sub(state.eye, state.pivot), factor);
      if (length(arm) > this.size * 1e-4 && length(arm) < this.size * 100) state.eye = add(state.pivot, arm);
    } else {
      const by = times(state.axes.back, (factor - 1) * this.size * 0.5);
      state.eye = add(state.eye, by);
      state.pivot = add(state.pivot, by);
    }
    this.left();
  }

  distance() {
    return Math.max(length(sub(this.state.eye, this.state.pivot)), this.size * 0.02);
  }

  /** Moves by the keys that are down. @param {number} seconds since the last call */
  step(seconds) {
    if (this.keys.size === 0) return;
    const { state, keys, up } = this;
    const pressed = (/** @type {string} */ a, /** @type {string} */ b) => (keys.has(a) || keys.has(b) ? 1 : 0);
    const ahead = pressed("KeyW", "ArrowUp") - pressed("KeyS", "ArrowDown");
    const aside = pressed("KeyD", "ArrowRight") - pressed("KeyA", "ArrowLeft");
    const above = pressed("KeyE", "") - pressed("KeyQ", "");
    let forward = times(state.axes.back, -1);
    // Walking stays at the height of the eye.
    if (state.mode === "walk") forward = unit(sub(forward, times(up, dot(forward, up))));
    const right = state.mode === "walk" ? unit(cross(forward, up)) : state.axes.right;
    const by = add(add(times(forward, ahead), times(right, aside)), times(up, above));
    const speed = this.size * (this.fast ? 0.8 : 0.2) * Math.min(seconds, 0.1);
    const wanted = times(by, speed);
    const moved = state.mode === "walk" && this.proxy ? sub(this.proxy.walked(state.eye, wanted, up), state.eye) : wanted;
    state.eye = add(state.eye, moved);
    state.pivot = add(state.pivot, moved);
    this.left();
  }

  /** Levels the horizon. */
  level() {
    this.state.axes = looking(times(this.state.axes.back, -1), this.up);
    this.left();
  }

  /** The place of a camera was left. */
  left() {
    this.state.view = "";
    this.on.moved();
  }
}
