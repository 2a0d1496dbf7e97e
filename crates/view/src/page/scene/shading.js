/** How splats are drawn, clip planes, and the direction that is up. */

import { byId, press, segmented } from "../dom/elements.js";
import { SPLATS } from "./variant.js";

/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../viewer/state.js").State} State */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** Directions that are offered, by their name. @type {readonly [string, string][]} */
const UPS = [["+X", "1,0,0"], ["−X", "-1,0,0"], ["+Y", "0,1,0"], ["−Y", "0,-1,0"], ["+Z", "0,0,1"], ["−Z", "0,0,-1"]];

/** @implements {Part} */
export class Shading {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    segmented(byId("splats"), SPLATS, (name) => viewer.set({ splats: /** @type {State["splats"]} */ (name), splatSize: name === "centres" ? Math.max(1, viewer.state.splatSize) : viewer.state.splatSize }));
    const number = (/** @type {string} */ id, /** @type {(value: number) => Partial<State>} */ change) =>
      byId(id).addEventListener("input", () => viewer.set(change(Number.isFinite(byId(id).valueAsNumber) ? byId(id).valueAsNumber : 0)));
    number("splat-size", (splatSize) => ({ splatSize }));
    number("splat-opacity", (splatOpacity) => ({ splatOpacity }));
    number("near", (near) => ({ near: Math.max(0, near) }));
    number("far", (far) => ({ far: Math.max(0, far) }));
    byId("clip-clear").addEventListener("click", () => viewer.set({ near: 0, far: 0 }));
    const up = byId("up");
    for (const [name, value] of UPS) up.append(Object.assign(document.createElement("option"), { textContent: name, value }));
    up.addEventListener("change", () => this.setUp(up.value === "view" ? viewer.state.axes.up.map((v) => Number(v.toFixed(5))).join(",") : up.value));
  }

  /** @param {string} upAxis */
  setUp(upAxis) {
    const { viewer } = this;
    viewer.set({ upAxis });
    viewer.controls.up = viewer.up();
    viewer.controls.level();
  }

  sceneSet() {
    // A scene that is being trained has bodies, and no clip planes.
    const isTrained = Boolean(this.viewer.scene?.training);
    byId("clip-row").hidden = isTrained;
    if (isTrained) Object.assign(this.viewer.state, { near: 0, far: 0 });
  }

  reflect() {
    const { state, controls } = this.viewer;
    controls.up = this.viewer.up();
    press("splats", state.splats);
    byId("splat-row").hidden = state.splats === "blended";
    const size = byId("splat-size");
    size.min = state.splats === "centres" ? "0.5" : "0.1";
    size.title = state.splats === "centres" ? "Radius of the dots, pixels" : "Size of the ellipsoids, standard deviations";
    if (document.activeElement !== size) size.value = String(state.splatSize);
    byId("splat-size-text").textContent = state.splats === "centres" ? `${state.splatSize.toFixed(1)} px` : `${state.splatSize.toFixed(1)} σ`;
    if (document.activeElement !== byId("splat-opacity")) byId("splat-opacity").value = String(state.splatOpacity);
    for (const [id, value] of /** @type {const} */ ([["near", state.near], ["far", state.far]])) {
      if (document.activeElement !== byId(id)) byId(id).value = value > 0 ? String(value) : "";
    }
    const isWrong = state.far > 0 && state.far <= state.near;
    byId("far").setCustomValidity(isWrong ? "expected a depth beyond the near plane" : "");
    byId("clip-text").hidden = !isWrong;
    const up = byId("up");
    const isOffered = state.upAxis === "" || UPS.some(([, value]) => value === state.upAxis);
    up.value = isOffered ? state.upAxis : "custom";
    /** @type {HTMLElement} */ (up.querySelector("[value=custom]")).hidden = isOffered;
  }
}
