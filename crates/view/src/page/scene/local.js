/** Pictures that the page renders by itself, of a scene that it downloads once. */

import { openGpu } from "../gpu/device.js";
import { GpuRenderer } from "../gpu/renderer.js";
import { parseChanges, parseSplats } from "../gpu/splats.js";
import { decoded } from "../math/half.js";

/** @typedef {import("../gpu/device.js").Gpu} Gpu */
/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("./source.js").Picture} Picture */
/** @typedef {import("./scene.js").Frame} Frame */
/** Fetches the splats of the scene; and what edits change of them. @typedef {{ scene: () => Promise<ArrayBuffer>, changes: (edit: string) => Promise<ArrayBuffer> }} Download */

export class LocalPictures {
  /** @type {string | null} */ loaded = null;
  /** @type {Promise<void> | null} */ loading = null;
  /** Edits of the newest picture that was asked for. */ wanted = "";
  /** Size of the scene that was downloaded. */ bytes = 0;
  /** Size of the changes that were downloaded last. */ changeBytes = 0;
  /** Whether the device is gone. */ isLost = false;

  /** @param {Gpu} gpu @param {Download} download @param {(reason: string) => void} lost called when the device is gone */
  constructor(gpu, download, lost) {
    this.gpu = gpu;
    this.download = download;
    this.renderer = new GpuRenderer(gpu.device);
    void gpu.device.lost.then(({ message }) => {
      this.isLost = true;
      lost(message || "no reason given");
    });
  }

  /** Opens the GPU. @param {Download} download @param {(reason: string) => void} lost */
  static async open(download, lost) {
    return new LocalPictures(await openGpu(), download, lost);
  }

  /** Loads the scene under these edits; false if others are wanted by now. @param {string} edit */
  async load(edit) {
    this.wanted = edit;
    while (this.loaded !== edit) {
      if (this.loading) await this.loading.catch(() => undefined);
      else if (this.wanted !== edit) return false;
      else {
        const load = async () => {
          const changes = edit ? await this.download.changes(edit) : null;
          if (!this.renderer.splats) {
            const bytes = await this.download.scene();
            this.bytes = bytes.byteLength;
            await this.renderer.load(parseSplats(bytes));
          }
          const { splats } = this.renderer;
          this.renderer.change(changes && splats && parseChanges(changes, splats.head.splats));
          this.changeBytes = changes?.byteLength ?? 0;
          this.loaded = edit;
        };
        this.loading = load();
        try {
          await this.loading;
        } finally {
          this.loading = null;
        }
      }
    }
    return true;
  }

  /** A picture; null if one under other edits was asked for meanwhile. @param {Lens} lens @param {Picture} picture @returns {Promise<Frame | null>} */
  async frame(lens, { edit, layers, isStored }) {
    if (!(await this.load(edit))) return null;
    const frame = await this.renderer.render(lens, layers);
    if (isStored || !this.renderer.splats?.head.isDisplay) return frame;
    return { ...frame, rgb: decoded(frame.rgb, frame.head.scale) };
  }
}
