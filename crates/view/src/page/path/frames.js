/** Has the program render the frames of the path, and shows how far it is. */

import { byId } from "../dom/elements.js";
import { checked } from "../scene/server.js";

/** @typedef {import("./path.js").PathPanel} PathPanel */
/** @typedef {{ state: "idle" | "running" | "finished" | "cancelled" | "failed", name: string, folder: string, done: number, total: number, seconds: number, error: string | null }} Status */

/** Time between looks at the progress, ms. */
const LOOK_MS = 250;

export class PathRender {
  /** @type {Status | null} */ status = null;
  isFollowing = false;

  /** @param {PathPanel} panel */
  constructor(panel) {
    this.panel = panel;
    byId("path-render").addEventListener("click", () => void this.start());
    byId("path-cancel").addEventListener("click", () => void fetch("/api/path/cancel", { method: "POST" }));
  }

  async start() {
    const { path, viewer } = this.panel;
    const samples = Number(/** @type {HTMLSelectElement} */ (/** @type {unknown} */ (byId("path-samples"))).value) || null;
    const wish = { path, name: byId("path-name").value.trim(), edit: viewer.state.edit, samples, exr_type: byId("path-type").value };
    try {
      await checked(await fetch("/api/path/render", { method: "POST", body: JSON.stringify(wish) }));
      void this.follow();
    } catch (error) {
      this.say(/** @type {Error} */ (error).message);
    }
  }

  /** Shows the progress of a render until it ends. */
  async follow() {
    if (this.isFollowing) return;
    this.isFollowing = true;
    try {
      for (;;) {
        /** @type {Status} */
        const status = await (await checked(await fetch("/api/path/render"))).json();
        this.show(status);
        if (status.state !== "running") break;
        await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
      }
    } catch {
      this.say("no connection; the frames that are written stay");
    }
    this.isFollowing = false;
  }

  /** @param {Status} status */
  show(status) {
    this.status = status;
    const isRunning = status.state === "running";
    byId("path-progress-row").hidden = !isRunning;
    byId("path-render").hidden = isRunning;
    const bar = /** @type {HTMLProgressElement} */ (/** @type {unknown} */ (byId("path-progress")));
    [bar.max, bar.value] = [Math.max(1, status.total), status.done];
    const frames = `${status.done} of ${status.total} frames`;
    if (isRunning) {
      const left = status.done ? (status.seconds / status.done) * (status.total - status.done) : NaN;
      this.say(`${frames}${Number.isFinite(left) ? `, ${left.toFixed(0)} s left` : ""}`);
    } else if (status.state === "finished") {
      this.say(`${status.total} frames in ${status.folder}`);
      // The next render gets a name of its own.
      const name = byId("path-name").value.trim();
      if (name === status.name) byId("path-name").value = name.replace(/-?(\d*)$/, (_, digits) => `-${Number(digits || 1) + 1}`);
    } else if (status.state === "cancelled") this.say(`cancelled: ${frames} in ${status.folder}`);
    else if (status.state === "failed") this.say(`failed after ${frames}: ${status.error}`);
  }

  /** @param {string} text */
  say(text) {
    byId("path-render-text").textContent = text;
  }
}
