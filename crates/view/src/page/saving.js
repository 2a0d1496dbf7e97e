/** Saves what is seen: OpenEXR, PNG, the address of the page. */

import { byId } from "./panel.js";
import { toHash } from "./state.js";

/** @typedef {import("./viewer.js").Viewer} Viewer */

/** Has the browser save a file. @param {string} url @param {string} name */
export function download(url, name) {
  const link = Object.assign(document.createElement("a"), { href: url, download: name });
  link.click();
}

export class Saving {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    byId("save-exr").addEventListener("click", () => this.exr());
    byId("save-png").addEventListener("click", () => this.png());
    byId("copy-link").addEventListener("click", () => this.link());
  }

  exr() {
    const { viewer } = this;
    const { width, height, edit } = viewer.want();
    const url = viewer.source.exr(viewer.lens(width, height), { edit, radiance: true, layers: true });
    if (url) download(url, "view.exr");
  }

  png() {
    const { viewer } = this;
    viewer.display.draw(viewer.comparison?.drawn() ?? viewer.state, false);
    viewer.canvas.toBlob((blob) => blob && download(URL.createObjectURL(blob), "view.png"), "image/png");
  }

  async link() {
    history.replaceState(null, "", location.pathname + toHash(this.viewer.state, this.viewer.controls.size));
    await navigator.clipboard?.writeText(location.href).catch(() => undefined);
  }
}
