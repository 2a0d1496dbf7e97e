/** Sliders for the lights of a mix: they write one entry of the stack, `light N:FACTOR` for each light that is changed. */

import { byId } from "../dom/elements.js";
import { entry } from "./stack.js";

/** @typedef {import("./edits.js").Edits} Edits */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Scene} Scene */
/** @typedef {import("./stack.js").Entry} Entry */

/** Ends of the sliders, stops; at the lower end a light is off. */
const [LOW, HIGH] = [-8, 4];

/** Whether an entry is the one of the sliders: factors of lights of the whole scene. @param {Entry} known */
const isOfLights = ({ kind, where, maps }) => kind === "light" && where === "all" && maps.length > 0 && maps.every(({ name }) => name === "light");

/** Number and factor of a map. @param {string} value */
const parts = (value) => value.split(":").map(Number);

/** @implements {Part} */
export class Lights {
  /** @type {{ range: HTMLInputElement, number: HTMLInputElement }[]} */ rows = [];

  /** @param {Edits} edits */
  constructor(edits) {
    this.edits = edits;
  }

  /** @param {Scene} scene */
  sceneSet(scene) {
    const count = scene.lights > 1 && !scene.training ? scene.lights : 0;
    byId("light-rows").hidden = count === 0;
    if (count === this.rows.length) return;
    this.rows = Array.from({ length: count }, (_, i) => this.row(i + 1));
    byId("light-rows").replaceChildren(...this.rows.map(({ range, number }, i) => {
      const row = Object.assign(document.createElement("div"), { className: "row" });
      row.append(Object.assign(document.createElement("span"), { textContent: `Light ${i + 1}` }), range, number);
      return row;
    }));
    this.reflect();
  }

  /** @param {number} light */
  row(light) {
    const label = `Factor on light ${light} of the mix`;
    const make = (/** @type {{ type: string, min: string, max?: string, step: string }} */ fields) => {
      const input = Object.assign(document.createElement("input"), { title: label, ...fields });
      input.setAttribute("aria-label", fields.type === "number" ? `${label}, as a number` : label);
      return input;
    };
    const range = make({ type: "range", min: String(LOW), max: String(HIGH), step: "0.05" });
    const number = make({ type: "number", min: "0", step: "any" });
    range.addEventListener("input", () => this.put(light, range.valueAsNumber <= LOW ? 0 : 2 ** range.valueAsNumber));
    number.addEventListener("input", () => this.put(light, number.valueAsNumber));
    return { range, number };
  }

  /** Factors by the number of the light, of the entry of the sliders. */
  factors() {
    const known = this.edits.entries.find((entry) => entry.on && isOfLights(entry));
    const factors = this.rows.map(() => 1);
    for (const [light, factor] of known?.maps.map(({ value }) => parts(value)) ?? []) factors[light - 1] *= factor;
    return factors;
  }

  /** @param {number} light @param {number} factor */
  put(light, factor) {
    if (!Number.isFinite(factor) || factor < 0) return;
    const { edits } = this;
    const factors = this.factors();
    factors[light - 1] = factor;
    const changed = factors.map((factor, i) => ({ name: "light", value: `${i + 1}:${Number(factor.toPrecision(4))}`, factor })).filter(({ factor }) => factor !== 1);
    const maps = changed.map(({ name, value }) => ({ name, value }));
    const at = edits.entries.findIndex((entry) => entry.on && isOfLights(entry));
    const made = maps.length ? [entry({ maps })] : [];
    const entries = at < 0 ? [...made, ...edits.entries] : [...edits.entries.slice(0, at), ...made, ...edits.entries.slice(at + 1)];
    // Entries behind a new or a removed one move.
    const shift = entries.length - edits.entries.length;
    edits.change(entries, edits.current > at || at < 0 ? (edits.current < 0 ? -1 : edits.current + shift) : edits.current, `lights ${light}`);
  }

  reflect() {
    this.factors().forEach((factor, i) => {
      const { range, number } = this.rows[i];
      if (document.activeElement !== range) range.value = String(factor > 0 ? Math.log2(factor) : LOW);
      if (document.activeElement !== number) number.value = String(Number(factor.toPrecision(4)));
    });
  }
}
