/** Light probes placed by clicking: the light that arrives at a point, as an environment map. */

import { Display } from "../display/display.js";
import { byId } from "../dom/elements.js";
import { download } from "../dom/files.js";
import { add, length, sub, times, unit } from "../math/vectors.js";
import { sampleAt, text } from "../picture/pixels.js";
import { checked, decode } from "../scene/server.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../viewer/overlay.js").Overlay} Overlay */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Frame} Frame */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** Time between looks at the progress, ms. */
const LOOK_MS = 250;
/** Distance from a surface towards the camera, as a part of the scene's size. */
const LIFT = 0.01;

/** @implements {Part} */
export class EnvironmentPanel {
  /** @type {Vec3 | null} */ at = null;
  isPlacing = false;
  /** @type {Frame | null} */ frame = null;
  /** @type {Display | null} */ display = null;
  asked = 0;
  /** The edits that the map was made with. */ edit = "";
  /** Ends the render that is under way. @type {AbortController | null} */ rendering = null;

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    this.canvas = /** @type {HTMLCanvasElement} */ (/** @type {unknown} */ (byId("environment-map")));
    byId("environment-tool").addEventListener("click", () => this.toggle());
    byId("environment-close").addEventListener("click", () => this.close());
    byId("environment-cancel").addEventListener("click", () => this.rendering?.abort());
    byId("environment-exr").addEventListener("click", () => download(`/api/environment.exr?${this.query()}`, "probe.exr"));
    byId("environment-save").addEventListener("click", () => void this.save());
    byId("environment-copy").addEventListener("click", () => void navigator.clipboard?.writeText(this.command()).catch(() => undefined));
    byId("environment-width").addEventListener("change", () => this.at && void this.place(this.at));
    this.canvas.addEventListener("pointermove", (event) => this.read(event.offsetX / this.canvas.clientWidth, event.offsetY / this.canvas.clientHeight));
    this.canvas.addEventListener("pointerleave", () => (byId("environment-value").textContent = ""));
  }

  /** Takes up the tool, or puts it down. */
  toggle() {
    this.isPlacing = !this.isPlacing;
    this.viewer.canvas.style.cursor = this.isPlacing ? "cell" : "";
    this.viewer.changed();
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event */
  clicked(x, y, event) {
    if (!this.isPlacing || event.button !== 0) return false;
    const { box, state, controls, clicks } = this.viewer;
    clicks.at(x / box.width, y / box.height, ({ position }) => {
      if (!this.isPlacing) return;
      if (!position) {
        this.show();
        return this.say("There is nothing to place a probe at; click a surface.");
      }
      this.toggle();
      // Towards the camera, at most half of the way.
      const ray = sub(state.eye, position);
      void this.place(add(position, times(unit(ray), Math.min(controls.size * LIFT, length(ray) / 2))));
    });
    return true;
  }

  query(at = this.at ?? [0, 0, 0]) {
    const edit = this.edit ? `&edit=${encodeURIComponent(this.edit)}` : "";
    return `at=${at.join(",")}&width=${byId("environment-width").value}${edit}`;
  }

  command() {
    const edit = this.edit ? " (of the scene with its edits saved)" : "";
    return `luxel probe ${this.viewer.scene?.name ?? ""} --at ${(this.at ?? []).join(",")} --size ${byId("environment-width").value} -o probe.exr${edit}`;
  }

  show() {
    byId("environment").hidden = false;
  }

  close() {
    this.asked++;
    this.rendering?.abort();
    [this.at, this.frame] = [null, null];
    byId("environment").hidden = true;
    this.viewer.changed();
  }

  /** Shows the light at a point. @param {Vec3} at */
  async place(at) {
    const asked = ++this.asked;
    this.rendering?.abort();
    const abort = (this.rendering = new AbortController());
    // Shorter numbers, which name the same place.
    this.at = /** @type {Vec3} */ (at.map((v) => Number(v.toPrecision(7))));
    this.edit = this.viewer.state.edit;
    this.frame = null;
    this.show();
    byId("environment-warnings").textContent = "";
    this.say("rendering …");
    this.viewer.changed();
    try {
      const query = this.query();
      const { signal } = abort;
      void this.follow(query, abort);
      const facts = await (await checked(await fetch(`/api/environment?${query}`, { signal }))).json();
      const frame = await decode(await checked(await fetch(`/api/environment.frame?${query}`, { signal })));
      if (asked !== this.asked || !frame) return;
      this.frame = frame;
      this.say(`at ${this.at.map(text).join("  ")} · peak ${text(facts.peak_radiance)} · light from above ${text(this.luminance(facts.irradiance[2]))}`);
      byId("environment-warnings").textContent = facts.warnings.join(" ");
    } catch (error) {
      if (asked === this.asked) this.say(abort.signal.aborted ? "cancelled; click the picture again, or choose another width" : /** @type {Error} */ (error).message);
    } finally {
      if (this.rendering === abort) this.rendering = null;
    }
    this.viewer.changed();
  }

  /** Shows how far a render is until it ends. @param {string} query @param {AbortController} abort */
  async follow(query, abort) {
    const bar = /** @type {HTMLProgressElement} */ (/** @type {unknown} */ (byId("environment-progress")));
    [bar.max, bar.value] = [1, 0];
    while (this.rendering === abort) {
      try {
        const { done, total } = await (await checked(await fetch(`/api/environment/progress?${query}`))).json();
        if (this.rendering !== abort) return;
        [bar.max, bar.value] = [Math.max(1, total), done];
        if (total) this.say(`rendering, ${done} of ${total} views`);
      } catch {
        // The render itself tells what is wrong.
      }
      await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    }
  }

  /** @param {Vec3} rgb */
  luminance(rgb) {
    const weights = this.viewer.scene?.luminance_weights ?? [0, 0, 0];
    return rgb[0] * weights[0] + rgb[1] * weights[1] + rgb[2] * weights[2];
  }

  async save() {
    try {
      const name = encodeURIComponent(byId("environment-name").value.trim());
      const { path } = await (await checked(await fetch(`/api/environment/save?${this.query()}&name=${name}`, { method: "POST" }))).json();
      this.say(`saved: ${path}`);
    } catch (error) {
      this.say(/** @type {Error} */ (error).message);
    }
  }

  /** Shows the value at a place of the map, 0 to 1. @param {number} u @param {number} v */
  read(u, v) {
    const { frame, viewer } = this;
    const sample = frame && viewer.scene && sampleAt(frame, null, u, v, viewer.scene.luminance_weights);
    byId("environment-value").textContent = sample ? `${sample.radiance.map(text).join("  ")} · luminance ${text(sample.luminance)}` : "";
  }

  /** @param {string} message */
  say(message) {
    byId("environment-text").textContent = message;
  }

  /** @param {Overlay} overlay @param {Lens} lens */
  draw(overlay, lens) {
    if (this.at) overlay.ball(this.at, lens, "light probe");
  }

  reflect() {
    byId("environment-tool").setAttribute("aria-pressed", String(this.isPlacing));
    byId("environment-progress-row").hidden = this.rendering === null;
    for (const id of ["environment-exr", "environment-save", "environment-copy"]) /** @type {HTMLButtonElement} */ (byId(id)).disabled = !this.frame;
    const { frame, viewer } = this;
    this.canvas.classList.toggle("empty", !frame);
    if (!frame || !viewer.scene) return;
    [this.canvas.width, this.canvas.height] = [2 * this.canvas.clientWidth, 2 * this.canvas.clientHeight];
    const isNew = !this.display;
    this.display ??= new Display(this.canvas);
    this.display.scene = viewer.scene;
    if (isNew || this.display.picture !== frame) this.display.show(frame, false);
    const layer = viewer.state.layer === "stops" ? "stops" : "radiance";
    this.display.draw({ ...viewer.state, layer, compare: "off", zebra: viewer.state.zebra }, false);
  }
}
