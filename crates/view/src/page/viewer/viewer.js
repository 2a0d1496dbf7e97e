/** The core of the viewer: the state, the scene, the picture, and the loop that keeps them together. */

import { Controls } from "../camera/controls.js";
import { overview, sizeOf } from "../camera/places.js";
import { COMPARES, CURVES, LAYERS } from "../display/choices.js";
import { Display } from "../display/display.js";
import { lowestBand } from "../display/falsecolor.js";
import { byId } from "../dom/elements.js";
import { Messages } from "../dom/messages.js";
import { Pace } from "../dom/pace.js";
import { aside, choiceOf, lensOf, lensOfView, poseOf, unproject } from "../math/lens.js";
import { add, looking, sub, times, unit } from "../math/vectors.js";
import { sampleAt } from "../picture/pixels.js";
import { luminanceFactor } from "../picture/units.js";
import { Stream } from "../scene/stream.js";
import { Clicks } from "./clicks.js";
import { KEYS, next } from "./help.js";
import { Overlay } from "./overlay.js";
import { applyHash, MODES, State, toHash } from "./state.js";

/** @typedef {import("./part.js").Grip} Grip */
/** @typedef {import("./part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Scene} Scene */
/** @typedef {import("../scene/scene.js").Status} Status */
/** @typedef {import("../scene/scene.js").ViewCamera} ViewCamera */
/** @typedef {import("../scene/source.js").Source} Source */
/** @typedef {import("../scene/stream.js").Shown} Shown */

/** Least time between pictures of a scene that is being trained, ms. */
const FOLLOW_MS = 2000;
/** Times of a full picture's own latency that pass before the next one follows: training goes on. */
const FOLLOW_LATENCIES = 40;
/** Least time between two states of a training that are shown to nobody in particular, ms. */
const TELL_MS = 2000;
/** Time between two movements up to which they are one, ms. */
const APART_MS = 500;
/** Time after which the first hint goes, ms. */
const HINT_MS = 12000;
/** Least time between two times that the controls follow a movement, ms. */
const REFLECT_MS = 120;
/** Time after the last change at which the address of the page is set, ms. */
const ADDRESS_MS = 400;

export class Viewer {
  state = new State();
  /** @type {Part[]} */ parts = [];
  messages = new Messages();
  clicks = new Clicks(this);
  /** @type {import("../measure/comparison.js").Comparison | null} */ comparison = null;
  /** @type {import("../display/exposure.js").Exposure | null} */ exposure = null;
  /** @type {import("../measure/probes.js").Probes | null} */ probes = null;
  /** @type {import("../measure/radiometry.js").Radiometry | null} */ radiometry = null;
  /** @type {import("../measure/environment.js").EnvironmentPanel | null} */ environment = null;
  /** @type {import("../object/placed.js").Placed | null} */ placed = null;
  /** @type {import("../camera/aperture.js").AperturePanel | null} */ aperture = null;
  /** @type {import("../path/path.js").PathPanel | null} */ path = null;
  /** @type {import("./saving.js").Saving | null} */ saving = null;
  /** @type {import("../training/training.js").TrainingPanel | null} */ training = null;
  /** @type {Scene | null} */ scene = null;
  /** @type {Shown | null} */ shown = null;
  /** Size and place of the picture on the screen. */ box = { left: 0, top: 0, width: 1, height: 1 };
  /** Whether the pointer is in the left one of two pictures. */ isLeft = false;
  /** Size of the picture in pixels of the screen. */ dots = { width: 1, height: 1 };
  /** The part that used the last click, of a double click the first. @type {Part | undefined} */ clickUser = undefined;
  version = 0;
  followedAt = 0;
  /** Whether the picture is to be drawn again. */ needsDraw = true;
  /** Whether the marks over the picture are to be drawn again. */ needsMarks = true;
  /** Whether the controls are to show the state again. */ needsReflect = true;
  reflectedAt = 0;
  saveAt = 0;
  /** Time at which a state of the training was last shown, and what it was. */ toldAt = -Infinity;
  toldFlags = "";
  /** The newest state, if it was not shown yet. @type {Status | null} */ untold = null;
  /** @type {Pace | null} */ pace = null;

  /** @param {Source} source */
  constructor(source) {
    this.source = source;
    this.canvas = /** @type {HTMLCanvasElement} */ (document.getElementById("picture"));
    this.display = new Display(this.canvas);
    this.overlay = new Overlay(/** @type {HTMLCanvasElement} */ (document.getElementById("overlay")));
    this.stream = new Stream(source, (shown) => this.take(shown), (error) => this.messages.set("picture", error?.message ?? ""));
    this.controls = new Controls(this.canvas, this.state, {
      moved: () => this.moved(),
      clicked: (x, y, event) => this.clicked(this.column(x), y, event),
      pivoted: (x, y) => this.pivot(this.column(x), y),
      grabbed: (x, y, event) => this.grab(this.column(x), y, event),
      hovered: (x, y) => this.parts.forEach((part) => part.hovered?.(this.column(x), y)),
    });
    this.canvas.addEventListener("pointerleave", () => this.parts.forEach((part) => part.hovered?.(-1, -1)));
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("resize", () => (this.needsDraw = true));
    addEventListener("hashchange", () => {
      this.readAddress();
      this.changed();
    });
    new ResizeObserver(() => (this.needsDraw = true)).observe(byId("stage"));
    for (const kind of ["pointerdown", "keydown", "wheel"]) addEventListener(kind, () => byId("hint").classList.add("gone"), { passive: true });
    setTimeout(() => byId("hint").classList.add("gone"), HINT_MS);
    // On a phone the picture comes first.
    if (matchMedia("(max-width: 700px)").matches) this.togglePanel();
  }

  async start() {
    this.source.listen({ state: (status) => this.follow(status), lost: () => this.lost(), again: () => void this.reconnected() });
    for (;;) {
      try {
        this.setScene(await this.source.scene());
        this.messages.set("connection", "");
        break;
      } catch (error) {
        this.messages.set("connection", /** @type {Error} */ (error).message);
        await new Promise((resolve) => setTimeout(resolve, 1000));
      }
    }
    this.pace = new Pace((now, seconds) => Boolean(this.frame(now, seconds)));
  }

  /** @param {Status} status */
  follow(status) {
    this.version = status.version;
    this.untold = status;
    this.tell();
  }

  /** Shows the newest state, if that is due: each change of the page costs the training beside it a drawing of the window. */
  tell() {
    const { untold: status } = this;
    if (!status) return;
    const now = performance.now();
    const flags = JSON.stringify([status.training?.is_paused, status.training?.is_finished]);
    if (flags === this.toldFlags && !this.pace?.isAwake() && now - this.toldAt < TELL_MS) return;
    [this.toldAt, this.toldFlags, this.untold] = [now, flags, null];
    this.facts(status.splats);
    for (const part of this.parts) part.followed?.(status);
  }

  /** Has the newest picture of a training come, from where its cameras are by now. */
  async catchUp() {
    await this.training?.moveCameras();
    this.stream.invalidate();
  }

  /** Moves the cameras, and whoever stands at one with it. @param {ViewCamera[]} cameras */
  moveCameras(cameras) {
    if (!this.scene) return;
    this.scene.cameras = cameras;
    const camera = this.viewCamera();
    if (camera) {
      Object.assign(this.state, poseOf(camera), choiceOf(camera));
      this.stream.jump();
    }
    this.changed();
  }

  lost() {
    this.messages.set("connection", this.training?.isOver() ? "The training has ended. Look at its scene with luxel view." : "No connection to luxel; trying again.");
  }

  async reconnected() {
    try {
      this.setScene(await this.source.scene(), true);
      this.stream.invalidate();
      this.messages.set("connection", "");
    } catch (error) {
      this.messages.set("connection", /** @type {Error} */ (error).message);
    }
  }

  /** @param {Scene} scene @param {boolean} [isAgain] */
  setScene(scene, isAgain = false) {
    this.scene = scene;
    this.display.scene = scene;
    this.version = scene.version;
    this.controls.size = Math.max(sizeOf(scene), 1e-6);
    this.controls.up = this.up();
    if (!isAgain) {
      this.state.usualCurve = this.state.curve = scene.display ? "ocio" : scene.is_display ? "none" : "agx";
      if (!this.readAddress()) this.home();
      else if (this.state.view) this.standAt(this.state.view);
    }
    this.facts(scene.splats);
    for (const part of this.parts) part.sceneSet?.(scene, isAgain);
    if (scene.training) this.follow({ version: scene.version, splats: scene.splats, cameras: scene.cameras_version, training: scene.training });
    this.changed();
  }

  /** Takes what the page's address states. Returns whether it has a camera. */
  readAddress() {
    const hasCamera = applyHash(this.state, location.hash);
    if (!this.source.hasLenses) this.state.projection = "pinhole";
    if (this.state.curve === "ocio" && !this.scene?.display) this.state.curve = this.state.usualCurve;
    return hasCamera;
  }

  /** Direction that is up in the world: the user's, else the data set's. */
  up() {
    const chosen = this.state.upAxis.split(",").map(Number);
    const isUsable = chosen.length === 3 && chosen.every(Number.isFinite) && chosen.some((v) => v !== 0);
    return isUsable ? unit(/** @type {import("../math/vectors.js").Vec3} */ (chosen)) : (this.scene?.up ?? [0, 1, 0]);
  }

  /** How splats are drawn now. @returns {import("../scene/variant.js").Variant} */
  variant() {
    const { splats, splatSize, splatOpacity, near, far } = this.state;
    return { scene: 0, splats, size: splatSize, opacity: splatOpacity, near, far, ...this.aperture?.chosen() };
  }

  /** @param {number} splats */
  facts(splats) {
    const edits = this.scene?.edits.length ? ` · ${this.scene.edits.length} edits` : "";
    const text = `${splats.toLocaleString("en")} splats · ${this.scene?.color_space}${edits}`;
    if (byId("facts").textContent !== text) byId("facts").textContent = text;
  }

  /** The camera of the data set in whose place the viewer stands. @returns {ViewCamera | undefined} */
  viewCamera() {
    return this.scene?.cameras.find((camera) => camera.name === this.state.view);
  }

  /** Changes what is chosen. @param {Partial<State>} change */
  set(change) {
    Object.assign(this.state, change);
    if ("compare" in change && change.compare !== "off" && !this.state.view && this.comparison?.kind() === "truth") this.standAtNext(0);
    this.changed();
  }

  /** Goes on to the next choice. @param {"curve" | "layer" | "compare" | "mode"} field */
  cycle(field) {
    if (field === "curve") this.set({ curve: next(CURVES.filter((curve) => curve !== "ocio" || this.scene?.display), this.state.curve) });
    else if (field === "layer") this.set({ layer: next(LAYERS, this.state.layer) });
    else if (field === "mode") this.set({ mode: next(MODES, this.state.mode) });
    else this.set({ compare: next(COMPARES, this.state.compare) });
  }

  changed() {
    this.needsDraw = this.needsReflect = true;
    this.saveAt = performance.now() + ADDRESS_MS;
    this.pace?.wake();
  }

  /** The camera has moved: the picture of it is on its way. */
  moved() {
    this.needsMarks = this.needsReflect = true;
    this.saveAt = performance.now() + ADDRESS_MS;
    this.pace?.wake();
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
    Object.assign(this.state, { eye, axes, view: name, ...choiceOf(camera) });
    // Until the picture tells the depth in its middle.
    this.state.pivot = add(eye, times(axes.back, -this.controls.size));
    this.changed();
  }

  /** @param {number} by */
  standAtNext(by) {
    const cameras = this.scene?.cameras ?? [];
    if (cameras.length === 0) return;
    const now = cameras.findIndex((camera) => camera.name === this.state.view);
    this.standAt(cameras[now < 0 ? 0 : (now + by + cameras.length) % cameras.length].name);
  }

  /** Pictures side by side, of the same camera: 2, or 1. */
  panes() {
    return this.state.compare === "beside" && (this.comparison?.canCompare() ?? false) ? 2 : 1;
  }

  /** A column of the screen in the picture that it belongs to, which is the one that values are read from. @param {number} x */
  column(x) {
    this.isLeft = this.panes() > 1 && x < this.box.width;
    return this.panes() > 1 && x >= this.box.width ? x - this.box.width : x;
  }

  /** Size and place of the picture: that of the camera where the viewer stands at one. */
  layout() {
    const stage = byId("stage");
    const [w, h] = [stage.clientWidth, stage.clientHeight];
    const view = this.viewCamera();
    const panes = this.panes();
    const room = w / panes;
    const aspect = view ? view.w / view.h : this.state.projection === "equirectangular" ? 2 : room / Math.max(1, h);
    const width = Math.max(1, Math.round(Math.min(room, h * aspect)));
    const height = Math.max(1, Math.round(Math.min(h, room / aspect)));
    this.box = { left: Math.round((w - panes * width) / 2), top: Math.round((h - height) / 2), width, height };
    const dots = Math.min(devicePixelRatio, 2);
    this.dots = { width: Math.round(width * dots), height: Math.round(height * dots) };
    // A small picture of a movement is enlarged by the browser, which costs less than the shader.
    const { shown } = this;
    const isSmall = panes === 1 && shown && !shown.full && shown.frame.head.width < this.dots.width;
    const [cw, ch] = isSmall ? [shown.frame.head.width, shown.frame.head.height] : [panes * this.dots.width, this.dots.height];
    if (this.canvas.width !== cw || this.canvas.height !== ch) {
      [this.canvas.width, this.canvas.height] = [cw, ch];
      this.needsDraw = true;
    }
    for (const element of [this.canvas, this.overlay.canvas]) {
      Object.assign(element.style, { left: `${this.box.left}px`, top: `${this.box.top}px`, width: `${panes * width}px`, height: `${height}px` });
    }
  }

  /** The lens of a picture of this size. @param {number} width @param {number} height */
  lens(width, height) {
    const view = this.viewCamera();
    return aside(view ? lensOfView(view, width, height) : lensOf(this.state, width, height), this.comparison?.rightEye() ?? 0);
  }

  /** The picture that is wanted now. */
  want() {
    const view = this.viewCamera();
    // Beside its image, the picture of a camera has the same pixels, so that both compare.
    const paired = this.state.compare === "off" || this.comparison?.kind() !== "truth" ? undefined : view;
    const right = this.comparison?.rightEye() ?? 0;
    const [width, height] = paired ? [paired.w, paired.h] : [this.dots.width, this.dots.height];
    const { eye, axes, projection, fov, circle, edit } = this.state;
    const variant = this.variant();
    const key = JSON.stringify([eye, axes, projection, fov, circle, this.state.view, width, height, edit, variant, right]);
    const lens = (/** @type {number} */ w, /** @type {number} */ h) => aside(view ? lensOfView(view, w, h) : lensOf({ eye, axes, projection, fov, circle }, w, h), right);
    const layers = this.state.layer !== "radiance" && this.state.layer !== "stops";
    return { key, layers, lens, width, height, edit, variant };
  }

  /** Does what is due; returns whether more is, soon. @param {number} now @param {number} seconds */
  frame(now, seconds) {
    this.controls.step(seconds);
    this.layout();
    const isBehind = this.shown && (this.version !== this.shown.frame.head.version || this.training?.hasMoved());
    if (isBehind && now - this.followedAt > Math.max(FOLLOW_MS, FOLLOW_LATENCIES * this.stream.fullLatency)) {
      this.followedAt = now;
      void this.catchUp();
    }
    this.tell();
    this.stream.tick(this.want(), now);
    this.clicks.step();
    for (const part of this.parts) part.step?.(now, seconds);
    if (this.needsReflect && (this.needsDraw || now - this.reflectedAt > REFLECT_MS)) {
      this.needsReflect = false;
      this.reflectedAt = now;
      for (const part of this.parts) part.reflect?.();
    }
    if (this.needsDraw || this.comparison?.isFlickering()) {
      this.needsDraw = false;
      this.needsMarks = true;
      this.draw(now);
    }
    if (this.needsMarks) {
      this.needsMarks = false;
      this.drawMarks();
    }
    const { shown } = this;
    const size = shown ? `${shown.frame.head.width}×${shown.frame.head.height}` : "";
    const rate = shown ? `${this.stream.rate(performance.now())} fps · ${size} · ${shown.latency.toFixed(0)} ms` : "";
    if (byId("rate").textContent !== rate) byId("rate").textContent = rate;
    if (this.saveAt && now > this.saveAt) {
      this.saveAt = 0;
      history.replaceState(null, "", location.pathname + toHash(this.state, this.controls.size));
    }
    const { moving, full, movedAt } = this.stream;
    const isShowing = this.needsDraw || this.needsMarks || this.needsReflect || this.comparison?.isFlickering();
    return moving > 0 || full !== null || now - movedAt < APART_MS || isShowing || this.path?.playing || this.controls.keys.size > 0;
  }

  /** @param {number} now */
  draw(now) {
    this.display.values = { factor: luminanceFactor(this), lowestBand: lowestBand(this) };
    this.display.draw(this.comparison?.drawn() ?? this.state, this.comparison?.showsTruth(now) ?? false);
  }

  /** Draws the marks over the picture. */
  drawMarks() {
    const { width, height } = this.box;
    const lens = this.lens(width, height);
    const panes = this.panes();
    this.overlay.clear(width * panes, height);
    for (let pane = 0; pane < panes; pane++) {
      this.overlay.begin(pane * width, width, height);
      const own = pane + 1 < panes ? aside(lens, -2 * (this.comparison?.rightEye() ?? 0)) : lens;
      if (this.state.showCameras && this.scene) this.overlay.cameras(this.scene.cameras, own, this.controls.size * 0.06, this.state.view);
      for (const part of this.parts) part.draw?.(this.overlay, own);
    }
    this.overlay.end();
  }

  /** @param {Shown} shown */
  take(shown) {
    const isFirst = this.shown === null;
    this.shown = shown;
    for (const part of this.parts) part.altered?.(shown);
    this.display.show(shown.frame, shown.full);
    if (shown.frame.depth) this.display.lens = shown.lens;
    if (isFirst) document.body.dataset.ready = "true";
    if (shown.full) {
      this.settle(shown);
      // Numbers of whole pictures, such as the error, are shown beside it.
      this.needsReflect = true;
    }
    for (const part of this.parts) part.taken?.(shown);
    this.needsDraw = true;
    this.pace?.wake();
  }

  /** Sets the pivot of a camera that was just stood at to what is in its middle. @param {Shown} shown */
  settle(shown) {
    if (!this.scene || !this.state.view) return;
    const sample = sampleAt(shown.frame, shown.lens, 0.5, 0.5, this.scene.luminance_weights);
    if (sample?.position) this.state.pivot = sample.position;
  }

  /** What the picture holds at a place, 0 to 1 each. @param {number} u @param {number} v */
  sample(u, v) {
    const shown = this.isLeft && this.comparison?.rightEye() ? this.comparison.other : this.shown;
    return shown && this.scene ? sampleAt(shown.frame, shown.lens, u, v, this.scene.luminance_weights) : null;
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event @returns {Grip | null} */
  grab(x, y, event) {
    for (const part of this.parts) {
      const grip = part.grab?.(x, y, event);
      if (grip) return grip;
    }
    return null;
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event */
  clicked(x, y, event) {
    this.canvas.focus();
    const camera = this.state.showCameras && this.scene ? Overlay.cameraAt(this.scene.cameras, this.lens(this.box.width, this.box.height), x, y) : null;
    if (camera) this.standAt(camera.name);
    const user = camera ? undefined : this.parts.find((part) => part.clicked?.(x, y, event));
    if (event.detail < 2) this.clickUser = user;
  }

  /** A length in metres where the scale is known, else in world units. @param {number} units */
  lengthText(units) {
    return this.probes?.lengthText(units) ?? String(units);
  }

  /** @param {number} x @param {number} y */
  pivot(x, y) {
    // The click before pinned a value, which is not what a double click asks for.
    if (this.clickUser && this.clickUser === this.probes) this.probes.unpinLast();
    const onMesh = this.onMesh(x, y);
    if (onMesh) return this.orbit(onMesh);
    this.clicks.at(x / this.box.width, y / this.box.height, ({ position }) => {
      if (!position) return this.messages.notice("There is nothing to orbit about; double-click a surface.");
      this.orbit(position);
    });
  }

  /** Makes a point the middle of the picture and of the orbit. @param {import("../math/vectors.js").Vec3} pivot */
  orbit(pivot) {
    this.state.pivot = pivot;
    this.state.mode = "orbit";
    this.state.axes = looking(sub(pivot, this.state.eye), this.controls.up);
    this.controls.left();
  }

  /** The place of the proxy mesh that the picture shows at a pixel of the screen, if there is a mesh. @param {number} x @param {number} y */
  onMesh(x, y) {
    const lens = lensOf(this.state, Math.max(1, this.box.width), Math.max(1, this.box.height));
    const place = this.controls.proxy && unproject(lens, x, y, 1);
    if (!place) return null;
    const ray = unit(sub(place, lens.eye));
    const away = this.controls.proxy?.distance(lens.eye, ray) ?? Infinity;
    return away < Infinity ? add(lens.eye, times(ray, away)) : null;
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
    this.needsReflect = true;
  }

  toggleHelp() {
    const dialog = /** @type {HTMLDialogElement} */ (document.getElementById("help"));
    if (dialog.open) dialog.close();
    else dialog.showModal();
  }
}
