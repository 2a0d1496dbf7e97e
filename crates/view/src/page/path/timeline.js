/** The timeline under the picture: the playhead, and keyframes that can be dragged. */

import { byId } from "../dom/elements.js";

/** @typedef {import("./path.js").PathPanel} PathPanel */

/** Pixels of a drag below which it is a click. */
const CLICK_PX = 3;

export class Timeline {
  /** The keyframes that there are marks of. */ shown = "";

  /** @param {PathPanel} panel */
  constructor(panel) {
    this.panel = panel;
    byId("playhead").addEventListener("input", () => {
      panel.stop();
      panel.goTo(panel.timeOf(byId("playhead").valueAsNumber));
    });
  }

  reflect() {
    const { panel } = this;
    const { keyframes, duration } = panel.path;
    byId("timeline").hidden = keyframes.length === 0;
    const head = byId("playhead");
    head.max = String(panel.count() - 1);
    const frame = panel.frameAt(panel.playhead);
    if (head.valueAsNumber !== frame) head.value = String(frame);
    const text = `${panel.playhead.toFixed(2)} s of ${duration.toFixed(2)} s, frame ${frame}`;
    head.setAttribute("aria-valuetext", text);
    byId("playhead-text").textContent = text;
    this.marks();
  }

  /** Marks of keyframes; those that are there stay, as one of them may be in a drag. */
  marks() {
    const { path, selected } = this.panel;
    const lane = byId("keyframes");
    while (lane.children.length > path.keyframes.length) lane.lastElementChild?.remove();
    while (lane.children.length < path.keyframes.length) lane.append(this.mark(lane.children.length));
    path.keyframes.forEach(({ time }, i) => {
      const mark = /** @type {HTMLElement} */ (lane.children[i]);
      mark.style.left = `${(100 * time) / path.duration}%`;
      mark.title = `Keyframe ${i + 1} at ${time.toFixed(2)} s: click to stand there, drag or arrow keys to move in time`;
      mark.setAttribute("aria-label", `Keyframe ${i + 1} at ${time.toFixed(2)} seconds`);
      mark.setAttribute("aria-pressed", String(i === selected));
    });
  }

  /** @param {number} i */
  mark(i) {
    const { panel } = this;
    const mark = Object.assign(document.createElement("button"), { type: "button" });
    let from = 0;
    let isMoved = false;
    mark.addEventListener("pointerdown", (event) => {
      mark.setPointerCapture(event.pointerId);
      [from, isMoved] = [event.clientX, false];
    });
    mark.addEventListener("pointermove", (event) => {
      if (!mark.hasPointerCapture(event.pointerId)) return;
      isMoved ||= Math.abs(event.clientX - from) > CLICK_PX;
      const { left, width } = byId("keyframes").getBoundingClientRect();
      if (isMoved) panel.move(i, ((event.clientX - left) / Math.max(1, width)) * panel.path.duration);
    });
    mark.addEventListener("click", () => {
      if (!isMoved) panel.choose(i);
      isMoved = false;
    });
    mark.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (by === undefined) return;
      event.preventDefault();
      panel.move(i, panel.path.keyframes[i].time + by / panel.path.frames_per_second);
    });
    return mark;
  }
}
