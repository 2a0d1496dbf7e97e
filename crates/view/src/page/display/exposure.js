/** Exposure: slider, automatic, and the histogram of luminance. */

import { byId } from "../dom/elements.js";
import { histogram, MIDDLE_GREY, signed, suitableExposure, text } from "../picture/pixels.js";
import { luminanceFactor, unitName } from "../picture/units.js";

/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Frame} Frame */
/** @typedef {import("../scene/stream.js").Shown} Shown */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** Stops of the histogram, around middle grey at the exposure in force. */
const HISTOGRAM = { low: -12, high: 12, bins: 96 };
/** Least time between histograms while moving, ms. */
const HISTOGRAM_MS = 250;
/** Largest exposure either way, stops. */
const LIMIT = 16;

/** @implements {Part} */
export class Exposure {
  countedAt = 0;

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    byId("exposure").addEventListener("input", () => viewer.set({ exposure: byId("exposure").valueAsNumber, autoExposure: false }));
    byId("auto-exposure").addEventListener("change", () => viewer.set({ autoExposure: byId("auto-exposure").checked }));
    byId("exposure-once").addEventListener("click", () => this.fit());
    byId("exposure-reset").addEventListener("click", () => viewer.set({ exposure: 0, autoExposure: false }));
  }

  /** Chooses an exposure that suits the picture. @param {boolean} [quietly] */
  fit(quietly = false) {
    const { scene, shown, state } = this.viewer;
    if (!scene || !shown) return;
    const stops = suitableExposure(shown.frame, scene.luminance_weights, scene.radiance_scale);
    if (stops === null) return;
    const exposure = Math.min(LIMIT, Math.max(-LIMIT, Math.round(stops * 20) / 20));
    if (!quietly) this.viewer.set({ exposure, autoExposure: false });
    else if (exposure !== state.exposure) {
      state.exposure = exposure;
      this.viewer.needsDraw = this.viewer.needsReflect = true;
    }
  }

  reflect() {
    const { state, shown } = this.viewer;
    if (state.autoExposure) this.fit(true);
    byId("exposure").value = String(state.exposure);
    byId("exposure-text").textContent = `${signed(state.exposure, 1)} EV`;
    byId("auto-exposure").checked = state.autoExposure;
    if (shown) this.drawHistogram(shown.frame);
  }

  /** @param {Shown} shown */
  taken(shown) {
    if (this.viewer.state.autoExposure) this.fit(true);
    const now = performance.now();
    if (!shown.full && now - this.countedAt < HISTOGRAM_MS) return;
    this.countedAt = now;
    this.drawHistogram(shown.frame);
  }

  /** @param {Frame} frame */
  drawHistogram(frame) {
    const { state, scene } = this.viewer;
    if (!scene || document.body.classList.contains("bare")) return;
    const canvas = /** @type {HTMLCanvasElement} */ (document.getElementById("histogram"));
    const unit = (MIDDLE_GREY * scene.radiance_scale) / 2 ** state.exposure;
    const counts = histogram(frame, scene.luminance_weights, { unit, ...HISTOGRAM });
    const dots = devicePixelRatio;
    const [width, height] = [canvas.clientWidth || 248, 64];
    if (canvas.width !== Math.round(width * dots)) [canvas.width, canvas.height] = [Math.round(width * dots), height * dots];
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    context.setTransform(dots, 0, 0, dots, 0, 0);
    context.clearRect(0, 0, width, height);
    const x = (/** @type {number} */ stops) => ((stops - HISTOGRAM.low) / (HISTOGRAM.high - HISTOGRAM.low)) * width;
    // White is where the curve "none" clips: log2(1 / 0.18) stops.
    context.fillStyle = "#242424";
    context.fillRect(x(-Math.log2(MIDDLE_GREY)), 0, width, height);
    const peak = Math.max(1, ...counts.map(Math.sqrt));
    context.fillStyle = "#b4b4b4";
    counts.forEach((count, i) => {
      const tall = (Math.sqrt(count) / peak) * (height - 4);
      context.fillRect((i / counts.length) * width, height - tall, width / counts.length - 0.5, tall);
    });
    const mark = (/** @type {number} */ stops, /** @type {string} */ color) => {
      context.fillStyle = color;
      context.fillRect(x(stops), 0, 1, height);
    };
    mark(0, "#777");
    const factor = luminanceFactor(this.viewer);
    const isAbsolute = state.scale === "luminance";
    const stopsAt = (/** @type {number} */ value) => Math.log2(value / factor / unit);
    const zebra = isAbsolute ? [state.zebraBelow, state.zebraAbove].filter((value) => value > 0).map(stopsAt) : [state.zebraLow, state.zebraHigh];
    if (state.zebra) zebra.forEach((stops) => mark(stops, "#fff"));
    const label = (/** @type {number} */ stops) => (isAbsolute ? text(unit * factor * 2 ** stops) : signed(stops, 0));
    byId("histogram-low").textContent = label(HISTOGRAM.low);
    byId("histogram-high").textContent = label(HISTOGRAM.high);
    byId("histogram-middle").textContent = isAbsolute ? `${text(unit * factor)} ${unitName(this.viewer)}` : "middle grey";
  }
}
