/** The scene of a page that was saved with it: no server, the page renders by itself. */

import { toLocal } from "../math/lens.js";
import { asPinhole } from "../math/projections.js";
import { LocalPictures } from "./local.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("./scene.js").Frame} Frame */
/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {import("./source.js").Picture} Picture */
/** @typedef {import("./source.js").Source} Source */

/** Whether this page holds its scene. */
export const isAlone = () => document.getElementById("luxel-scene") !== null;

/** Text of an element of the page. @param {string} id */
const textOf = (id) => document.getElementById(id)?.textContent ?? "";

/** @returns {Promise<ArrayBuffer>} */
async function splats() {
  const packed = Uint8Array.from(atob(textOf("luxel-splats")), (character) => character.charCodeAt(0));
  return new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

/** @implements {Source} */
export class Embedded {
  isLocal = true;
  hasLenses = false;
  layersApart = false;
  /** @type {Scene & { thumbnails: { [view: string]: string }, poster: string, chromaticities: [number, number][], color_interop_id: string }} */ facts = JSON.parse(textOf("luxel-scene"));
  /** @type {Promise<LocalPictures> | null} */ pictures = null;
  /** Why there is no picture; "" once there is one. */ failure = "";
  /** Called when that changes. */ changed = () => {};

  constructor() {
    document.body.classList.add("alone");
  }

  async scene() {
    return { ...this.facts, cameras: this.facts.cameras.map(asPinhole) };
  }

  /** @param {Lens} lens @param {Picture} picture @returns {Promise<Frame | null>} */
  async frame(lens, picture) {
    this.pictures ??= LocalPictures.open({ scene: splats, changes: splats }, () => (this.pictures = null));
    try {
      const frame = await (await this.pictures).frame(toLocal(lens, this.facts.world_from_local), { ...picture, edit: "" });
      this.say("");
      return frame;
    } catch (error) {
      // Tried again, by the next picture, with a new device.
      this.pictures = null;
      const { message } = /** @type {Error} */ (error);
      this.say(message);
      const seen = this.facts.cameras.length ? "Pictures that were made with this file are shown instead; the cameras below have their own." : "A picture that was made with this file is shown instead.";
      throw new Error(`No picture: ${message}. ${seen}`);
    }
  }

  /** @param {string} failure */
  say(failure) {
    if (failure === this.failure) return;
    this.failure = failure;
    this.changed();
  }

  /** @returns {Promise<Frame>} */
  async truth() {
    throw new Error("this page has no ground truth");
  }

  /** @param {string} view */
  thumbnail(view) {
    return this.facts.thumbnails[view] ?? "";
  }

  listen() {
    // Nothing changes.
  }

  exr() {
    return null;
  }
}
