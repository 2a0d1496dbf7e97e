/** The camera path: keyframes, preview, file, and its frames rendered by the program, which also interpolates. */

import { byId } from "../dom/elements.js";
import { download } from "../dom/files.js";
import { aside, choiceOf, lensOf, lensOfView, poseOf, toJson } from "../math/lens.js";
import { add, times } from "../math/vectors.js";
import { checked } from "../scene/server.js";
import { PathRender } from "./frames.js";
import { Timeline } from "./timeline.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../viewer/overlay.js").Overlay} Overlay */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").ViewCamera} ViewCamera */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */
/** A camera as a frame of transforms.json. @typedef {Pick<ViewCamera, "transform_matrix" | "fl_x" | "fl_y" | "cx" | "cy" | "w" | "h">} Camera */
/** @typedef {{ time: number, camera: Camera }} Keyframe */
/** A path as the server takes it. @typedef {{ keyframes: Keyframe[], duration: number, frames_per_second: number, ease: string, closed: boolean, width: number, height: number }} Path */

/** Seconds between keyframes that are added one after the other. */
const LEG = 2;
/** Time after a change before the path is made, ms. */
const MAKE_MS = 60;
/** Bytes of a file that is opened. */
const MAX_BYTES = 16 * 2 ** 20;

/** @param {Camera} camera @returns {ViewCamera} */
const asView = (camera) => ({ ...camera, name: "", split: "train", has_ground_truth: false });

/** @implements {Part} */
export class PathPanel {
  /** @type {Path} */ path = { keyframes: [], duration: LEG, frames_per_second: 24, ease: "ends", closed: false, width: 1920, height: 1080 };
  /** Keyframe that is chosen; -1 for none. */ selected = -1;
  /** Place on the timeline, seconds. */ playhead = 0;
  /** Cameras of all frames. @type {Camera[]} */ frames = [];
  /** The file of the path as the server wrote it. */ file = "";
  /** @type {{ start: number, from: number } | null} */ playing = null;
  /** The eye that the preview has set. @type {unknown} */ lastEye = null;
  makeAt = 0;
  made = 0;
  /** Whether the frames could not be made, and the panel says so. */ isWrong = false;

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    this.timeline = new Timeline(this);
    this.render = new PathRender(this);
    byId("path-add").addEventListener("click", () => this.add());
    byId("path-replace").addEventListener("click", () => this.replace());
    byId("path-remove").addEventListener("click", () => this.remove());
    byId("path-play").addEventListener("click", () => this.toggle());
    byId("path-save").addEventListener("click", () => this.file && download(URL.createObjectURL(new Blob([this.file], { type: "application/json" })), "path.json"));
    byId("path-open").addEventListener("click", () => byId("path-file").click());
    byId("path-file").addEventListener("change", () => {
      const file = byId("path-file").files?.[0];
      if (file) void this.open(file);
      byId("path-file").value = "";
    });
    byId("path-clear").addEventListener("click", () => this.change({ keyframes: [], duration: LEG }, -1));
    const number = (/** @type {string} */ id, /** @type {(value: number) => void} */ set) =>
      byId(id).addEventListener("change", () => byId(id).valueAsNumber > 0 ? set(byId(id).valueAsNumber) : viewer.changed());
    number("path-duration", (value) => this.stretch(value));
    number("path-fps", (value) => this.change({ frames_per_second: value }));
    number("path-width", (value) => this.change({ width: Math.round(value) }));
    number("path-height", (value) => this.change({ height: Math.round(value) }));
    byId("path-ease").addEventListener("change", () => this.change({ ease: byId("path-ease").value }));
    byId("path-closed").addEventListener("change", () => this.close(byId("path-closed").checked));
  }

  /** Number of frames. */
  count() {
    return Math.max(1, Math.round(this.path.duration * this.path.frames_per_second));
  }

  /** Time of a frame, as the program has it. @param {number} i */
  timeOf(i) {
    return (this.path.duration * i) / Math.max(1, this.path.closed ? this.count() : this.count() - 1);
  }

  /** The frame at a time. @param {number} time */
  frameAt(time) {
    const last = this.count() - 1;
    return Math.min(last, Math.max(0, Math.round((time / this.path.duration) * (this.path.closed ? last + 1 : last))));
  }

  /** @param {Partial<Path>} change @param {number} [selected] */
  change(change, selected = this.selected) {
    Object.assign(this.path, change);
    // Nothing is left to draw or play, until frames of new keyframes come.
    if (this.path.keyframes.length === 0) this.frames = [];
    this.selected = selected;
    this.playhead = Math.min(this.playhead, this.path.duration);
    this.makeAt = performance.now() + MAKE_MS;
    this.viewer.needsMarks = this.viewer.needsReflect = true;
  }

  /** The camera of the view; frames of a path are pinholes. @returns {Camera} */
  here() {
    const { width, height } = this.viewer.dots;
    // From between the eyes, where there are two.
    const lens = aside(this.viewer.lens(width, height), -(this.viewer.comparison?.rightEye() ?? 0));
    const isPinhole = lens.projection.kind === "pinhole";
    if (!isPinhole) this.say(`Frames of a path are pinholes; this one has a field of view of ${this.viewer.state.fov.toFixed(0)}°.`);
    const own = isPinhole ? lens : lensOf({ ...this.viewer.state, projection: "pinhole" }, width, height);
    return { ...JSON.parse(toJson(own)), w: width, h: height };
  }

  /** Adds the view as a keyframe: at the playhead, or after the last one where there is one at it. */
  add() {
    const { keyframes, duration } = this.path;
    const gap = 0.5 / this.path.frames_per_second;
    const last = keyframes.at(-1);
    const isTaken = keyframes.some(({ time }) => Math.abs(time - this.playhead) < gap);
    const time = !last ? 0 : isTaken ? last.time + LEG : this.playhead;
    const all = [...keyframes, { time, camera: this.here() }].sort((a, b) => a.time - b.time);
    this.playhead = time;
    // A loop returns to its beginning after the last keyframe.
    this.change({ keyframes: all, duration: Math.max(duration, this.path.closed ? time + LEG : time) }, all.findIndex((keyframe) => keyframe.time === time));
  }

  replace() {
    const { selected } = this;
    this.change({ keyframes: this.path.keyframes.map((keyframe, i) => (i === selected ? { ...keyframe, camera: this.here() } : keyframe)) });
  }

  remove() {
    this.change({ keyframes: this.path.keyframes.filter((_, i) => i !== this.selected) }, -1);
  }

  /** Makes a loop of the path, or ends it: a loop needs time from the last keyframe to the first. @param {boolean} closed */
  close(closed) {
    const last = this.path.keyframes.at(-1)?.time ?? 0;
    const needsTime = closed && this.path.keyframes.length > 1 && last >= this.path.duration - 1e-9;
    this.change({ closed, duration: needsTime ? last + LEG : this.path.duration });
  }

  /** Moves a keyframe in time, between its neighbours, to a whole frame. @param {number} i @param {number} time */
  move(i, time) {
    const { keyframes, duration, frames_per_second: rate, closed } = this.path;
    const low = i > 0 ? keyframes[i - 1].time + 1 / rate : 0;
    const high = i + 1 < keyframes.length ? keyframes[i + 1].time - 1 / rate : duration - (closed && i > 0 ? 1 / rate : 0);
    const at = Math.min(Math.max(this.timeOf(this.frameAt(time)), low), high);
    if (at < 0 || high < low) return;
    this.playhead = at;
    this.change({ keyframes: keyframes.map((keyframe, k) => (k === i ? { ...keyframe, time: at } : keyframe)) }, i);
  }

  /** Changes the length, and the times of keyframes with it. @param {number} duration */
  stretch(duration) {
    const factor = duration / this.path.duration;
    this.playhead *= factor;
    this.change({ duration, keyframes: this.path.keyframes.map(({ time, camera }) => ({ time: Math.min(duration, time * factor), camera })) });
  }

  /** Stands at a time of the path. @param {number} time */
  goTo(time) {
    this.playhead = Math.min(Math.max(time, 0), this.path.duration);
    const frame = this.frames[this.frameAt(this.playhead)];
    if (!frame) return void (this.viewer.needsReflect = true);
    const { viewer } = this;
    const { eye, axes } = poseOf(asView(frame));
    const { pivot, eye: before } = viewer.state;
    const reach = Math.hypot(...[0, 1, 2].map((c) => pivot[c] - before[c]));
    Object.assign(viewer.state, { eye, axes, ...choiceOf(asView(frame)), view: "", pivot: add(eye, times(axes.back, -reach)) });
    this.lastEye = eye;
    viewer.moved();
  }

  /** @param {number} i */
  choose(i) {
    this.selected = i;
    this.stop();
    this.goTo(this.path.keyframes[i].time);
  }

  toggle() {
    if (this.playing) return this.stop();
    if (this.path.keyframes.length === 0) return;
    const isAtEnd = this.frameAt(this.playhead) >= this.count() - 1;
    this.playing = { start: performance.now(), from: isAtEnd ? 0 : this.playhead };
    this.goTo(this.playing.from);
  }

  stop() {
    this.playing = null;
    this.viewer.needsReflect = this.viewer.needsMarks = true;
  }

  /** @param {number} now */
  step(now) {
    if (this.makeAt && now > this.makeAt) {
      this.makeAt = 0;
      void this.make();
    }
    if (!this.playing) return;
    // Whoever takes the camera in hand ends the preview.
    if (this.viewer.state.eye !== this.lastEye) return this.stop();
    const time = this.playing.from + (now - this.playing.start) / 1000;
    const { duration, closed } = this.path;
    if (time >= duration && !closed) {
      this.goTo(duration);
      return this.stop();
    }
    if (this.frameAt(time % duration) !== this.frameAt(this.playhead)) this.goTo(time % duration);
  }

  /** Has the program make the cameras of all frames. */
  async make() {
    const made = ++this.made;
    try {
      if (this.path.keyframes.length === 0) [this.frames, this.file] = [[], ""];
      else {
        const text = await (await checked(await fetch("/api/path", { method: "POST", body: JSON.stringify(this.path) }))).text();
        // A newer one is on its way.
        if (made !== this.made) return;
        [this.frames, this.file] = [JSON.parse(text).frames, text];
      }
      // What was said of a file that could not be opened stays.
      if (this.isWrong) this.say("");
      this.isWrong = false;
    } catch (error) {
      if (made !== this.made) return;
      [this.frames, this.file, this.isWrong] = [[], "", true];
      this.say(/** @type {Error} */ (error).message);
    }
    this.viewer.needsReflect = this.viewer.needsMarks = true;
  }

  /** Opens a camera file. @param {File} file */
  async open(file) {
    try {
      if (file.size > MAX_BYTES) throw new Error(`${file.size} bytes, expected at most ${MAX_BYTES}`);
      const path = await (await checked(await fetch("/api/path/read", { method: "POST", body: await file.text() }))).json();
      this.playhead = 0;
      this.change(path, -1);
      this.say("");
      byId("path-section").scrollIntoView({ block: "nearest" });
    } catch (error) {
      this.say(`${file.name}: ${/** @type {Error} */ (error).message}`);
    }
  }

  /** @param {string} text */
  say(text) {
    byId("path-text").textContent = text;
  }

  /** @param {Overlay} overlay @param {Lens} lens */
  draw(overlay, lens) {
    if (this.playing || this.frames.length === 0) return;
    const { context } = overlay;
    const size = this.viewer.controls.size * 0.05;
    [context.strokeStyle, context.lineWidth] = ["#000a", 3];
    const eyes = this.frames.map((frame) => poseOf(asView(frame)).eye);
    overlay.path(eyes, lens, this.path.closed);
    [context.strokeStyle, context.lineWidth] = ["#fff", 1];
    overlay.path(eyes, lens, this.path.closed);
    this.path.keyframes.forEach(({ camera }, i) => {
      context.lineWidth = i === this.selected ? 2 : 1;
      this.frustum(overlay, lens, camera, size);
    });
    const now = this.frames[this.frameAt(this.playhead)];
    context.lineWidth = 1;
    if (now) this.frustum(overlay, lens, now, size * 0.6);
  }

  /** @param {Overlay} overlay @param {Lens} lens @param {Camera} camera @param {number} size */
  frustum(overlay, lens, camera, size) {
    const own = lensOfView(asView(camera), this.path.width, this.path.height);
    const { right, up, back } = own.axes;
    const half = size / 2;
    const [x, y] = [(half * camera.w) / camera.fl_x, (half * camera.h) / camera.fl_y];
    const corner = (/** @type {number} */ u, /** @type {number} */ v) => add(own.eye, add(add(times(right, u * x), times(up, v * y)), times(back, -size)));
    const far = [corner(-1, 1), corner(1, 1), corner(1, -1), corner(-1, -1)];
    overlay.path(far, lens, true);
    for (const point of far) overlay.path([own.eye, point], lens);
  }

  /** @param {import("../scene/scene.js").Scene} scene */
  sceneSet(scene) {
    byId("path-render-controls").hidden = scene.training !== null;
    void this.render.follow();
  }

  reflect() {
    const { path, selected } = this;
    const has = path.keyframes.length > 0;
    for (const [id, value] of /** @type {const} */ ([["path-duration", path.duration], ["path-fps", path.frames_per_second], ["path-width", path.width], ["path-height", path.height]])) {
      if (document.activeElement !== byId(id)) byId(id).value = String(Number(value.toFixed(3)));
    }
    byId("path-ease").value = path.ease;
    byId("path-closed").checked = path.closed;
    for (const id of ["path-replace", "path-remove"]) /** @type {HTMLButtonElement} */ (byId(id)).disabled = selected < 0;
    for (const id of ["path-play", "path-save", "path-clear", "path-render"]) /** @type {HTMLButtonElement} */ (byId(id)).disabled = !has || (id !== "path-clear" && !this.file);
    byId("path-play").textContent = this.playing ? "Stop" : "Play";
    byId("path-facts").textContent = has ? `${path.keyframes.length} keyframes · ${this.count()} frames` : "Move to a view and add it as a keyframe; then the next one.";
    this.timeline.reflect();
  }
}
