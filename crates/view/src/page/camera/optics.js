/** The part that shows and chooses the projection of the picture. */

import { byId } from "../dom/elements.js";

/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../math/projections.js").Kind} Kind */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** @implements {Part} */
export class Optics {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    byId("projection").addEventListener("change", () => this.choose({ projection: /** @type {Kind} */ (byId("projection").value) }));
    byId("circle").addEventListener("input", () => this.choose({ circle: byId("circle").valueAsNumber }));
  }

  /** @param {Partial<import("../math/lens.js").Choice>} choice */
  choose(choice) {
    this.viewer.set(choice);
    this.viewer.controls.left();
  }

  reflect() {
    const { state, source } = this.viewer;
    byId("projection-row").hidden = !source.hasLenses;
    byId("projection").value = state.projection;
    byId("circle-row").hidden = state.projection !== "fisheye";
    byId("fov-row").hidden = state.projection !== "pinhole";
    byId("circle").value = String(Math.round(state.circle));
    byId("circle-text").textContent = `${state.circle.toFixed(0)}°`;
  }
}
