/** The display of an OpenColorIO configuration: a curve that the server gives as a table (`luxel view --ocio`). */

import { byId } from "../dom/elements.js";
import { checked } from "../scene/server.js";

/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Scene} Scene */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** @implements {Part} */
export class OcioCurve {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    this.option = /** @type {HTMLOptionElement} */ (byId("curve").querySelector("[value=ocio]"));
  }

  /** @param {Scene} scene */
  sceneSet({ display }) {
    this.option.hidden = this.option.disabled = !display;
    if (!display) return;
    this.option.textContent = `${display.display}, ${display.view}`;
    void this.load(display);
  }

  /** @param {import("../scene/scene.js").DisplayTable} display */
  async load(display) {
    try {
      display.values = new Uint16Array(await (await checked(await fetch("/api/display"))).arrayBuffer());
      this.viewer.messages.set("display", "");
    } catch (error) {
      this.viewer.messages.set("display", `the display of OpenColorIO did not come: ${/** @type {Error} */ (error).message}`);
    }
    this.viewer.changed();
  }
}
