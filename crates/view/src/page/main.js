/** The viewer: connects state, controls, pictures and panels. */

import { listen } from "./connection.js";
import { Controls } from "./controls.js";
import { Display } from "./display.js";
import { KEYS, next } from "./help.js";
import { fovOf, lensOf, lensOfView, poseOf } from "./lens.js";
import { add, looking, sub, times } from "./math.js";
import { sampleAt, suitableExposure, text } from "./measure.js";
import { Overlay } from "./overlay.js";
import { byId, connect, drawHistogram, reflect } from "./panel.js";
import { distanceOf, fillPins, fillReadout } from "./probes.js";
import { overview, sizeOf } from "./places.js";
import { fetchFrame, fetchScene } from "./scene.js";
import { applyHash, COMPARES, CURVES, LAYERS, MODES, State, toHash } from "./state.js";
import { fillStrip } from "./strip.js";
import { address, Stream } from "./stream.js";
import { TrainingPanel } from "./training.js";

/** @typedef {import("./math.js").Vec3} Vec3 */
/** @typedef {import("./measure.js").Sample} Sample */
/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {import("./scene.js").Status} Status */
/** @typedef {import("./scene.js").ViewCamera} ViewCamera */
/** @typedef {import("./stream.js").Shown} Shown */

/** Least time between pictures of a scene that is being trained, ms. */
const FOLLOW_MS = 2000;
/** Time for which each picture of a flicker is shown, ms; below three flashes a second. */
const FLICKER_MS = 600;
/** Least time between histograms while moving, ms. */
const HISTOGRAM_MS = 200;
/** Time after which the first hint goes, ms. */
const HINT_MS = 12000;
/** Probes that are kept. */
const MAX_PINS = 20;

export class Viewer {
  state = new State();
  /** @type {Scene | null} */ scene = null;
  /** @type {Shown | null} */ shown = null;
  /** @type {Sample[]} */ pins = [];
  /** Place of the pointer in the picture, 0 to 1. @type {{ u: number, v: number } | null} */ pointer = null;
  /** Size and place of the picture on the screen. */ box = { left: 0, top: 0, width: 1, height: 1 };
  /** Size of the picture in pixels of the screen. */ dots = { width: 1, height: 1 };
  version = 0;
  followedAt = 0;
  countedAt = 0;
  truthOf = "";
  needsDraw = true;
  needsReflect = true;
  saveAt = 0;
  training = new TrainingPanel((message) => this.complain(message));

  constructor() {
    this.canvas = /** @type {HTMLCanvasElement} */ (document.getElementById("picture"));
    this.display = new Display(this.canvas);
    this.overlay = new Overlay(/** @type {HTMLCanvasElement} */ (document.getElementById("overlay")));
    this.stream = new Stream((shown) => this.take(shown), (error) => this.complain(error?.message ?? ""));
    this.controls = new Controls(this.canvas, this.state, {
      moved: () => this.moved(),
      clicked: (x, y, event) => this.clicked(x, y, event),
      pivoted: (x, y) => this.pivot(x, y),
      wiped: (x) => this.wiped(x),
      hovered: (x, y) => this.hover(x, y),
    });
    this.canvas.addEventListener("pointerleave", () => this.hover(-1, -1));
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("resize", () => (this.needsDraw = true));
    addEventListener("hashchange", () => {
      applyHash(this.state, location.hash);
      this.changed();
    });
    new ResizeObserver(() => (this.needsDraw = true)).observe(byId("stage"));
    for (const kind of ["pointerdown", "keydown", "wheel"]) addEventListener(kind, () => byId("hint").classList.add("gone"), { passive: true });
    setTimeout(() => byId("hint").classList.add("gone"), HINT_MS);
    connect(this);
    // On a phone the picture comes first.
    if (matchMedia("(max-width: 700px)").matches) this.togglePanel();
  }

  async start() {
    listen({ state: (status) => this.follow(status), lost: () => this.lost(), again: () => void this.reconnected() });
    for (;;) {
      try {
        this.setScene(await fetchScene());
        break;
      } catch (error) {
        this.complain(/** @type {Error} */ (error).message);
        await new Promise((resolve) => setTimeout(resolve, 1000));
      }
    }
    let before = performance.now();
    const loop = (/** @type {number} */ now) => {
      this.frame(now, (now - before) / 1000);
      before = now;
      requestAnimationFrame(loop);
    };
    requestAnimationFrame(loop);
  }

  /** @param {Status} status */
  follow(status) {
    if (status.version !== this.version) {
      this.version = status.version;
      this.facts(status.splats);
    }
    this.training.follow(status);
  }

  lost() {
    this.complain(this.training.isOver() ? "The training has ended. Look at its scene with luxel view." : "No connection to luxel; trying again.");
  }

  async reconnected() {
    try {
      this.setScene(await fetchScene(), true);
      this.stream.invalidate();
      this.complain("");
    } catch (error) {
      this.complain(/** @type {Error} */ (error).message);
    }
  }

  /** @param {Scene} scene @param {boolean} [again] */
  setScene(scene, again = false) {
    this.scene = scene;
    this.display.scene = scene;
    this.version = scene.version;
    this.controls.up = scene.up;
    this.controls.size = Math.max(sizeOf(scene), 1e-6);
    if (!again) {
      if (!applyHash(this.state, location.hash)) this.home();
      else if (this.state.view) this.standAt(this.state.view);
      fillStrip(byId("strip"), scene, (name) => this.standAt(name));
    }
    this.facts(scene.splats);
    if (scene.training) void this.follow({ version: scene.version, splats: scene.splats, training: scene.training });
    this.changed();
  }

  /** @param {number} splats */
  facts(splats) {
    const edits = this.scene?.edits.length ? ` · ${this.scene.edits.length} edits` : "";
    byId("facts").textContent = `${splats.toLocaleString("en")} splats · ${this.scene?.color_space}${edits}`;
  }

  /** The camera of the data set in whose place the viewer stands. @returns {ViewCamera | undefined} */
  viewCamera() {
    return this.scene?.cameras.find((camera) => camera.name === this.state.view);
  }

  isComparing() {
    return this.state.compare !== "off" && this.display.truth !== null && this.truthOf === this.state.view && this.state.view !== "";
  }

  /** Changes what is chosen. @param {Partial<State>} change */
  set(change) {
    Object.assign(this.state, change);
    if ("compare" in change && change.compare !== "off" && !this.state.view) this.standAtNext(0);
    this.changed();
  }

  /** Goes on to the next choice. @param {"curve" | "layer" | "compare" | "mode"} field */
  cycle(field) {
    if (field === "curve") this.set({ curve: next(CURVES, this.state.curve) });
    else if (field === "layer") this.set({ layer: next(LAYERS, this.state.layer) });
    else if (field === "mode") this.set({ mode: next(MODES, this.state.mode) });
    else this.set({ compare: next(COMPARES, this.state.compare) });
  }

  changed() {
    if (this.state.autoExposure && this.shown) this.fitExposure(true);
    this.needsDraw = this.needsReflect = true;
    this.saveAt = performance.now() + 400;
  }

  moved() {
    this.changed();
  }

  /** First camera, or the whole scene from the front. */
  home() {
    const { scene } = this;
    if (!scene) return;
    if (scene.cameras.length) return this.standAt(scene.cameras[0].name);
    Object.assign(this.state, overview(scene));
    this.state.view = "";
    this.changed();
  }

  /** @param {string} name */
  standAt(name) {
    const camera = this.scene?.cameras.find((known) => known.name === name);
    if (!camera) return void (this.state.view = "");
    const { eye, axes } = poseOf(camera);
    Object.assign(this.state, { eye, axes, view: name, fov: fovOf(camera) });
    // Until the picture tells the depth in its middle.
    this.state.pivot = add(eye, times(axes.back, -this.controls.size));
    this.changed();
    document.querySelector(`#strip button[data-view="${CSS.escape(name)}"]`)?.scrollIntoView({ block: "nearest", inline: "nearest" });
  }

  /** @param {number} by */
  standAtNext(by) {
    const cameras = this.scene?.cameras ?? [];
    if (cameras.length === 0) return;
    const now = cameras.findIndex((camera) => camera.name === this.state.view);
    this.standAt(cameras[now < 0 ? 0 : (now + by + cameras.length) % cameras.length].name);
  }

  /** Size and place of the picture: that of the camera where the viewer stands at one. */
  layout() {
    const stage = byId("stage");
    const [w, h] = [stage.clientWidth, stage.clientHeight];
    const view = this.viewCamera();
    const aspect = view ? view.w / view.h : w / Math.max(1, h);
    const width = Math.max(1, Math.round(Math.min(w, h * aspect)));
    const height = Math.max(1, Math.round(Math.min(h, w / aspect)));
    this.box = { left: Math.round((w - width) / 2), top: Math.round((h - height) / 2), width, height };
    const dots = Math.min(devicePixelRatio, 2);
    this.dots = { width: Math.round(width * dots), height: Math.round(height * dots) };
    // A small picture of a movement is enlarged by the browser, which costs less than the shader.
    const { shown } = this;
    const isSmall = shown && !shown.full && shown.frame.head.width < this.dots.width;
    const [cw, ch] = isSmall ? [shown.frame.head.width, shown.frame.head.height] : [this.dots.width, this.dots.height];
    if (this.canvas.width !== cw || this.canvas.height !== ch) {
      [this.canvas.width, this.canvas.height] = [cw, ch];
      this.needsDraw = true;
    }
    for (const element of [this.canvas, this.overlay.canvas]) {
      Object.assign(element.style, { left: `${this.box.left}px`, top: `${this.box.top}px`, width: `${width}px`, height: `${height}px` });
    }
  }

  /** The lens of a picture of this size. @param {number} width @param {number} height */
  lens(width, height) {
    const view = this.viewCamera();
    return view ? lensOfView(view, width, height) : lensOf({ eye: this.state.eye, axes: this.state.axes, fov: this.state.fov }, width, height);
  }

  /** The picture that is wanted now. */
  want() {
    const view = this.viewCamera();
    // Beside its image, the picture of a camera has the same pixels, so that both compare.
    const paired = this.state.compare === "off" ? undefined : view;
    const [width, height] = paired ? [paired.w, paired.h] : [this.dots.width, this.dots.height];
    const { eye, axes, fov, edit } = this.state;
    const key = JSON.stringify([eye, axes, fov, this.state.view, width, height, edit]);
    const lens = (/** @type {number} */ w, /** @type {number} */ h) => (view ? lensOfView(view, w, h) : lensOf({ eye, axes, fov }, w, h));
    return { key, lens, width, height, edit };
  }

  /** Once per refresh of the screen. @param {number} now @param {number} seconds */
  frame(now, seconds) {
    this.controls.step(seconds);
    this.layout();
    if (this.shown && this.version !== this.shown.frame.head.version && now - this.followedAt > FOLLOW_MS) {
      this.followedAt = now;
      this.stream.invalidate();
    }
    this.stream.tick(this.want(), now);
    this.loadTruth();
    if (this.needsReflect) {
      this.needsReflect = false;
      reflect(this);
      fillPins(byId("pins"), byId("distance"), this);
      if (this.shown) drawHistogram(this, this.shown.frame);
    }
    if (this.needsDraw || (this.state.compare === "flicker" && this.isComparing())) {
      this.needsDraw = false;
      this.draw(now);
    }
    const { shown } = this;
    const size = shown ? `${shown.frame.head.width}×${shown.frame.head.height}` : "";
    byId("rate").textContent = shown ? `${this.stream.rate(performance.now())} fps · ${size} · ${shown.latency.toFixed(0)} ms` : "";
    if (this.saveAt && now > this.saveAt) {
      this.saveAt = 0;
      history.replaceState(null, "", location.pathname + toHash(this.state));
    }
  }

  /** What is drawn: without a comparison until the ground truth is there. */
  drawn() {
    return this.isComparing() ? this.state : Object.assign(new State(), this.state, { compare: "off" });
  }

  /** @param {number} now */
  draw(now) {
    const isComparing = this.isComparing();
    const showTruth = Math.floor(now / FLICKER_MS) % 2 === 1;
    this.display.draw(this.drawn(), showTruth);
    const { width, height } = this.box;
    const lens = this.lens(width, height);
    this.overlay.clear(width, height);
    if (this.state.showCameras && this.scene) this.overlay.cameras(this.scene.cameras, lens, this.controls.size * 0.06, this.state.view);
    this.pins.forEach((pin, i) => pin.position && this.overlay.pin(pin.position, lens, `${i + 1}  ${text(pin.luminance)}`));
    const apart = this.apart();
    const [b, a] = this.pins.filter((pin) => pin.position).slice(-2);
    if (apart !== null && a?.position && b?.position) this.overlay.ruler(a.position, b.position, lens, this.lengthText(apart));
    const isWipe = isComparing && this.state.compare === "wipe";
    if (isWipe) this.overlay.wipe(this.state.wipe * width, height);
    const labels = byId("wipe-labels");
    labels.hidden = !isWipe && !(isComparing && this.state.compare === "flicker");
    const [truth, render] = /** @type {HTMLElement[]} */ ([...labels.children]);
    const edge = this.box.left + this.state.wipe * width;
    Object.assign(truth.style, { right: isWipe ? `calc(100% - ${edge - 8}px)` : "", left: isWipe ? "" : "10px", display: isWipe || showTruth ? "" : "none" });
    Object.assign(render.style, { left: isWipe ? `${edge + 8}px` : "10px", display: isWipe || !showTruth ? "" : "none" });
    this.read();
  }

  /** Fetches the ground truth of the camera where it is compared with. */
  loadTruth() {
    const view = this.viewCamera();
    if (this.state.compare === "off" || !view?.has_ground_truth || this.truthOf === view.name) return;
    this.truthOf = view.name;
    this.display.compareWith(null);
    fetchFrame(`/api/truth?view=${encodeURIComponent(view.name)}`)
      .then((frame) => {
        if (this.truthOf === view.name) this.display.compareWith(frame);
        this.changed();
      })
      .catch((error) => this.complain(error.message));
  }

  /** @param {Shown} shown */
  take(shown) {
    const isFirst = this.shown === null;
    this.shown = shown;
    this.display.show(shown.frame, shown.full);
    if (isFirst) document.body.dataset.ready = "true";
    if (shown.full) this.settle(shown);
    if (this.state.autoExposure) this.fitExposure(true);
    const now = performance.now();
    if (shown.full || now - this.countedAt > HISTOGRAM_MS) {
      this.countedAt = now;
      drawHistogram(this, shown.frame);
    }
    this.needsDraw = true;
  }

  /** Sets the pivot of a camera that was just stood at to what is in its middle. @param {Shown} shown */
  settle(shown) {
    if (!this.scene || !this.state.view) return;
    const sample = sampleAt(shown.frame, shown.lens, 0.5, 0.5, this.scene.luminance_weights);
    if (sample?.position) this.state.pivot = sample.position;
  }

  /** @param {boolean} [quietly] */
  fitExposure(quietly = false) {
    if (!this.scene || !this.shown) return;
    const stops = suitableExposure(this.shown.frame, this.scene.luminance_weights, this.scene.radiance_scale);
    if (stops === null) return;
    this.state.exposure = Math.min(16, Math.max(-16, Math.round(stops * 20) / 20));
    this.needsDraw = this.needsReflect = true;
    if (!quietly) this.set({ autoExposure: false });
  }

  /** @param {number} u @param {number} v */
  sample(u, v) {
    return this.shown && this.scene ? sampleAt(this.shown.frame, this.shown.lens, u, v, this.scene.luminance_weights) : null;
  }

  /** @param {number} x @param {number} y */
  hover(x, y) {
    const [u, v] = [x / this.box.width, y / this.box.height];
    this.pointer = x >= 0 && y >= 0 && u < 1 && v < 1 ? { u, v } : null;
    this.read();
  }

  /** Shows the value under the pointer. */
  read() {
    const { pointer, display } = this;
    const sample = pointer && this.sample(pointer.u, pointer.v);
    const truth = pointer && this.isComparing() && display.truth && this.scene ? sampleAt(display.truth, null, pointer.u, pointer.v, this.scene.luminance_weights) : null;
    fillReadout(byId("readout"), this, sample, truth);
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event */
  clicked(x, y, event) {
    this.canvas.focus();
    const camera = this.state.showCameras && this.scene ? Overlay.cameraAt(this.scene.cameras, this.lens(this.box.width, this.box.height), x, y) : null;
    if (camera) return this.standAt(camera.name);
    if (event.button === 0 && event.detail < 2) this.pinAt(x / this.box.width, y / this.box.height);
  }

  /** @param {number} u @param {number} v */
  pinAt(u, v) {
    const sample = this.sample(u, v);
    if (!sample) return;
    this.pins = [...this.pins, sample].slice(-MAX_PINS);
    this.changed();
  }

  pinHere() {
    if (this.pointer) this.pinAt(this.pointer.u, this.pointer.v);
  }

  /** @param {number} index */
  unpin(index) {
    this.pins = this.pins.filter((_, i) => i !== index);
    this.changed();
  }

  apart() {
    return distanceOf(this.pins);
  }

  /** A length in metres where the scale is known, else in world units. @param {number} units */
  lengthText(units) {
    return this.state.metres > 0 ? `${text(units * this.state.metres)} m` : `${text(units)} units`;
  }

  /** @param {number} x @param {number} y */
  pivot(x, y) {
    // The clicks before pinned a value, which is not what a double click asks for.
    if (this.pins.length) this.unpin(this.pins.length - 1);
    const sample = this.sample(x / this.box.width, y / this.box.height);
    if (!sample?.position || !this.shown) return;
    this.state.pivot = sample.position;
    this.state.mode = "orbit";
    this.state.axes = looking(sub(sample.position, this.state.eye), this.controls.up);
    this.controls.left();
  }

  /** Takes hold of the wipe if it is near, and moves it. @param {number} x */
  wiped(x) {
    if (!this.isComparing() || this.state.compare !== "wipe") return false;
    const at = x / this.box.width;
    if (!this.controls.wiping && Math.abs(at - this.state.wipe) * this.box.width > 14) return false;
    this.set({ wipe: Math.min(1, Math.max(0, at)) });
    return true;
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const target = /** @type {HTMLElement} */ (event.target);
    if (event.ctrlKey || event.metaKey || event.altKey || target.closest("input[type=number], input[type=text], textarea, select")) return;
    const key = KEYS.find(({ keys }) => keys.includes(event.key.toLowerCase()));
    const dialog = /** @type {HTMLDialogElement} */ (document.getElementById("help"));
    if (!key || (dialog.open && event.key !== "?")) return;
    event.preventDefault();
    key.act(this);
  }

  togglePanel() {
    const isBare = document.body.classList.toggle("bare");
    byId("toggle-panel").setAttribute("aria-pressed", String(!isBare));
  }

  toggleHelp() {
    const dialog = /** @type {HTMLDialogElement} */ (document.getElementById("help"));
    if (dialog.open) dialog.close();
    else dialog.showModal();
  }

  saveExr() {
    const { width, height, edit } = this.want();
    download(address(this.lens(width, height), edit, "&channels=rgb,alpha,depth", "/api/frame.exr"), "view.exr");
  }

  savePng() {
    this.display.draw(this.drawn(), false);
    this.canvas.toBlob((blob) => blob && download(URL.createObjectURL(blob), "view.png"), "image/png");
  }

  async copyLink() {
    history.replaceState(null, "", location.pathname + toHash(this.state));
    await navigator.clipboard?.writeText(location.href).catch(() => undefined);
  }

  /** Shows what is wrong; nothing once it is right again. @param {string} message */
  complain(message) {
    const element = byId("message");
    element.hidden = message === "";
    element.textContent = message;
  }

}

/** @param {string} url @param {string} name */
function download(url, name) {
  const link = Object.assign(document.createElement("a"), { href: url, download: name });
  link.click();
}

try {
  const viewer = new Viewer();
  // For scripts in the console of the browser, and tests.
  Object.assign(window, { luxel: viewer });
  void viewer.start();
} catch (error) {
  const message = byId("message");
  message.hidden = false;
  message.textContent = /** @type {Error} */ (error).message;
}
