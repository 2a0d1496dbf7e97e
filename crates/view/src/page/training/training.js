/** The panel of a training: its progress, plots, and buttons that steer it. */

import { fetchCameras, fetchHistory, steer } from "../scene/scene.js";
import { drawPlots } from "./plots.js";

/** @typedef {import("./plots.js").Record} Record */
/** @typedef {import("../scene/scene.js").Status} Status */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Training} Training */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** Least time between two drawings of the plots, ms: training needs the processor. */
const PLOT_MS = 1500;
/** What follows a wish whose effect the page does not show by itself. @type {{ [wish: string]: string }} */
const WISHES = { save: "A checkpoint is written after this step.", stop: "The training saves and ends after this step." };

/** @implements {Part} */
export class TrainingPanel {
  plottedAt = -Infinity;
  /** @type {Record[]} */ history = [];
  /** The newest state. @type {Status | null} */ status = null;
  /** Which cameras the page has, as the state counts them. */ cameras = 0;

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    this.panel = /** @type {HTMLElement} */ (document.getElementById("training"));
    for (const button of this.buttons) {
      button.addEventListener("click", () => void this.wish(String(button.dataset.wish)));
    }
  }

  /** The progress of the training; null where nothing is trained. @returns {Training | null} */
  get newest() {
    return this.status?.training ?? null;
  }

  /** @param {string} wish */
  async wish(wish) {
    const { messages } = this.viewer;
    try {
      await steer(wish);
      if (WISHES[wish]) messages.notice(WISHES[wish]);
    } catch (error) {
      messages.notice(/** @type {Error} */ (error).message);
    }
  }

  /** @param {import("../scene/scene.js").Scene} scene */
  sceneSet({ cameras_version: version }) {
    this.cameras = version;
  }

  /** Whether the training sees its views from elsewhere than the page has its cameras. */
  hasMoved() {
    return this.status !== null && this.status.cameras !== this.cameras;
  }

  /** Moves the cameras to where the training sees its views from by now. */
  async moveCameras() {
    if (!this.status || !this.hasMoved()) return;
    const { cameras: version } = this.status;
    try {
      this.viewer.moveCameras(await fetchCameras());
      this.cameras = version;
    } catch {
      // The next picture tries again.
    }
  }

  /** Those that steer. @returns {NodeListOf<HTMLButtonElement>} */
  get buttons() {
    return this.panel.querySelectorAll("button[data-wish]");
  }

  /** Whether there is nothing left to train. */
  isOver() {
    return this.newest !== null && (this.newest.is_finished || this.newest.done >= this.newest.total);
  }

  /** @param {Status} status */
  followed(status) {
    this.status = status;
    const { training } = status;
    const isDue = training && (training.is_finished || training.is_paused || performance.now() - this.plottedAt > PLOT_MS);
    // Progress and plots change together, which is one drawing of the window.
    if (isDue && training.records !== this.history.length) void this.plot();
    else this.show();
  }

  /** Shows the newest state, which may have come while the plots were on their way. */
  show() {
    const { training, splats } = this.status ?? { training: null, splats: 0 };
    this.panel.hidden = !training;
    if (!training) return;
    const { done, total, is_paused, is_finished } = training;
    const progress = /** @type {HTMLProgressElement} */ (document.getElementById("training-progress"));
    progress.value = done / Math.max(1, total);
    const state = is_finished ? "finished" : is_paused ? "paused" : "training";
    const text = /** @type {HTMLElement} */ (document.getElementById("training-text"));
    text.textContent = `step ${done.toLocaleString("en")} of ${total.toLocaleString("en")} · ${splats.toLocaleString("en")} splats · ${state}`;
    for (const button of this.buttons) {
      button.disabled = is_finished;
      if (button.dataset.wish === "save" || button.dataset.wish === "stop") continue;
      button.dataset.wish = is_paused ? "continue" : "pause";
      button.textContent = is_paused ? "Continue" : "Pause";
    }
  }

  async plot() {
    this.plottedAt = performance.now();
    try {
      this.history = await fetchHistory(0);
      drawPlots(/** @type {HTMLElement} */ (document.getElementById("plots")), this.history);
    } catch {
      // The next state tries again.
    }
    this.show();
  }
}
