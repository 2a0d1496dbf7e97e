/** Comparison with the ground truth of a camera, with another scene, or with what a second eye sees: wipe, difference, flicker, side by side. */

import { COMPARES } from "../display/choices.js";
import { STOPS } from "../display/falsecolor.js";
import { byId, press, segmented } from "../dom/elements.js";
import { aside } from "../math/lens.js";
import { errorFacts, MIDDLE_GREY, sampleAt, text } from "../picture/pixels.js";
import { Stream } from "../scene/stream.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../viewer/overlay.js").Overlay} Overlay */
/** @typedef {import("../viewer/part.js").Grip} Grip */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../viewer/state.js").State} State */
/** @typedef {import("../scene/scene.js").Scene} Scene */
/** @typedef {import("../scene/stream.js").Shown} Shown */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** Time for which each picture of a flicker is shown, ms; below three flashes a second. */
const FLICKER_MS = 600;
/** Distance from which the edge of the wipe is taken hold of, pixels of the screen. */
const GRIP_PX = 14;

/** @implements {Part} */
export class Comparison {
  /** Camera whose ground truth is there, or on its way. */ truthOf = "";
  /** The picture of the other scene, or of the left eye. @type {Shown | null} */ other = null;
  /** What the stream has pictures of. */ streamed = "";
  /** Numbers of the map of errors, in words, and what they are of. */ error = { key: "", text: "" };

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    const { source } = viewer;
    // The same pictures, of the other scene as it is, or of the left eye.
    const other = (/** @type {import("../scene/source.js").Picture} */ picture) => (this.kind() === "eye" ? { ...picture, name: "left" } : { ...picture, edit: "", variant: { ...viewer.variant(), scene: 1 } });
    const others = Object.create(source, {
      frame: { value: (/** @type {Parameters<typeof source.frame>} */ ...[lens, picture, signal]) => source.frame(lens, other(picture), signal) },
      layersApart: { value: false },
    });
    this.stream = new Stream(others, (shown) => this.took(shown), (error) => viewer.messages.set("other picture", error?.message ?? ""));
    segmented(byId("compare"), COMPARES, (name) => viewer.set({ compare: /** @type {State["compare"]} */ (name) }));
    byId("against").addEventListener("change", () => viewer.set({ against: /** @type {State["against"]} */ (byId("against").value) }));
    byId("eyes").addEventListener("change", () => byId("eyes").valueAsNumber >= 0 && viewer.set({ eyes: byId("eyes").valueAsNumber }));
    byId("error").addEventListener("change", () => viewer.set({ error: /** @type {State["error"]} */ (byId("error").value) }));
  }

  /** @param {Scene} scene */
  sceneSet(scene) {
    for (const option of byId("against").querySelectorAll("option")) option.hidden = option.value === "scene" && scene.others.length === 0;
    this.truthOf = "";
    this.stream.invalidate();
  }

  /** What is compared with. @returns {State["against"]} */
  kind() {
    const { scene, state } = this.viewer;
    if (state.against === "eye") return "eye";
    return scene?.others.length && state.against === "scene" ? "scene" : "truth";
  }

  /** Name of what is compared with. */
  otherName() {
    return { scene: this.viewer.scene?.others[0]?.name ?? "", truth: "ground truth", eye: "left eye" }[this.kind()];
  }

  /** Whether there is something to compare with here. */
  canCompare() {
    return this.kind() !== "truth" || Boolean(this.viewer.viewCamera()?.has_ground_truth);
  }

  /** Distance from the middle to the right eye, world units; 0 for one eye. */
  rightEye() {
    const { state } = this.viewer;
    return state.compare !== "off" && this.kind() === "eye" ? state.eyes / 2 : 0;
  }

  /** Whether a picture is there that is compared with. */
  isOn() {
    const { state, display } = this.viewer;
    if (state.compare === "off" || display.truth === null) return false;
    return this.kind() !== "truth" ? display.truth === this.other?.frame : this.truthOf === state.view && state.view !== "";
  }

  /** Whether the picture changes by itself. */
  isFlickering() {
    return this.viewer.state.compare === "flicker" && this.isOn();
  }

  /** What is drawn: without a comparison until there is something to compare with. @returns {State} */
  drawn() {
    const { state } = this.viewer;
    return this.isOn() || this.viewer.panes() > 1 ? state : { ...state, compare: "off" };
  }

  /** Whether the flicker shows the other picture. @param {number} now */
  showsTruth(now) {
    return Math.floor(now / FLICKER_MS) % 2 === 1;
  }

  /** What the other picture holds at a place, in the first scene's colour space. @param {number} u @param {number} v */
  sample(u, v) {
    const { scene, display } = this.viewer;
    if (!scene || !display.truth) return null;
    const sample = sampleAt(display.truth, null, u, v, this.kind() === "scene" ? scene.others[0].luminance_weights : scene.luminance_weights);
    if (!sample) return null;
    const radiance = /** @type {import("../math/vectors.js").Vec3} */ (display.firstFromOther.map((row) => row[0] * sample.radiance[0] + row[1] * sample.radiance[1] + row[2] * sample.radiance[2]));
    return { ...sample, radiance };
  }

  /** Whether a value of the ground truth is masked: it counts less than half. @param {import("../picture/pixels.js").Sample | null} sample */
  isMasked(sample) {
    return this.kind() === "truth" && sample?.alpha !== null && sample?.alpha !== undefined && sample.alpha < 0.5;
  }

  /** Whether both pictures are full ones of what is wanted now. */
  isWhole() {
    const { shown, stream } = this.viewer;
    if (!shown?.full) return false;
    return this.kind() === "truth" || Boolean(this.other?.full && this.stream.fullKey === stream.fullKey);
  }

  /** Numbers of the map of errors, without masked pixels; "" where there is none, or no full pictures yet. */
  errorText() {
    const { shown, display, scene, state } = this.viewer;
    if (state.compare !== "difference" || !this.isOn() || !this.isWhole() || !shown || !display.truth || !scene) return "";
    const others = this.kind() === "scene" ? scene.others[0].luminance_weights : scene.luminance_weights;
    const least = (MIDDLE_GREY * scene.radiance_scale * 2 ** STOPS.low) / 2 ** state.exposure;
    const key = JSON.stringify([shown.frame.head, this.viewer.stream.fullKey, this.stream.fullKey, this.truthOf, state.error, least]);
    if (key !== this.error.key) {
      const facts = errorFacts(shown.frame, display.truth, { weights: [scene.luminance_weights, others], mask: display.truthMask, kind: state.error, least });
      const value = (/** @type {number} */ v) => (state.error === "relative" ? `${text(100 * v)} %` : `${text(v)} stops`);
      const parts = facts ? [`mean ${value(facts.mean)}`, `95 % ${state.error === "signed" ? "within ±" : "below "}${value(facts.high)}`] : ["no pixel to compare"];
      if (display.truthMask) parts.push(`${text(100 * (facts?.masked ?? 1))} % masked`);
      this.error = { key, text: parts.join(" · ") };
    }
    return this.error.text;
  }

  /** @param {Shown} shown */
  took(shown) {
    const { viewer } = this;
    this.other = shown;
    const kind = this.kind();
    if (kind === "truth") return;
    viewer.display.compareWith(shown.frame, { full: shown.full, firstFromOther: kind === "scene" ? viewer.scene?.others[0].first_from_scene : undefined });
    viewer.needsDraw = true;
    // Numbers of whole pictures, such as the error, are shown beside them.
    if (shown.full) viewer.needsReflect = true;
  }

  /** @param {number} now */
  step(now) {
    const { viewer } = this;
    const needsOther = viewer.state.compare !== "off" && this.kind() !== "truth";
    if (!needsOther) viewer.messages.set("other picture", "");
    if (viewer.state.compare === "off") return;
    if (needsOther) {
      const kind = this.kind();
      const want = viewer.want();
      this.truthOf = "";
      const distance = 2 * this.rightEye();
      if (this.streamed !== kind) this.stream.invalidate();
      this.streamed = kind;
      this.stream.tick(kind === "scene" ? { ...want, edit: "", layers: false } : { ...want, lens: (w, h) => aside(want.lens(w, h), -distance) }, now);
      if (this.other && viewer.display.truth !== this.other.frame) this.took(this.other);
      return;
    }
    const view = viewer.viewCamera();
    if (!view?.has_ground_truth || this.truthOf === view.name) return;
    this.truthOf = view.name;
    viewer.display.compareWith(null);
    viewer.source
      .truth(view.name)
      .then((frame) => {
        if (this.truthOf === view.name) viewer.display.compareWith(frame, { mask: frame.alpha });
        viewer.changed();
      })
      .catch((error) => viewer.messages.notice(error.message));
  }

  reflect() {
    const { scene, state } = this.viewer;
    press("compare", state.compare);
    const view = this.viewer.viewCamera();
    const hasTruth = scene?.cameras.some((camera) => camera.has_ground_truth) ?? false;
    const kind = this.kind();
    for (const button of byId("compare").querySelectorAll("button")) button.disabled = kind === "truth" && !hasTruth && button.dataset.value !== "off";
    byId("against").value = kind;
    byId("eyes-row").hidden = kind !== "eye";
    if (document.activeElement !== byId("eyes")) byId("eyes").value = String(state.eyes);
    byId("error").value = state.error;
    byId("error-row").hidden = state.compare !== "difference";
    const withTruth = view?.has_ground_truth ? `${view.name} (${view.split})` : "Choose a camera below to compare with its image.";
    byId("compare-text").textContent = { scene: `${scene?.name} with ${this.otherName()}`, eye: "What the left and the right eye see; files show the right one's.", truth: withTruth }[kind];
    byId("error-text").textContent = this.errorText();
  }

  /** @param {Overlay} overlay @param {Lens} lens */
  draw(overlay, lens) {
    const { state, box, viewer } = { ...this.viewer, viewer: this.viewer };
    const isOn = this.isOn();
    const isWipe = isOn && state.compare === "wipe";
    const isBeside = viewer.panes() > 1;
    if (isWipe) overlay.wipe(state.wipe * lens.width, lens.height);
    const labels = byId("wipe-labels");
    labels.hidden = !isWipe && !isBeside && !this.isFlickering();
    const showsTruth = this.showsTruth(performance.now());
    const [truth, render] = /** @type {HTMLElement[]} */ ([...labels.children]);
    truth.textContent = this.otherName();
    render.textContent = { scene: viewer.scene?.name ?? "", eye: "right eye", truth: "render" }[this.kind()];
    const edge = box.left + state.wipe * lens.width;
    const isBoth = isWipe || isBeside;
    Object.assign(truth.style, { right: isWipe ? `calc(100% - ${edge - 8}px)` : "", left: isWipe ? "" : `${(isBeside ? box.left : 0) + 10}px`, display: isBoth || showsTruth ? "" : "none" });
    Object.assign(render.style, { left: isWipe ? `${edge + 8}px` : `${(isBeside ? box.left + box.width : 0) + 10}px`, display: isBoth || !showsTruth ? "" : "none" });
  }

  /** Takes hold of the edge of the wipe. @param {number} x @returns {Grip | null} */
  grab(x) {
    const { state, box } = this.viewer;
    if (!this.isOn() || state.compare !== "wipe" || Math.abs(x - state.wipe * box.width) > GRIP_PX) return null;
    return { move: (to) => this.viewer.set({ wipe: Math.min(1, Math.max(0, to / this.viewer.box.width)) }) };
  }
}
