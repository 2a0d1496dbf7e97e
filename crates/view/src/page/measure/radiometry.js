/** The values of false colour, zebra and histogram: stops around middle grey, or luminance; and the unit of luminance. */

import { byId } from "../dom/elements.js";
import { MIDDLE_GREY } from "../picture/pixels.js";
import { luminanceFactor, unitName } from "../picture/units.js";

/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../viewer/state.js").State} State */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** @implements {Part} */
export class Radiometry {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    byId("scale").addEventListener("change", () => this.choose(/** @type {State["scale"]} */ (byId("scale").value)));
    for (const side of /** @type {const} */ (["low", "high"])) byId(`zebra-${side}`).addEventListener("input", () => this.setZebra(side));
    for (const [id, by] of /** @type {const} */ ([["darker", -0.5], ["brighter", 0.5]])) byId(id).addEventListener("click", () => viewer.set({ exposure: viewer.state.exposure + by, autoExposure: false }));
    byId("cdm2").addEventListener("input", () => {
      const value = byId("cdm2").valueAsNumber;
      viewer.set({ cdm2: value > 0 ? value : 0 });
    });
  }

  /** Chooses what values are, and keeps the stripes where they are. @param {State["scale"]} scale */
  choose(scale) {
    const { viewer } = this;
    const { state, scene } = viewer;
    const grey = (MIDDLE_GREY * (scene?.radiance_scale ?? 1) * luminanceFactor(viewer)) / 2 ** state.exposure;
    const short = (/** @type {number} */ v) => Number(v.toPrecision(3));
    if (scale === "luminance" && state.zebraBelow === 0 && state.zebraAbove === 0) {
      viewer.set({ scale, zebraBelow: short(grey * 2 ** state.zebraLow), zebraAbove: short(grey * 2 ** state.zebraHigh) });
    } else viewer.set({ scale });
  }

  /** @param {"low" | "high"} side */
  setZebra(side) {
    const { viewer } = this;
    const value = byId(`zebra-${side}`).valueAsNumber;
    if (!Number.isFinite(value)) return;
    if (viewer.state.scale === "luminance") viewer.set(side === "low" ? { zebraBelow: Math.max(0, value) } : { zebraAbove: Math.max(0, value) });
    else viewer.set(side === "low" ? { zebraLow: value } : { zebraHigh: value });
  }

  reflect() {
    const { viewer } = this;
    const { state, scene } = viewer;
    byId("scale").value = state.scale;
    const unit = unitName(viewer);
    const isAbsolute = state.scale === "luminance";
    for (const option of byId("scale").querySelectorAll("option")) if (option.value === "luminance") option.textContent = `luminance, ${unit}`;
    for (const [id, value, side] of /** @type {const} */ ([
      ["zebra-low", isAbsolute ? state.zebraBelow : state.zebraLow, "Below"],
      ["zebra-high", isAbsolute ? state.zebraAbove : state.zebraHigh, "Above"],
    ])) {
      const field = byId(id);
      field.step = isAbsolute ? "any" : "0.5";
      field.title = isAbsolute ? `${side} this luminance, ${unit}; 0 for none` : `${side}: stops around middle grey`;
      field.setAttribute("aria-label", isAbsolute ? `Zebra ${side.toLowerCase()}, ${unit}` : `Zebra ${side.toLowerCase()}, stops`);
      if (document.activeElement !== field) field.value = String(value);
    }
    const cdm2 = byId("cdm2");
    if (document.activeElement !== cdm2) cdm2.value = state.cdm2 > 0 ? String(state.cdm2) : scene?.cd_m2_per_unit ? String(scene.cd_m2_per_unit) : "";
  }
}
