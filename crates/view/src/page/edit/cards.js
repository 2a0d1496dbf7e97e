/** The entries of the stack as cards with controls: selection, maps with sliders, order, switch. */

import { byId } from "../dom/elements.js";
import { formatTests, parseTests } from "./selection.js";

/** @typedef {import("./edits.js").Edits} Edits */
/** @typedef {import("./selection.js").Test} Test */
/** @typedef {import("./selection.js").Tests} Tests */
/** @typedef {import("./stack.js").Entry} Entry */
/** A number of a map: what it means, the ends of its slider, and whether the slider is of its logarithm to base 2. @typedef {{ what: string, low: number, high: number, step: number, fresh: string, log?: boolean }} Parameter */

/** @type {Parameter} */
const LEVEL = { what: "luminance L = R + G + B, units of the data set", low: -12, high: 12, step: 0.05, fresh: "1", log: true };
/** Maps of `luxel edit`, and the numbers of each, which ":" separates. @type {{ [name: string]: Parameter[] }} */
const MAPS = {
  stops: [{ what: "stops", low: -8, high: 8, step: 0.05, fresh: "-1" }],
  gain: [{ what: "factor", low: -8, high: 8, step: 0.05, fresh: "0.5", log: true }],
  power: [{ what: "exponent: below 1 less contrast", low: 0.1, high: 3, step: 0.01, fresh: "0.8" }],
  pivot: [LEVEL],
  "clamp-max": [LEVEL],
  "compress-above": [LEVEL, { what: "stops that become one", low: 0.5, high: 10, step: 0.1, fresh: "4" }],
  "lift-below": [LEVEL, { what: "part of the distance that goes, 0 to 1", low: -1, high: 0.99, step: 0.01, fresh: "0.5" }],
  light: [
    { what: "number of the light in the mix", low: 1, high: 8, step: 1, fresh: "1" },
    { what: "factor", low: -8, high: 8, step: 0.05, fresh: "0.5", log: true },
  ],
  curve: [],
};
const TITLES = { light: "Light", delete: "Delete", floaters: "Delete floaters", axes: "Up and origin" };

/** @template {keyof HTMLElementTagNameMap} K @param {K} kind @param {{ [name: string]: unknown }} fields @param {(Node | string)[]} children @returns {HTMLElementTagNameMap[K]} */
function make(kind, fields, ...children) {
  const element = document.createElement(kind);
  const { label, ...rest } = fields;
  Object.assign(element, rest);
  if (label) element.setAttribute("aria-label", String(label));
  element.append(...children);
  return element;
}

/** @param {string} text @param {string} title @param {() => void} act @param {boolean} [isOff] */
function button(text, title, act, isOff = false) {
  const element = make("button", { textContent: text, title, type: "button", disabled: isOff, label: title });
  element.addEventListener("click", act);
  return element;
}

export class EditCards {
  form = "";

  /** @param {Edits} edits */
  constructor(edits) {
    this.edits = edits;
  }

  /** Shows the entries; controls stay as they are, being dragged for example, while the form of the stack stays. */
  reflect() {
    const { entries, current } = this.edits;
    const tests = entries.map(({ where }) => parseTests(where)?.tests.length ?? -1);
    const form = JSON.stringify([entries.map(({ kind, maps }) => [kind, maps.map(({ name }) => name)]), tests, current]);
    const list = byId("edit-list");
    if (form !== this.form || !list.contains(document.activeElement)) {
      const focused = form === this.form ? null : /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.key;
      this.form = form;
      list.replaceChildren(...entries.map((entry, i) => this.card(entry, i)));
      if (focused) /** @type {HTMLElement | null} */ (list.querySelector(`[data-key="${CSS.escape(focused)}"]`))?.focus();
    }
    for (const element of list.querySelectorAll("[data-value]")) this.fill(/** @type {HTMLInputElement} */ (element));
  }

  /** Shows the value of a control that is not being typed into. @param {HTMLInputElement} element */
  fill(element) {
    const [i, map, part] = (element.dataset.value ?? "").split(" ").map(Number);
    const value = this.edits.entries[i]?.maps[map]?.value.split(":")[part];
    if (value === undefined || (element === document.activeElement && element.type !== "range")) return;
    const number = Number(value);
    element.value = element.type === "range" && element.dataset.log ? String(Math.log2(Math.max(number, 2 ** -20))) : element.type === "range" ? value : String(Number(number.toPrecision(5)));
  }

  /** @param {Entry} entry @param {number} i */
  card(entry, i) {
    const { edits } = this;
    const isCurrent = i === edits.current;
    const on = make("input", { type: "checkbox", checked: entry.on, title: "Switches this edit on and off", label: `Edit ${i + 1} is on` });
    on.addEventListener("change", () => edits.update(i, { on: on.checked }));
    const title = button(`${i + 1}. ${this.title(entry)}`, isCurrent ? "Closes this edit" : "Opens this edit", () => edits.change(edits.entries, isCurrent ? -1 : i, "open"));
    title.className = "edit-title";
    title.setAttribute("aria-expanded", String(isCurrent));
    const move = (/** @type {number} */ by) => {
      const entries = [...edits.entries];
      entries.splice(i + by, 0, ...entries.splice(i, 1));
      edits.change(entries, i + by);
    };
    const remove = () => edits.change(edits.entries.filter((_, k) => k !== i), Math.min(edits.current, edits.entries.length - 2));
    const head = make("div", { className: "row" }, on, title, button("↑", "Moves this edit up", () => move(-1), i === 0), button("↓", "Moves this edit down", () => move(1), i === edits.entries.length - 1), button("×", "Removes this edit", remove));
    const card = make("li", { className: "edit-card" }, head);
    card.dataset.on = String(entry.on);
    if (!isCurrent) return card;
    if (entry.kind === "light" || entry.kind === "delete") card.append(this.selection(entry, i));
    if (entry.kind === "light") card.append(...this.maps(entry, i));
    if (entry.kind === "axes") card.append(this.axes(entry, i));
    if (entry.kind === "floaters") card.append(make("div", { className: "quiet", textContent: "Splats that no view sees, that are far from all others, or large and faint." }));
    return card;
  }

  /** @param {Entry} entry */
  title(entry) {
    const maps = entry.maps.map(({ name, value }) => `${name} ${value}`).join(", ");
    const what = entry.kind === "light" ? maps || "no map" : TITLES[entry.kind];
    return `${what}${entry.where !== "all" && (entry.kind === "light" || entry.kind === "delete") ? ` · ${entry.where}` : ""}`;
  }

  /** The selection: tests of which all or any must hold, or its text where it is nested. @param {Entry} entry @param {number} i */
  selection(entry, i) {
    const { edits } = this;
    const found = parseTests(entry.where);
    const body = make("div", { className: "edit-selection" });
    const text = make("input", { type: "text", spellcheck: false, value: entry.where, title: "The selection in the language of luxel edit", label: "Selection" });
    text.dataset.key = `where ${i}`;
    text.addEventListener("change", () => edits.update(i, { where: text.value.trim() || "all" }));
    body.append(make("div", { className: "row" }, text));
    if (!found) return body;
    // The card stays while its values change: what it held when it was made is old.
    const now = () => parseTests(edits.entries[i].where) ?? found;
    const put = (/** @type {Partial<Tests>} */ change, /** @type {string} */ tag = "") => edits.update(i, { where: formatTests({ ...now(), ...change }) }, tag);
    found.tests.forEach((test, t) => {
      const replaced = (/** @type {Partial<Test>} */ change, /** @type {string} */ tag) => put({ tests: now().tests.map((known, k) => (k === t ? { ...known, ...change } : known)) }, tag);
      const not = make("input", { type: "checkbox", checked: test.not, title: "Selects what the test does not" });
      not.addEventListener("change", () => replaced({ not: not.checked }, ""));
      const soft = make("input", { type: "number", min: "0", step: "any", value: test.soft || "0", title: "Width of the soft edge: stops of luminance, degrees of hue, world units of shapes, share of a mask", label: `Soft edge of test ${t + 1}` });
      soft.dataset.key = `soft ${i} ${t}`;
      soft.addEventListener("input", () => replaced({ soft: soft.value }, `soft ${t}`));
      const name = make("span", { className: "edit-test number", textContent: test.body.replace(/^mask\(.*?([^/"]+)"?,.*$/, "mask $1"), title: test.body });
      body.append(make("div", { className: "row" }, make("label", { title: "Selects what the test does not" }, not, " not"), name, "~", soft, button("×", `Removes test ${t + 1}`, () => put({ tests: now().tests.filter((_, k) => k !== t) }))));
    });
    if (found.tests.length > 1) {
      const join = make("select", { title: "Whether a splat must pass all tests or any", label: "How tests are joined" }, make("option", { value: "and", textContent: "all of these (and)" }), make("option", { value: "or", textContent: "any of these (or)" }));
      join.value = found.join;
      join.addEventListener("change", () => put({ join: /** @type {"and" | "or"} */ (join.value) }));
      body.append(make("div", { className: "row" }, join));
    }
    return body;
  }

  /** @param {Entry} entry @param {number} i */
  maps(entry, i) {
    const { edits } = this;
    const now = () => edits.entries[i].maps;
    const change = (/** @type {number} */ m, /** @type {string} */ value, /** @type {string} */ tag) => edits.update(i, { maps: now().map((known, k) => (k === m ? { ...known, value } : known)) }, tag);
    const rows = entry.maps.map(({ name, value }, m) => {
      const row = make("div", { className: "edit-map" });
      const remove = button("×", `Removes ${name}`, () => edits.update(i, { maps: now().filter((_, k) => k !== m) }));
      row.append(make("div", { className: "row" }, make("span", { textContent: name }), make("span", { className: "space" }), remove));
      if (!MAPS[name]?.length) {
        const text = make("input", { type: "text", value, title: "Points luminance before:after, separated by commas", label: name });
        text.dataset.key = `text ${i} ${m}`;
        text.addEventListener("change", () => change(m, text.value.trim(), ""));
        row.append(make("div", { className: "row" }, text));
      }
      (MAPS[name] ?? []).forEach((parameter, p) => row.append(this.slider(parameter, { i, m, p, name }, change)));
      return row;
    });
    const add = make("select", { title: "Adds a map to this edit", label: "Add a map" }, make("option", { value: "", textContent: "add a map" }));
    for (const name of Object.keys(MAPS)) {
      if (name === "pivot" && entry.maps.at(-1)?.name !== "power") continue;
      if (name === "light" && !((edits.viewer.scene?.lights ?? 1) > 1)) continue;
      add.append(make("option", { value: name, textContent: name }));
    }
    add.addEventListener("change", () => {
      const value = add.value === "curve" ? "0.01:0.02,1:1,10:6" : (MAPS[add.value] ?? []).map(({ fresh }) => fresh).join(":");
      if (add.value) edits.update(i, { maps: [...now(), { name: add.value, value }] });
    });
    return [...rows, make("div", { className: "row" }, add)];
  }

  /** A slider and a number for the same value. @param {Parameter} parameter @param {{ i: number, m: number, p: number, name: string }} at @param {(m: number, value: string, tag: string) => void} change */
  slider(parameter, { i, m, p, name }, change) {
    const label = `${name}, ${parameter.what}`;
    const range = make("input", { type: "range", min: String(parameter.low), max: String(parameter.high), step: String(parameter.step), title: label, label });
    const number = make("input", { type: "number", step: "any", title: label, label: `${label}, as a number` });
    const put = (/** @type {number} */ value) => {
      if (!Number.isFinite(value)) return;
      const parts = MAPS[name].map((known, k) => this.edits.entries[i].maps[m].value.split(":")[k] ?? known.fresh);
      parts[p] = String(Number(value.toPrecision(5)));
      change(m, parts.join(":"), `map ${m} ${p}`);
    };
    range.addEventListener("input", () => put(parameter.log ? 2 ** range.valueAsNumber : range.valueAsNumber));
    number.addEventListener("input", () => put(number.valueAsNumber));
    for (const element of [range, number]) element.dataset.value = `${i} ${m} ${p}`;
    range.dataset.key = `range ${i} ${m} ${p}`;
    number.dataset.key = `number ${i} ${m} ${p}`;
    if (parameter.log) range.dataset.log = "1";
    return make("div", { className: "row" }, range, number);
  }

  /** @param {Entry} entry @param {number} i */
  axes(entry, i) {
    const field = (/** @type {"up" | "origin"} */ name, /** @type {string} */ title) => {
      const text = make("input", { type: "text", value: entry[name], placeholder: "x,y,z", title, label: title });
      text.dataset.key = `${name} ${i}`;
      text.addEventListener("change", () => this.edits.update(i, { [name]: text.value.replaceAll(" ", "") }));
      return make("div", { className: "row" }, make("span", { textContent: name, className: "edit-axis" }), text);
    };
    return make("div", {}, field("up", "Direction that becomes up"), field("origin", "Point that becomes the origin"), make("div", { className: "quiet", textContent: "The saved scene is turned and moved; the picture stays. Cameras of the data set do not go with it." }));
  }
}
