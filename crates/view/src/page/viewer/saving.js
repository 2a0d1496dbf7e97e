/** Saves what is seen: OpenEXR, PNG, HDR PNG, in the size of the window, a multiple, or any other; the address of the page. */

import { Display } from "../display/display.js";
import { byId } from "../dom/elements.js";
import { download } from "../dom/files.js";
import { encodeExr } from "../picture/exr.js";
import { Embedded } from "../scene/embedded.js";
import { address } from "../scene/server.js";
import { sampled } from "../scene/variant.js";
import { toHash } from "./state.js";

/** @typedef {import("./viewer.js").Viewer} Viewer */

/** Pixels of a still, as the server limits pictures. */
const MAX_PIXELS = 2 ** 25;

/** Samples of the lens of a still. */
const STILL_SAMPLES = 128;

export class Saving {
  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    byId("save-exr").addEventListener("click", () => void this.exr());
    byId("save-png").addEventListener("click", () => void this.png());
    byId("save-hdr").addEventListener("click", () => this.hdr());
    byId("copy-link").addEventListener("click", () => this.link());
    byId("still-size").addEventListener("change", () => {
      const { width, height } = this.size();
      [byId("still-width").value, byId("still-height").value] = [String(width), String(height)];
      byId("still-custom").hidden = byId("still-size").value !== "custom";
    });
  }

  /** Size of a still. */
  size() {
    const { width, height } = this.viewer.want();
    const choice = byId("still-size").value;
    if (choice !== "custom") return { width: width * Number(choice), height: height * Number(choice) };
    const [w, h] = ["still-width", "still-height"].map((id) => Math.round(byId(id).valueAsNumber));
    return { width: w > 0 ? w : width, height: h > 0 ? h : height };
  }

  /** The lens and the edits of a still; null where it is too large. */
  still() {
    const { viewer } = this;
    const { width, height } = this.size();
    const isFine = width * height <= MAX_PIXELS;
    byId("save-text").textContent = isFine ? "" : `${width} x ${height} pixels, expected at most ${MAX_PIXELS.toLocaleString("en")} in all`;
    return isFine ? { lens: viewer.lens(width, height), edit: viewer.want().edit, variant: sampled(viewer.want().variant, { samples: STILL_SAMPLES, part: [0, 1] }) } : null;
  }

  async exr() {
    const still = this.still();
    if (!still) return;
    const { source } = this.viewer;
    const picture = { edit: still.edit, radiance: true, layers: true, variant: still.variant };
    const url = source.exr(still.lens, picture);
    if (url) return download(url, "view.exr");
    if (!(source instanceof Embedded)) return;
    try {
      const frame = await source.frame(still.lens, { ...picture, isStored: true });
      if (frame) download(URL.createObjectURL(await encodeExr(frame, source.facts.chromaticities, source.facts.color_interop_id)), "view.exr");
    } catch (error) {
      byId("save-text").textContent = /** @type {Error} */ (error).message;
    }
  }

  /** The exposure's white is reference white, 203 cd/m2. */
  hdr() {
    const still = this.still();
    if (!still) return;
    const more = `&hdr=pq&exposure=${this.viewer.state.exposure}`;
    download(address(still.lens, { edit: still.edit, radiance: true, layers: false, variant: still.variant }, more, "/api/still.png"), "view-pq.png");
  }

  /** What the screen shows, with all pixels: a picture of another size is drawn beside the screen. */
  async png() {
    const still = this.still();
    if (!still) return;
    try {
      const canvas = await this.drawn(still);
      canvas.toBlob((blob) => blob && download(URL.createObjectURL(blob), "view.png"), "image/png");
    } catch (error) {
      byId("save-text").textContent = /** @type {Error} */ (error).message;
    }
  }

  /** @param {{ lens: import("../math/lens.js").Lens, edit: string, variant: import("../scene/variant.js").Variant }} still */
  async drawn({ lens, edit, variant }) {
    const { viewer } = this;
    const { shown, canvas } = viewer;
    if (shown?.full && byId("still-size").value === "1") {
      viewer.display.draw(viewer.comparison?.drawn() ?? viewer.state, false);
      return canvas;
    }
    if (viewer.state.compare !== "off") throw new Error("beside the ground truth a still has the size of the window; choose 1×");
    const beside = Object.assign(document.createElement("canvas"), { width: lens.width, height: lens.height });
    const display = new Display(beside);
    const frame = await viewer.source.frame(lens, { edit, radiance: true, layers: true, variant });
    if (!frame) throw new Error("the picture was given up; try again");
    [display.scene, display.lens] = [viewer.scene, lens];
    display.show(frame, true);
    display.draw(viewer.state, false);
    return beside;
  }

  async link() {
    history.replaceState(null, "", location.pathname + toHash(this.viewer.state, this.viewer.controls.size));
    await navigator.clipboard?.writeText(location.href).catch(() => undefined);
  }
}
