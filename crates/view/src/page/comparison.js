/** Comparison with the ground truth of a camera: wipe, difference, flicker. */

import { byId, press, segmented } from "./panel.js";
import { COMPARES, State } from "./state.js";

/** @typedef {import("./lens.js").Lens} Lens */
/** @typedef {import("./overlay.js").Overlay} Overlay */
/** @typedef {import("./part.js").Grip} Grip */
/** @typedef {import("./part.js").Part} Part */
/** @typedef {import("./viewer.js").Viewer} Viewer */

/** Time for which each picture of a flicker is shown, ms; below three flashes a second. */
const FLICKER_MS = 600;
/** Distance from which the edge of the wipe is taken hold of, pixels of the screen. */
const GRIP_PX = 14;

/** @implements {Part} */
export class Comparison {
  /** Camera whose ground truth is there, or on its way. */ truthOf = "";

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    segmented(byId("compare"), COMPARES, (name) => viewer.set({ compare: /** @type {State["compare"]} */ (name) }));
  }

  /** Whether a ground truth is there that is compared with. */
  isOn() {
    const { state, display } = this.viewer;
    return state.compare !== "off" && display.truth !== null && this.truthOf === state.view && state.view !== "";
  }

  /** Whether the picture changes by itself. */
  isFlickering() {
    return this.viewer.state.compare === "flicker" && this.isOn();
  }

  /** What is drawn: without a comparison until the ground truth is there. */
  drawn() {
    return this.isOn() ? this.viewer.state : Object.assign(new State(), this.viewer.state, { compare: "off" });
  }

  /** Whether the flicker shows the ground truth. @param {number} now */
  showsTruth(now) {
    return Math.floor(now / FLICKER_MS) % 2 === 1;
  }

  step() {
    const { viewer } = this;
    const view = viewer.viewCamera();
    if (viewer.state.compare === "off" || !view?.has_ground_truth || this.truthOf === view.name) return;
    this.truthOf = view.name;
    viewer.display.compareWith(null);
    viewer.source
      .truth(view.name)
      .then((frame) => {
        if (this.truthOf === view.name) viewer.display.compareWith(frame);
        viewer.changed();
      })
      .catch((error) => viewer.complain(error.message));
  }

  reflect() {
    const { scene, state } = this.viewer;
    press("compare", state.compare);
    const view = this.viewer.viewCamera();
    const canCompare = Boolean(view?.has_ground_truth);
    for (const button of byId("compare").querySelectorAll("button")) button.disabled = !canCompare && button.dataset.value !== "off";
    byId("compare-section").hidden = !scene?.cameras.some((camera) => camera.has_ground_truth);
    byId("compare-text").textContent = canCompare ? `${view?.name} (${view?.split})` : "Choose a camera below to compare with its image.";
  }

  /** @param {Overlay} overlay @param {Lens} lens */
  draw(overlay, lens) {
    const { state, box } = this.viewer;
    const isOn = this.isOn();
    const isWipe = isOn && state.compare === "wipe";
    if (isWipe) overlay.wipe(state.wipe * lens.width, lens.height);
    const labels = byId("wipe-labels");
    labels.hidden = !isWipe && !this.isFlickering();
    const showsTruth = this.showsTruth(performance.now());
    const [truth, render] = /** @type {HTMLElement[]} */ ([...labels.children]);
    const edge = box.left + state.wipe * lens.width;
    Object.assign(truth.style, { right: isWipe ? `calc(100% - ${edge - 8}px)` : "", left: isWipe ? "" : "10px", display: isWipe || showsTruth ? "" : "none" });
    Object.assign(render.style, { left: isWipe ? `${edge + 8}px` : "10px", display: isWipe || !showsTruth ? "" : "none" });
  }

  /** Takes hold of the edge of the wipe. @param {number} x @returns {Grip | null} */
  grab(x) {
    const { state, box } = this.viewer;
    if (!this.isOn() || state.compare !== "wipe" || Math.abs(x - state.wipe * box.width) > GRIP_PX) return null;
    return { move: (to) => this.viewer.set({ wipe: Math.min(1, Math.max(0, to / this.viewer.box.width)) }) };
  }
}
