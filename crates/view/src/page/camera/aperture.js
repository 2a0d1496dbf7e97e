/** A lens before the picture: aperture and focus, and the samples that follow while the picture is at rest. */

import { byId } from "../dom/elements.js";
import { fromHalf, toHalf } from "../math/half.js";
import { text } from "../picture/pixels.js";
import { sampled } from "../scene/variant.js";

/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Frame} Frame */
/** @typedef {import("../scene/stream.js").Shown} Shown */
/** @typedef {import("../scene/stream.js").Want} Want */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** Samples of a picture at rest, and the parts in which they come. */
const [SAMPLES, PARTS] = [128, 16];
/** Width of the sensor, which gives an f-number its focal length, mm: as `luxel render --f-stop`. */
const SENSOR_MM = 36;

/** @implements {Part} */
export class AperturePanel {
  isPicking = false;
  /** The picture that parts are added to. @type {Frame | null} */ frame = null;
  /** Radiance of the first part. @type {Uint16Array | null} */ plain = null;
  /** Sum of the parts, of radiance divided by the scale of the first. */ sum = new Float32Array(0);
  parts = 0;
  /** Ends the part that is under way. @type {AbortController | null} */ adding = null;
  failure = "";

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    const value = (/** @type {string} */ id) => (byId(id).valueAsNumber > 0 ? byId(id).valueAsNumber : 0);
    byId("f-stop").addEventListener("input", () => this.choose({ fStop: value("f-stop"), aperture: 0 }));
    byId("aperture").addEventListener("input", () => this.choose({ aperture: value("aperture"), fStop: 0 }));
    byId("focus").addEventListener("input", () => value("focus") && viewer.set({ focus: value("focus") }));
    byId("focus-tool").addEventListener("click", () => this.toggle());
  }

  /** Chooses an aperture; without a focus, what is in the middle of the picture is in focus. @param {Partial<import("../viewer/state.js").State>} change */
  choose(change) {
    const { viewer } = this;
    const { eye, axes, pivot } = viewer.state;
    const ahead = -[0, 1, 2].reduce((sum, k) => sum + (pivot[k] - eye[k]) * axes.back[k], 0);
    const middle = viewer.sample(0.5, 0.5)?.depth ?? (ahead > 0 ? ahead : viewer.controls.size);
    viewer.set({ ...change, focus: viewer.state.focus || Number(middle.toPrecision(4)) });
  }

  toggle() {
    this.isPicking = !this.isPicking;
    this.viewer.canvas.style.cursor = this.isPicking ? "cell" : "";
    this.viewer.changed();
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event */
  clicked(x, y, event) {
    if (!this.isPicking || event.button !== 0) return false;
    const { box, clicks } = this.viewer;
    clicks.at(x / box.width, y / box.height, ({ depth }) => {
      if (!this.isPicking) return;
      if (depth === null) return this.viewer.messages.notice("There is nothing to focus on; click a surface.");
      this.toggle();
      this.viewer.set({ focus: Number(depth.toPrecision(5)) });
    });
    return true;
  }

  /** Length of a world unit in metres; 0 where unknown. */
  metres() {
    return this.viewer.state.metres || this.viewer.scene?.metres_per_unit || 0;
  }

  /** Diameter of the aperture, world units; 0 for a pinhole. */
  diameter() {
    const { state, dots } = this.viewer;
    if (state.aperture > 0 || state.fStop <= 0) return state.aperture;
    const metres = this.metres();
    const { fx, width } = this.viewer.lens(dots.width, dots.height);
    return metres > 0 ? (1e-3 * fx * SENSOR_MM) / (width * state.fStop * metres) : 0;
  }

  /** Why there is no lens where one is chosen; "" where there is. */
  obstacle() {
    const { state, scene } = this.viewer;
    if (state.fStop > 0 && this.metres() === 0) return "An f-number needs the length of a unit: pin two points and state their distance, or give the aperture in world units.";
    if (scene?.training) return "A scene that is being trained is seen through a pinhole.";
    if (state.splats !== "blended") return "A lens needs blended splats.";
    return this.viewer.lens(1, 1).projection.kind === "pinhole" ? "" : "A lens needs the projection of a pinhole.";
  }

  /** The lens of the variant that is wanted. @returns {{ lens?: import("../scene/variant.js").Aperture }} */
  chosen() {
    const { focus } = this.viewer.state;
    const diameter = this.diameter();
    return diameter > 0 && focus > 0 && !this.obstacle() ? { lens: { diameter, focus, samples: SAMPLES, part: [0, PARTS] } } : {};
  }

  /** Takes a new picture for the first part. @param {Shown} shown */
  altered({ frame }) {
    if (frame === this.frame) return;
    this.adding?.abort();
    [this.frame, this.adding, this.parts, this.failure] = [frame, null, 1, ""];
    this.sum = new Float32Array(0);
    this.plain = frame.rgb;
  }

  /** Asks for the next part, once the picture is at rest. */
  step() {
    const { stream, shown } = this.viewer;
    const { want } = stream;
    if (this.adding && stream.restedKey !== want?.key) this.adding.abort();
    if (!want?.variant.lens || this.adding || this.failure || this.parts >= PARTS) return;
    if (shown?.full && shown.frame === this.frame && stream.restedKey === want.key) void this.add(want, shown);
  }

  /** Adds a part to the picture. @param {Want} want @param {Shown} shown */
  async add(want, shown) {
    const abort = (this.adding = new AbortController());
    try {
      const variant = sampled(want.variant, { part: [this.parts, PARTS] });
      const part = await this.viewer.source.frame(shown.lens, { edit: want.edit, variant, radiance: true, layers: false, name: "lens" }, abort.signal);
      if (!part || abort.signal.aborted || this.frame !== shown.frame) return;
      const { scale } = shown.frame.head;
      if (this.parts === 1) this.sum = Float32Array.from(this.plain ?? [], fromHalf);
      const factor = part.head.scale / scale;
      for (let i = 0; i < this.sum.length; i++) this.sum[i] += fromHalf(part.rgb[i]) * factor;
      this.parts++;
      const mean = Uint16Array.from(this.sum, (value) => toHalf(value / this.parts));
      this.frame = { ...shown.frame, rgb: mean };
      this.viewer.take({ ...shown, frame: this.frame });
    } catch (error) {
      if (!abort.signal.aborted) this.failure = /** @type {Error} */ (error).message;
    } finally {
      if (this.adding === abort) this.adding = null;
    }
    this.viewer.changed();
  }

  /** What is said of the lens. */
  line() {
    const obstacle = this.obstacle();
    if (obstacle || this.failure) return obstacle || this.failure;
    const from = this.viewer.source.isLocal ? "; the server renders it" : "";
    return `aperture ${text(this.diameter())} units · ${(this.parts * SAMPLES) / PARTS} of ${SAMPLES} samples${from}`;
  }

  reflect() {
    const { state, scene } = this.viewer;
    const isOn = state.fStop > 0 || state.aperture > 0;
    byId("aperture-row").hidden = Boolean(scene?.training);
    byId("focus-row").hidden = byId("aperture-text").hidden = !isOn;
    for (const [id, value] of /** @type {const} */ ([["f-stop", state.fStop], ["aperture", state.aperture], ["focus", state.focus]])) {
      if (document.activeElement !== byId(id)) byId(id).value = value > 0 ? String(value) : "";
    }
    byId("focus-tool").setAttribute("aria-pressed", String(this.isPicking));
    byId("aperture-text").textContent = isOn ? this.line() : "";
  }
}
