/** The controls: what they set, and how they show what is set. */

import { showLegend } from "../display/legend.js";
import { byId, press, segmented } from "../dom/elements.js";
import { fillHelp } from "./help.js";
import { MODES } from "./state.js";

/** @typedef {import("./viewer.js").Viewer} Viewer */
/** @typedef {import("./part.js").Part} Part */
/** @typedef {import("./state.js").State} State */

/** Connects the controls. @param {Viewer} viewer */
function connect(viewer) {
  const number = (/** @type {string} */ id, /** @type {keyof State} */ field) =>
    byId(id).addEventListener("input", () => Number.isFinite(byId(id).valueAsNumber) && viewer.set({ [field]: byId(id).valueAsNumber }));
  const choice = (/** @type {string} */ id, /** @type {keyof State} */ field) => byId(id).addEventListener("change", () => viewer.set({ [field]: byId(id).value }));
  const flag = (/** @type {string} */ id, /** @type {keyof State} */ field) => byId(id).addEventListener("change", () => viewer.set({ [field]: byId(id).checked }));
  const click = (/** @type {string} */ id, /** @type {() => void} */ act) => byId(id).addEventListener("click", act);
  number("fov", "fov");
  byId("fov").addEventListener("input", () => viewer.controls.left());
  choice("layer", "layer");
  choice("curve", "curve");
  flag("zebra", "zebra");
  click("home", () => viewer.home());
  click("level", () => viewer.controls.level());
  click("show-cameras", () => viewer.set({ showCameras: !viewer.state.showCameras }));
  click("toggle-panel", () => viewer.togglePanel());
  click("open-help", () => viewer.toggleHelp());
  segmented(byId("mode"), MODES, (name) => viewer.set({ mode: /** @type {State["mode"]} */ (name) }));
  fillHelp(byId("help-body"));
}

/** What a curve does to colours that are a display's. @param {State} state */
const curveText = ({ curve, exposure }) =>
  curve === "none" && exposure === 0 ? "Colours of a display (sRGB), shown as they are stored." : "Colours of a display (sRGB), changed by exposure or curve: none at 0 EV shows them as they are stored.";

/** Shows what is set. @param {Viewer} viewer */
function reflect(viewer) {
  const { state } = viewer;
  byId("layer").value = state.layer;
  byId("curve").value = state.curve;
  byId("curve-text").hidden = !viewer.scene?.is_display;
  byId("curve-text").textContent = curveText(state);
  byId("curve").toggleAttribute("disabled", state.layer !== "radiance");
  byId("zebra").checked = state.zebra;
  byId("fov").value = String(Math.round(state.fov));
  byId("fov-text").textContent = `${state.fov.toFixed(0)}°`;
  byId("show-cameras").setAttribute("aria-pressed", String(state.showCameras));
  press("mode", state.mode);
  showLegend(viewer);
}

/** The controls of display, camera and edits. @implements {Part} */
export class ControlPanel {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    connect(viewer);
  }

  reflect() {
    reflect(this.viewer);
  }
}
