/** The choice between pictures of the server and pictures of the page itself. */

import { openGpu } from "../gpu/device.js";
import { toLocal } from "../math/lens.js";
import { LocalPictures } from "./local.js";
import { checked } from "./server.js";
import { isPlain } from "./variant.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("./source.js").Picture} Picture */
/** @typedef {import("./source.js").Source} Source */
/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {"automatic" | "server" | "local"} Rendering */

/** @type {readonly Rendering[]} */
export const RENDERINGS = ["automatic", "server", "local"];
/** Largest scene that is downloaded without being asked for. */
const AUTOMATIC_BYTES = 256 * 2 ** 20;

/** Size of a download for people. @param {number} bytes */
export const megabytes = (bytes) => `${(bytes / 1e6).toPrecision(bytes < 1e6 ? 1 : 3)} MB`;

/** @implements {Source} */
export class Sources {
  hasLenses = true;
  /** @type {Rendering} */ rendering = "automatic";
  /** @type {LocalPictures | null} */ local = null;
  /** Whether the scene is on its way to the page. */ isLoading = false;
  /** Why the page does not render by itself; "" where it does. */ reason = "";
  /** @type {Scene | null} */ facts = null;
  /** Called when pictures come from elsewhere, with a message if something failed. @type {(message: string) => void} */ changed = () => undefined;

  /** @param {Source} server */
  constructor(server) {
    this.server = server;
  }

  get isLocal() {
    return this.local !== null && this.local.loaded !== null && this.rendering !== "server";
  }

  get layersApart() {
    // A scene that is being trained is another one by the time at which they would be asked for.
    return !this.isLocal && this.server.layersApart && !this.facts?.training;
  }

  async scene() {
    const facts = await this.server.scene();
    // A server that was started again may have another scene.
    if (this.local && JSON.stringify(facts) !== JSON.stringify(this.facts)) this.local = null;
    this.facts = facts;
    void this.choose(this.rendering);
    return this.facts;
  }

  /** Changes where pictures come from, once that is possible. @param {Rendering} rendering */
  async choose(rendering) {
    this.rendering = rendering;
    if (rendering === "server" || !this.facts || this.isLoading || this.local) return this.changed("");
    this.isLoading = true;
    try {
      this.reason = await this.obstacle(this.facts);
      if (!this.reason) {
        this.changed("");
        const local = await LocalPictures.open(this.downloads(), (reason) => this.lose(`the browser's GPU was lost (${reason})`));
        await local.load("");
        this.local = local;
      }
    } catch (error) {
      this.reason = /** @type {Error} */ (error).message;
    } finally {
      this.isLoading = false;
    }
    this.changed(rendering === "local" ? this.reason : "");
  }

  /** Why the scene stays on the server; "" if nothing speaks against the page. @param {Scene} facts */
  async obstacle({ training, download_bytes: bytes, lights }) {
    if (lights > 1) return "the scene is a mix of lights, which the server renders";
    if (training || !bytes) return "the scene is being trained";
    const { isSoftware } = await openGpu();
    if (this.rendering !== "automatic") return "";
    if (isSoftware) return "the browser has no GPU, a processor would play it";
    return bytes > AUTOMATIC_BYTES ? `the scene is large (${megabytes(bytes)})` : "";
  }

  /** @returns {import("./local.js").Download} */
  downloads() {
    const bytes = async (/** @type {string} */ address) => (await checked(await fetch(address))).arrayBuffer();
    return { scene: () => bytes("/api/splats"), changes: (edit) => bytes(`/api/splats/changes?edit=${encodeURIComponent(edit)}`) };
  }

  /** Goes back to the server. @param {string} reason */
  lose(reason) {
    if (!this.local) return;
    this.local = null;
    this.reason = reason;
    this.changed(`${reason}; the server renders`);
  }

  /** Whether the page itself makes this picture: one of a pinhole, of the plain scene. @param {Lens} lens @param {Picture} picture */
  makes({ projection }, { variant }) {
    return this.isLocal && this.facts !== null && projection.kind === "pinhole" && (!variant || isPlain(variant));
  }

  /** @param {Lens} lens @param {Picture} picture @param {AbortSignal} [signal] */
  async frame(lens, picture, signal) {
    const { local } = this;
    if (!local || !this.facts || !this.makes(lens, picture)) return this.server.frame(lens, picture, signal);
    try {
      const frame = await local.frame(toLocal(lens, this.facts.world_from_local), picture);
      return frame && this.facts ? { ...frame, head: { ...frame.head, version: this.facts.version } } : frame;
    } catch (error) {
      if (this.local === local && !local.renderer.fault && !local.isLost) throw error;
      this.lose(local.renderer.fault || "the browser's GPU failed");
      return this.server.frame(lens, picture, signal);
    }
  }

  /** @param {string} view */
  truth(view) {
    return this.server.truth(view);
  }

  /** @param {string} view */
  thumbnail(view) {
    return this.server.thumbnail(view);
  }

  /** @param {import("./connection.js").Listener} on */
  listen(on) {
    this.server.listen(on);
  }

  /** @param {Lens} lens @param {Picture} picture */
  exr(lens, picture) {
    return this.server.exr(lens, picture);
  }
}
