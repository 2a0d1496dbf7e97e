/** The stack of edits: its history, the text and the command, and which entry is being worked on. */

import { byId } from "../dom/elements.js";
import { download } from "../dom/files.js";
import { checked } from "../scene/server.js";
import { EditCards } from "./cards.js";
import { formatTests, parseTests } from "./selection.js";
import { command, entry, format, parse } from "./stack.js";

/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("./selection.js").Test} Test */
/** @typedef {import("./stack.js").Entry} Entry */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** Time within which changes by the same control are undone together, ms. */
const TOGETHER_MS = 900;
/** First word of the tag of changes by a drag, whose end clears it. */
export const DRAG = "drag";
/** Time without typing after which the text is taken, ms. */
const TYPING_MS = 350;
/** Bytes of a file of edits that is opened. */
const MAX_BYTES = 2 ** 20;
/** Steps that can be undone. */
const MAX_STEPS = 200;

/** @implements {Part} */
export class Edits {
  /** @type {Entry[]} */ entries = [];
  /** Index of the entry that is worked on; -1 for none. */ current = -1;
  /** The text that the entries were read from or written to. */ text = "";
  /** @type {string[]} */ undone = [];
  /** @type {string[]} */ done = [];
  lastTag = "";
  lastAt = 0;

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    this.cards = new EditCards(this);
    const click = (/** @type {string} */ id, /** @type {() => void} */ act) => byId(id).addEventListener("click", act);
    click("edit-add", () => this.add(entry({ maps: [{ name: "stops", value: "-1" }] })));
    click("edit-delete", () => this.add(entry({ kind: "delete", where: this.newSphere() })));
    click("edit-crop", () => this.add(entry({ kind: "delete", where: `not ${this.newBox()}` })));
    click("edit-floaters", () => this.add(entry({ kind: "floaters" })));
    click("edit-axes", () => this.add(entry({ kind: "axes" })));
    click("edit-undo", () => this.undo());
    click("edit-redo", () => this.redo());
    click("edit-clear", () => this.change([], -1));
    click("copy-command", () => void navigator.clipboard?.writeText(this.command()).catch(() => undefined));
    let waiting = 0;
    byId("edit").addEventListener("input", () => {
      clearTimeout(waiting);
      waiting = setTimeout(() => this.typed(byId("edit").value.trim()), TYPING_MS);
    });
    byId("edit-example").addEventListener("change", () => {
      if (byId("edit-example").value) this.typed(byId("edit-example").value);
      byId("edit-example").value = "";
    });
    addEventListener("keydown", (event) => this.key(event));
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const target = /** @type {HTMLElement} */ (event.target);
    const isTyping = target.closest("input[type=text], input[type=number], textarea, dialog");
    if (!(event.ctrlKey || event.metaKey) || event.altKey || isTyping) return;
    const name = event.key.toLowerCase();
    if (name !== "z" && name !== "y") return;
    event.preventDefault();
    if (name === "y" || event.shiftKey) this.redo();
    else this.undo();
  }

  /** A sphere at the pivot. */
  newSphere() {
    const { pivot } = this.viewer.state;
    const radius = this.viewer.controls.size * 0.1;
    return `sphere(${[...pivot, radius].map((v) => Number(v.toPrecision(4))).join(",")})`;
  }

  /** A box around most of the scene. */
  newBox() {
    const bounds = this.viewer.scene?.inner_bounds ?? [[-1, -1, -1], [1, 1, 1]];
    return `box(${bounds.flat().map((v) => Number(v.toPrecision(4))).join(",")})`;
  }

  /** @param {Entry} added */
  add(added) {
    this.change([...this.entries, added], this.entries.length);
  }

  /** Text of the entries before one. @param {number} index */
  before(index) {
    return format(this.entries.slice(0, index).filter(({ kind }) => kind === "light"));
  }

  /** Makes these the entries; changes with the same tag shortly after one another are undone together, and all of a drag. @param {Entry[]} entries @param {number} [current] @param {string} [tag] */
  change(entries, current = this.current, tag = "") {
    const now = performance.now();
    const isLater = now - this.lastAt > TOGETHER_MS && !tag.startsWith(DRAG);
    if (!tag || tag !== this.lastTag || isLater) this.done = [...this.done, this.snapshot()].slice(-MAX_STEPS);
    [this.lastTag, this.lastAt, this.undone] = [tag, now, []];
    this.put(entries, current);
  }

  /** Changes one entry. @param {number} index @param {Partial<Entry>} fields @param {string} [tag] */
  update(index, fields, tag = "") {
    this.change(this.entries.map((known, i) => (i === index ? { ...known, ...fields } : known)), this.current, tag && `${tag} ${index}`);
  }

  snapshot() {
    return JSON.stringify({ entries: this.entries, current: this.current });
  }

  /** @param {Entry[]} entries @param {number} current */
  put(entries, current) {
    this.entries = entries;
    this.current = Math.min(current, entries.length - 1);
    this.text = format(entries);
    this.viewer.set({ edit: this.text });
    // At once, so that no control of an entry that is gone can be used.
    this.cards.reflect();
  }

  undo() {
    this.travel(this.done, this.undone);
  }

  redo() {
    this.travel(this.undone, this.done);
  }

  /** @param {string[]} from @param {string[]} to */
  travel(from, to) {
    const snapshot = from.pop();
    if (snapshot === undefined) return;
    to.push(this.snapshot());
    this.lastTag = "";
    const { entries, current } = JSON.parse(snapshot);
    this.put(entries, current);
  }

  /** Takes a text in place of all entries. @param {string} text */
  typed(text) {
    if (text === this.text) return;
    const entries = parse(text);
    this.change(entries, entries.length - 1, "typed");
    // As it was typed, so that the server says what is wrong with it.
    if (this.text !== text) this.viewer.set({ edit: (this.text = text) });
  }

  /** Tests of the current entry's selection; null where there is none or it is nested. */
  tests() {
    const known = this.entries[this.current];
    return known && (known.kind === "light" || known.kind === "delete") ? parseTests(known.where) : null;
  }

  /** Adds a test to the current entry, or to a new one; one that `replaces` tells takes the place of the first such. @param {Test} test @param {((test: Test) => boolean) | null} [replaces] @param {string} [tag] */
  setTest(test, replaces = null, tag = "") {
    if (!this.tests()) this.add(entry({ maps: [{ name: "stops", value: "-1" }] }));
    const tests = this.tests();
    if (!tests) return;
    const at = replaces ? tests.tests.findIndex(replaces) : -1;
    const next = at < 0 ? [...tests.tests, test] : tests.tests.map((known, i) => (i === at ? { ...test, not: known.not } : known));
    this.update(this.current, { where: formatTests({ ...tests, tests: next }) }, tag);
  }

  command() {
    return command(this.entries, this.viewer.scene?.path || this.viewer.scene?.name || "SCENE", "edited.ply");
  }

  reflect() {
    const { viewer } = this;
    if (viewer.state.edit !== this.text) {
      // From the address of the page.
      this.entries = parse(viewer.state.edit);
      [this.text, this.current] = [viewer.state.edit, this.entries.length - 1];
    }
    byId("edit-section").hidden = Boolean(viewer.training?.newest);
    const field = byId("edit");
    if (document.activeElement !== field) field.value = this.text;
    byId("edit-text").textContent = this.text ? this.command() : "";
    byId("edit-text").hidden = byId("edit-clear").hidden = byId("copy-command").hidden = byId("edit-save").hidden = !this.text && this.entries.length === 0;
    byId("edit-undo").toggleAttribute("disabled", this.done.length === 0);
    byId("edit-redo").toggleAttribute("disabled", this.undone.length === 0);
    this.cards.reflect();
  }
}

/** Asks the server about edits. @param {string} path @param {{ [name: string]: string | number }} query @param {RequestInit} [init] */
export async function ask(path, query, init) {
  const text = new URLSearchParams(Object.entries(query).map(([name, value]) => [name, String(value)]));
  return checked(await fetch(`/api/edit/${path}?${text}`, init));
}

/** Saves edits and scenes into the folder of the run, and opens saved edits. @implements {Part} */
export class SavedEdits {
  /** @param {Viewer} viewer @param {Edits} edits */
  constructor(viewer, edits) {
    this.viewer = viewer;
    this.edits = edits;
    byId("save-scene").addEventListener("click", () => void this.save({ scene: true, stack: true }));
    byId("save-edits").addEventListener("click", () => void this.save({ scene: false, stack: true }));
    byId("download-edits").addEventListener("click", () => download(URL.createObjectURL(new Blob([`${edits.text}\n`])), `${this.name()}.edits`));
    byId("edit-open").addEventListener("change", () => void this.open(byId("edit-open").value));
  }

  name() {
    return byId("edit-name").value.trim() || "edited";
  }

  /** @param {{ scene: boolean, stack: boolean }} what */
  async save(what) {
    const said = byId("edit-saved");
    said.textContent = "saving …";
    try {
      const answer = await ask("save", {}, { method: "POST", body: JSON.stringify({ name: this.name(), edit: this.edits.text, ...what }) });
      const { scene, stack } = await answer.json();
      said.textContent = [scene, stack].filter(Boolean).map((path) => `saved ${path}`).join("\n");
      void this.list().catch(() => undefined);
    } catch (error) {
      said.textContent = /** @type {Error} */ (error).message;
    }
  }

  /** @param {string} name */
  async open(name) {
    byId("edit-open").value = "";
    if (!name) return;
    try {
      const { edit } = await (await ask("stack", { name })).json();
      this.edits.typed(edit);
      byId("edit-name").value = name;
      byId("edit-saved").textContent = `opened ${name}.edits`;
    } catch (error) {
      byId("edit-saved").textContent = /** @type {Error} */ (error).message;
    }
  }

  /** Opens a file of edits. @param {File} file */
  async read(file) {
    try {
      if (file.size > MAX_BYTES) throw new Error(`${file.size} bytes, expected at most ${MAX_BYTES}`);
      const { edit } = await (await ask("read", {}, { method: "POST", body: await file.text() })).json();
      this.edits.typed(edit);
      byId("edit-name").value = file.name.replace(/\.edits$/i, "");
      byId("edit-saved").textContent = `opened ${file.name}`;
    } catch (error) {
      byId("edit-saved").textContent = `${file.name}: ${/** @type {Error} */ (error).message}`;
    }
    byId("edit-section").scrollIntoView({ block: "nearest" });
  }

  async list() {
    const { names } = await (await ask("saved", {})).json();
    const first = Object.assign(document.createElement("option"), { value: "", textContent: names.length ? "open saved edits" : "no saved edits" });
    byId("edit-open").replaceChildren(first, ...names.map((/** @type {string} */ name) => Object.assign(document.createElement("option"), { value: name, textContent: name })));
  }

  /** @param {import("../scene/scene.js").Scene} scene */
  sceneSet(scene) {
    if (!scene.training) void this.list().catch(() => undefined);
  }
}
