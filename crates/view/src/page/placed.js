/** An object placed by clicking: a ball in the light of the scene, with its shadow on what the picture shows. */

import { fromHalf, toHalf } from "./half.js";
import { irradianceFrom, irradianceOf, lampAlong, outline, radianceFrom, shadow } from "./lamps.js";
import { project, unproject } from "./lens.js";
import { add, dot, length, sub, times, unit } from "./math.js";
import { text } from "./measure.js";
import { byId } from "./panel.js";
import { checked } from "./server.js";
import { meeting, surfaceAt } from "./surface.js";

/** @typedef {import("./lamps.js").Lamp} Lamp */
/** @typedef {import("./lamps.js").LightMap} LightMap */
/** @typedef {import("./lens.js").Lens} Lens */
/** @typedef {import("./math.js").Vec3} Vec3 */
/** @typedef {import("./overlay.js").Overlay} Overlay */
/** @typedef {import("./part.js").Part} Part */
/** @typedef {import("./scene.js").Frame} Frame */
/** @typedef {import("./stream.js").Shown} Shown */
/** @typedef {import("./viewer.js").Viewer} Viewer */
/** @typedef {{ lamps: Lamp[], map: LightMap, fromMap: (normal: Vec3) => Vec3 }} Light */
/** A ball: the surface that it stands on, its light. @typedef {{ under: import("./surface.js").Plane, light: Light | null }} Ball */

/** Reflectance of the grey ball. */
const GREY = 0.5;
/** Distance from the ball up to which its shadow is drawn, radii. */
const SHADOW_REACH = 8;
/** Rays along each side of a pixel of the ball. */
const RAYS = 2;
/** A surface hides the ball if it is nearer by this part of the radius: depths of splats are soft. */
const NEARER = 0.5;
/** Distance from the plane under the ball up to which what is seen counts as lying on it, radii. */
const ON_PLANE = 0.7;
/** Points around a lamp's mark. */
const MARKS = 32;

/** @implements {Part} */
export class Placed {
  /** @type {Ball | null} */ ball = null;
  isPlacing = false;
  asked = 0;
  /** Ends the search for lamps that is under way. @type {AbortController | null} */ finding = null;
  message = "";
  /** Pictures as they came. @type {WeakMap<Frame, Uint16Array>} */ plain = new WeakMap();

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    this.kind = /** @type {HTMLSelectElement} */ (/** @type {unknown} */ (byId("object-kind")));
    this.size = /** @type {HTMLInputElement} */ (/** @type {unknown} */ (byId("object-size")));
    byId("object-tool").addEventListener("click", () => this.toggle());
    byId("object-remove").addEventListener("click", () => this.remove());
    this.kind.addEventListener("change", () => this.again());
    this.size.addEventListener("input", () => this.again());
  }

  /** Radius of the ball, world units. */
  radius() {
    return this.viewer.controls.size * 2 ** this.size.valueAsNumber;
  }

  /** Takes up the tool, or puts it down. */
  toggle() {
    this.isPlacing = !this.isPlacing;
    this.viewer.canvas.style.cursor = this.isPlacing ? "cell" : "";
    this.viewer.changed();
  }

  remove() {
    this.asked++;
    this.finding?.abort();
    [this.ball, this.finding, this.message] = [null, null, ""];
    this.again();
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event */
  clicked(x, y, event) {
    if (!this.isPlacing || event.button !== 0) return false;
    const { box, clicks } = this.viewer;
    const [u, v] = [x / box.width, y / box.height];
    clicks.at(u, v, ({ position }) => {
      if (!this.isPlacing) return;
      const { shown } = this.viewer;
      const { width, height } = shown?.frame.head ?? { width: 0, height: 0 };
      const under = shown && position && surfaceAt(shown.frame, shown.lens, Math.floor(u * width), Math.floor(v * height), this.viewer.up());
      if (!under) return void this.say("There is nothing to stand on; click a surface in a picture of a pinhole.");
      this.toggle();
      void this.place(under);
    });
    return true;
  }

  /** Puts the ball onto a surface, and finds the light there. @param {import("./surface.js").Plane} under */
  async place(under) {
    const asked = ++this.asked;
    this.finding?.abort();
    const abort = (this.finding = new AbortController());
    this.ball = { under, light: null };
    this.say("finding the lamps …");
    try {
      const { edit } = this.viewer.state;
      const middle = this.middle().map((v) => Number(v.toPrecision(7)));
      const found = await (await checked(await fetch(`/api/lamps?at=${middle.join(",")}${edit ? `&edit=${encodeURIComponent(edit)}` : ""}`, { signal: abort.signal }))).json();
      if (asked !== this.asked || !this.ball) return;
      this.ball.light = { lamps: found.lamps, map: found.map, fromMap: irradianceOf(found.map) };
      const unseen = found.unseen_share > 0.01 ? `; no view saw ${(100 * found.unseen_share).toFixed(0)} % of all directions` : "";
      this.say(`${found.lamps.length === 1 ? "1 lamp" : `${found.lamps.length} lamps`}${unseen}`);
    } catch (error) {
      if (asked === this.asked && !abort.signal.aborted) this.say(/** @type {Error} */ (error).message);
    } finally {
      if (this.finding === abort) this.finding = null;
    }
    this.again();
  }

  /** @param {string} message */
  say(message) {
    this.message = message;
    this.viewer.changed();
  }

  /** Middle of the ball. @returns {Vec3} */
  middle() {
    const { point, normal } = /** @type {Ball} */ (this.ball).under;
    return add(point, times(normal, this.radius()));
  }

  /** Draws the picture that is there again, with the ball as it is now. */
  again() {
    const { shown } = this.viewer;
    if (shown) this.viewer.take(shown);
    this.viewer.changed();
  }

  /** Puts the ball into a picture. @param {Shown} shown */
  altered({ frame, lens, full }) {
    const plain = this.plain.get(frame) ?? frame.rgb;
    frame.rgb = plain;
    const { light, under } = this.ball ?? {};
    if (!light || !under || lens.projection.kind !== "pinhole" || !frame.head.rgb) return;
    this.plain.set(frame, plain);
    frame.rgb = plain.slice();
    const ball = { center: this.middle(), radius: this.radius(), under };
    if (full && frame.depth) drawShadow(frame, lens, light, ball);
    drawBall(frame, lens, light, ball, this.kind.value === "chrome");
  }

  /** @param {Overlay} overlay @param {Lens} lens */
  draw(overlay, lens) {
    const { ball, viewer } = this;
    if (!ball?.light) return;
    const weights = viewer.scene?.luminance_weights ?? [0, 0, 0];
    overlay.context.strokeStyle = "#ffd76a";
    ball.light.lamps.forEach((lamp, i) => {
      overlay.path(outline(lamp, lens.eye, MARKS), lens, true);
      const place = project(lens, lamp.middle);
      if (place) overlay.label(`lamp ${i + 1} · power ${text(dot(lamp.power, weights))}`, place.x + 10, place.y - 10);
    });
  }

  reflect() {
    byId("object-tool").setAttribute("aria-pressed", String(this.isPlacing));
    byId("object-row").hidden = !this.ball;
    byId("object-text").textContent = this.message;
  }
}

/** Rows and columns of a picture that a ball of the world may cover. @param {Frame} frame @param {Lens} lens @param {Vec3} center @param {number} radius */
function boxOf({ head }, lens, center, radius) {
  const place = project(lens, center);
  const whole = { left: 0, top: 0, right: head.width, bottom: head.height };
  if (!place || place.depth <= radius) return whole;
  const around = (1.5 * radius * Math.max(lens.fx, lens.fy)) / (place.depth - radius);
  const within = (/** @type {number} */ v, /** @type {number} */ most) => Math.max(0, Math.min(most, Math.floor(v)));
  return { left: within(place.x - around, head.width), top: within(place.y - around, head.height), right: within(place.x + around + 1, head.width), bottom: within(place.y + around + 1, head.height) };
}

/** Darkens what the ball keeps light from; depths are rough, so what is seen near the plane under it lies on it, and all is turned as it is. @param {Frame} frame @param {Lens} lens @param {Light} light @param {{ center: Vec3, radius: number, under: import("./surface.js").Plane }} ball */
function drawShadow(frame, lens, light, { center, radius, under }) {
  const { rgb, depth, head } = frame;
  if (!depth) return;
  const { left, top, right, bottom } = boxOf(frame, lens, center, SHADOW_REACH * radius);
  for (let y = top; y < bottom; y++) {
    for (let x = left; x < right; x++) {
      const i = y * head.width + x;
      const seen = depth[i] < 1e30 ? unproject(lens, x + 0.5, y + 0.5, depth[i]) : null;
      if (!seen || length(sub(seen, center)) > SHADOW_REACH * radius) continue;
      const isOnPlane = Math.abs(dot(sub(seen, under.point), under.normal)) < ON_PLANE * radius;
      const point = (isOnPlane && meeting(under, lens.eye, sub(seen, lens.eye))) || seen;
      const factor = shadow(light, point, under.normal, center, radius);
      for (let c = 0; c < 3; c++) rgb[3 * i + c] = toHalf(fromHalf(rgb[3 * i + c]) * factor[c]);
    }
  }
}

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
function drawBall(frame, lens, light, { center, radius }, isChrome) {
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
