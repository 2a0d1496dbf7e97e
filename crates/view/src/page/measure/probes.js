/** Values under the pointer and pinned ones, the distance of the last two, the scale of the scene. */

import { byId } from "../dom/elements.js";
import { project } from "../math/lens.js";
import { length, sub } from "../math/vectors.js";
import { MIDDLE_GREY, sampleAt, signed, text } from "../picture/pixels.js";
import { ev100, luminanceText, pointText } from "../picture/units.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../picture/pixels.js").Sample} Sample */
/** @typedef {import("../viewer/overlay.js").Overlay} Overlay */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** Difference of depths up to which a pin is on the surface that the picture shows. */
const SAME_DEPTH = 0.02;
/** Probes that are kept. */
const MAX_PINS = 20;

/** @param {Viewer} viewer @param {Sample} sample */
function stopsOf(viewer, sample) {
  const gain = 2 ** viewer.state.exposure / (viewer.scene?.radiance_scale ?? 1);
  return Math.log2((sample.luminance * gain) / MIDDLE_GREY);
}

/** Rows of a sample: name and value. @param {Viewer} viewer @param {Sample} sample @returns {[string, string][]} */
function rows(viewer, sample) {
  /** @type {[string, string][]} */
  const all = [
    ["RGB", sample.radiance.map(text).join("  ")],
    ["luminance", luminanceText(viewer, sample.luminance)],
    ["stops", signed(stopsOf(viewer, sample), 2)],
  ];
  const ev = ev100(viewer, sample.luminance);
  if (ev !== null) all.push(["EV100", signed(ev, 2)]);
  if (sample.depth !== null) all.push(["depth", viewer.lengthText(sample.depth)]);
  if (sample.position) all.push(["position", pointText(viewer, sample.position).join("  ")]);
  return all;
}

/** @param {HTMLElement} element @param {Viewer} viewer @param {Sample | null} sample @param {Sample | null} truth */
function fillReadout(element, viewer, sample, truth) {
  element.hidden = sample === null;
  if (!sample) return;
  const all = [/** @type {[string, string]} */ (["pixel", `${sample.x}, ${sample.y}`]), ...rows(viewer, sample)];
  if (truth) {
    const name = viewer.comparison?.otherName() ?? "ground truth";
    all.push([name, truth.radiance.map(text).join("  ")], ["luminance there", luminanceText(viewer, truth.luminance)]);
    if (viewer.comparison?.isMasked(truth)) all.push(["difference", "masked"]);
    else all.push(["difference", `${signed(Math.log2(sample.luminance / truth.luminance), 2)} stops, ${signed(100 * (sample.luminance / truth.luminance - 1), 1)} %`]);
  }
  element.replaceChildren(
    ...all.map(([name, value]) => {
      const item = document.createElement("span");
      item.append(Object.assign(document.createElement("b"), { textContent: name }), value);
      return item;
    }),
  );
}

/** A button for the light at a point. @param {Viewer} viewer @param {import("../math/vectors.js").Vec3} at */
function environmentButton(viewer, at) {
  const button = Object.assign(document.createElement("button"), { textContent: "light probe here", title: "The light that arrives here, as an environment map" });
  button.addEventListener("click", () => void viewer.environment?.place(at));
  return button;
}

/** Distance of the last two pins with a position, world units; null without them. @param {Sample[]} pins */
function distanceOf(pins) {
  const [b, a] = pins.filter((pin) => pin.position).slice(-2).map((pin) => pin.position);
  return a && b ? length(sub(a, b)) : null;
}

/** @implements {Part} */
export class Probes {
  /** @type {Sample[]} */ pins = [];
  /** Place of the pointer in the picture, 0 to 1. @type {{ u: number, v: number } | null} */ pointer = null;

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
  }

  /** @param {number} x @param {number} y */
  hovered(x, y) {
    const { box } = this.viewer;
    const [u, v] = [x / box.width, y / box.height];
    this.pointer = x >= 0 && y >= 0 && u < 1 && v < 1 ? { u, v } : null;
    this.read();
  }

  /** Shows the value under the pointer. */
  read() {
    const { pointer, viewer } = this;
    const { scene, display } = viewer;
    const sample = pointer && viewer.sample(pointer.u, pointer.v);
    const truth = pointer && scene && display.truth && viewer.comparison?.isOn() && viewer.comparison.kind() !== "eye" ? viewer.comparison.sample(pointer.u, pointer.v) : null;
    fillReadout(byId("readout"), viewer, sample, truth);
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event */
  clicked(x, y, event) {
    if (event.button !== 0 || event.detail >= 2) return false;
    this.pinAt(x / this.viewer.box.width, y / this.viewer.box.height);
    return true;
  }

  /** @param {number} u @param {number} v */
  pinAt(u, v) {
    this.viewer.clicks.at(u, v, this.pin);
  }

  /** Pins a value. @param {Sample} sample */
  pin = (sample) => {
    this.pins = [...this.pins, sample].slice(-MAX_PINS);
    this.viewer.changed();
  };

  /** Reads pins again that the picture shows, since an edit or a training may have changed them. @param {import("../scene/stream.js").Shown} shown */
  taken(shown) {
    const { scene } = this.viewer;
    if (!shown.full || !shown.frame.depth || !scene) return;
    const { width, height } = shown.frame.head;
    this.pins = this.pins.map((pin) => {
      const place = pin.position && project(shown.lens, pin.position);
      const now = place ? sampleAt(shown.frame, shown.lens, place.x / width, place.y / height, scene.luminance_weights) : null;
      // Hidden, or moved: the pin keeps what it had.
      if (!place || !now?.depth || Math.abs(now.depth / place.depth - 1) > SAME_DEPTH) return pin;
      return { ...pin, radiance: now.radiance, luminance: now.luminance, alpha: now.alpha };
    });
    if (this.pins.length) this.viewer.needsReflect = this.viewer.needsMarks = true;
  }

  pinHere() {
    if (this.pointer) this.pinAt(this.pointer.u, this.pointer.v);
  }

  /** @param {number} index */
  unpin(index) {
    this.pins = this.pins.filter((_, i) => i !== index);
    this.viewer.changed();
  }

  /** Takes back the last pin, or the click that waits to be one. */
  unpinLast() {
    if (!this.viewer.clicks.takeBack(this.pin) && this.pins.length) this.unpin(this.pins.length - 1);
  }

  /** Distance of the last two pins with a position, world units; null without them. */
  apart() {
    return distanceOf(this.pins);
  }

  /** A length in metres where the scale is known, else in world units. @param {number} units */
  lengthText(units) {
    const { metres } = this.viewer.state;
    return metres > 0 ? `${text(units * metres)} m` : `${text(units)} units`;
  }

  /** @param {Overlay} overlay @param {Lens} lens */
  draw(overlay, lens) {
    this.pins.forEach((pin, i) => pin.position && overlay.pin(pin.position, lens, `${i + 1}  ${text(pin.luminance)}`));
    const apart = this.apart();
    const [b, a] = this.pins.filter((pin) => pin.position).slice(-2);
    if (apart !== null && a?.position && b?.position) overlay.ruler(a.position, b.position, lens, this.lengthText(apart));
    this.read();
  }

  reflect() {
    const { viewer } = this;
    byId("pins").replaceChildren(
      ...this.pins.map((pin, i) => {
        const item = document.createElement("li");
        const [name, values] = [document.createElement("span"), document.createElement("div")];
        name.textContent = `${i + 1}`;
        for (const [label, value] of rows(viewer, pin)) values.append(`${label} ${value}`, document.createElement("br"));
        const remove = Object.assign(document.createElement("button"), { textContent: "×", title: "Remove this probe" });
        remove.setAttribute("aria-label", `Remove probe ${i + 1}`);
        remove.addEventListener("click", () => this.unpin(i));
        if (pin.position && viewer.environment) values.append(environmentButton(viewer, pin.position));
        item.append(name, values, remove);
        return item;
      }),
    );
    this.showDistance();
  }

  showDistance() {
    const { viewer } = this;
    byId("distance").replaceChildren();
    const apart = this.apart();
    if (apart === null) return;
    const row = document.createElement("div");
    row.className = "row";
    const scale = Object.assign(document.createElement("button"), { textContent: "this is 1 m", title: "Sets the length of a world unit, by which lengths are shown in metres" });
    scale.addEventListener("click", () => viewer.set({ metres: 1 / apart }));
    row.append(`distance ${this.lengthText(apart)}`, scale);
    if (viewer.state.metres > 0) {
      const forget = Object.assign(document.createElement("button"), { textContent: "world units" });
      forget.addEventListener("click", () => viewer.set({ metres: 0 }));
      row.append(forget);
    }
    byId("distance").append(row);
  }
}
