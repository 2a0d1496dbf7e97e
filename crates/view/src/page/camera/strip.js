/** The strip of the data set's cameras, with pictures of their ground truth. */

import { byId } from "../dom/elements.js";

/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Scene} Scene */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** @implements {Part} */
export class Strip {
  /** Camera that is shown as chosen. @type {string | null} */ chosen = null;

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
  }

  /** @param {Scene} scene @param {boolean} isAgain */
  sceneSet(scene, isAgain) {
    if (isAgain) return;
    const strip = byId("strip");
    this.chosen = null;
    strip.hidden = scene.cameras.length === 0;
    strip.replaceChildren(
      ...scene.cameras.map((camera) => {
        const button = document.createElement("button");
        button.dataset.view = camera.name;
        button.title = `${camera.name} (${camera.split}): stand at this camera`;
        const name = document.createElement("span");
        name.textContent = `${camera.name.split("/").at(-1)}${camera.split === "test" ? " test" : ""}`;
        const address = this.viewer.source.thumbnail(camera.name);
        if (camera.has_ground_truth || address.startsWith("data:")) {
          const image = new Image();
          image.loading = "lazy";
          image.alt = "";
          // Room for a picture that is not there yet: the strip must not move when it comes.
          [image.width, image.height] = [camera.w, camera.h];
          image.src = address;
          button.append(image);
        }
        button.append(name);
        button.addEventListener("click", () => this.viewer.standAt(camera.name));
        return button;
      }),
    );
  }

  reflect() {
    const { view } = this.viewer.state;
    if (this.chosen === view) return;
    this.chosen = view;
    for (const button of byId("strip").querySelectorAll("button")) {
      const isHere = button.dataset.view === view;
      button.setAttribute("aria-pressed", String(isHere));
      if (isHere) button.scrollIntoView({ block: "nearest", inline: "nearest" });
    }
  }
}
