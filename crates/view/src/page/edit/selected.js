/** What the current selection holds: its overlay, its count and light, and the histogram of the splats' luminance. */

import { byId } from "../dom/elements.js";
import { toJson } from "../math/lens.js";
import { ask, DRAG } from "./edits.js";
import { formatTests, short } from "./selection.js";

/** @typedef {import("./edits.js").Edits} Edits */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */
/** @typedef {{ count: number, partial: number, share_of_light: number }} Facts */
/** @typedef {{ count: number, black: number, low_log2: number, high_log2: number, bins: number[], percentiles: number[] }} Luminances */

/** Soft edge of a selection that is dragged, stops. */
const SOFT = "1";
const HEIGHT = 56;

/** Asks for the newest of what is wanted, one request at a time. */
class Newest {
  /** @param {(message: string) => void} failed */
  constructor(failed) {
    this.failed = failed;
  }

  key = "";
  busy = false;
  /** @type {{ key: string, work: () => Promise<void> } | null} */ waiting = null;

  /** @param {string} key @param {() => Promise<void>} work */
  want(key, work) {
    if (key === this.key) return;
    this.key = key;
    this.waiting = { key, work };
    if (!this.busy) void this.run();
  }

  async run() {
    this.busy = true;
    while (this.waiting) {
      const { work } = this.waiting;
      this.waiting = null;
      await work().catch((error) => this.failed(error.message));
    }
    this.busy = false;
  }
}

/** @implements {Part} */
export class Selected {
  shows = false;
  counts = new Newest((message) => this.tell(message));
  pictures = new Newest((message) => this.tell(message));
  // The counts say what is wrong.
  histograms = new Newest(() => undefined);
  /** @type {Luminances | null} */ luminances = null;
  /** Key of the picture that is on the screen. */ shownKey = "";

  /** @param {Viewer} viewer @param {Edits} edits */
  constructor(viewer, edits) {
    this.viewer = viewer;
    this.edits = edits;
    this.image = /** @type {HTMLImageElement} */ (document.getElementById("selection"));
    byId("show-selection").addEventListener("click", () => {
      this.shows = !this.shows;
      viewer.changed();
    });
    const canvas = byId("splat-histogram");
    canvas.addEventListener("pointerdown", (event) => this.drag(event));
    canvas.addEventListener("dblclick", () => this.forget());
  }

  /** What the server is asked about; null without a selection. @returns {{ [name: string]: string } | null} */
  question() {
    const { edits } = this;
    const known = edits.entries[edits.current];
    if (!known || known.kind === "axes") return null;
    if (known.kind === "floaters") return { edit: "", floaters: "1" };
    // Deletions are of the scene before the edits.
    return { edit: known.kind === "delete" ? "" : edits.before(edits.current), where: known.where };
  }

  /** @param {Facts} facts */
  say({ count, partial, share_of_light: share }) {
    const splats = this.viewer.scene?.splats ?? 0;
    const part = partial ? ` (${partial.toLocaleString("en")} in part)` : "";
    this.tell(`${count.toLocaleString("en")} of ${splats.toLocaleString("en")} splats${part}, ${short(100 * share)} % of the light`);
  }

  /** @param {string} text */
  tell(text) {
    byId("selection-facts").textContent = text;
  }

  /** A server that was started again may have another scene. */
  sceneSet() {
    for (const newest of [this.counts, this.pictures, this.histograms]) newest.key = "";
  }

  /** Looks whether the picture of the selection is of what is shown. */
  step() {
    const { viewer, image } = this;
    const question = this.shows && viewer.scene && !viewer.scene.training ? this.question() : null;
    if (!question) {
      image.hidden = true;
      this.shownKey = this.pictures.key = "";
      return;
    }
    const { left, top, width, height } = viewer.box;
    Object.assign(image.style, { left: `${left}px`, top: `${top}px`, width: `${width}px`, height: `${height}px` });
    const camera = toJson(viewer.lens(width, height));
    const place = JSON.stringify([camera, width, height]);
    const key = JSON.stringify([place, question]);
    // A picture of another camera would mislead; one of the selection before is near enough.
    image.hidden = this.shownKey !== place;
    this.pictures.want(key, async () => {
      const answer = await ask("overlay.png", { ...question, camera, width, height });
      this.say(JSON.parse(answer.headers.get("luxel-frame") ?? "{}"));
      const url = URL.createObjectURL(await answer.blob());
      image.src = url;
      await image.decode().catch(() => undefined);
      URL.revokeObjectURL(url);
      this.shownKey = place;
      image.dataset.key = key;
    });
  }

  reflect() {
    const question = this.question();
    const { viewer, edits } = this;
    byId("show-selection").setAttribute("aria-pressed", String(this.shows));
    byId("selection-tools").hidden = !question;
    const known = edits.entries[edits.current];
    const hasTests = known?.kind === "light" || known?.kind === "delete";
    byId("pick-tools").hidden = byId("luminance-tools").hidden = !hasTests;
    if (!question || viewer.scene?.training) return;
    if (!this.shows) this.counts.want(JSON.stringify(question), async () => this.say(await (await ask("selection", question)).json()));
    else this.counts.key = "";
    if (!hasTests) return;
    this.histograms.want(`edits ${question.edit}`, async () => {
      this.luminances = await (await ask("luminance", { edit: question.edit })).json();
      this.drawHistogram();
    });
    this.drawHistogram();
  }

  /** The test of luminance in the current entry: its ends, units of the data set. */
  range() {
    const level = (/** @type {string} */ text) => (text.startsWith("p") ? (this.luminances?.percentiles[Math.round(Number(text.slice(1)))] ?? NaN) : Number(text));
    for (const { body } of this.edits.tests()?.tests ?? []) {
      const within = body.match(/^(?:L|l|luminance)\s*in\s*([p\d.e+-]+?)\s*\.\.\s*([p\d.e+-]+)$/);
      if (within) return [level(within[1]), level(within[2])];
      const side = body.match(/^(?:L|l|luminance)\s*([<>])=?\s*([p\d.e+-]+)$/);
      if (side) return side[1] === "<" ? [0, level(side[2])] : [level(side[2]), Infinity];
    }
    return null;
  }

  /** @param {PointerEvent} event */
  drag(event) {
    const canvas = /** @type {HTMLCanvasElement} */ (document.getElementById("splat-histogram"));
    if (!this.luminances) return;
    canvas.setPointerCapture(event.pointerId);
    const part = (/** @type {PointerEvent} */ { offsetX }) => Math.min(1, Math.max(0, offsetX / canvas.clientWidth));
    const from = part(event);
    const moved = (/** @type {PointerEvent} */ moving) => this.select(Math.min(from, part(moving)), Math.max(from, part(moving)));
    canvas.addEventListener("pointermove", moved);
    const ended = () => {
      canvas.removeEventListener("pointermove", moved);
      this.edits.lastTag = "";
    };
    canvas.addEventListener("pointerup", ended, { once: true });
  }

  /** Selects from one part of the axis to another, 0 to 1; the ends are open. @param {number} low @param {number} high */
  select(low, high) {
    if (!this.luminances || high - low < 0.01) return;
    const { low_log2: start, high_log2: end } = this.luminances;
    const value = (/** @type {number} */ part) => short(2 ** (start + part * (end - start)));
    const body = high >= 1 ? `L >= ${value(low)}` : low <= 0 ? `L <= ${value(high)}` : `L in ${value(low)}..${value(high)}`;
    const old = this.edits.tests()?.tests.find(({ body }) => /^(L|l|luminance)\b/.test(body));
    this.edits.setTest({ not: false, body, soft: old?.soft ?? SOFT }, (test) => /^(L|l|luminance)\b/.test(test.body), `${DRAG} luminance`);
  }

  /** Removes the test of luminance. */
  forget() {
    const tests = this.edits.tests();
    const at = tests?.tests.findIndex(({ body }) => /^(L|l|luminance)\b/.test(body)) ?? -1;
    if (tests && at >= 0) this.edits.update(this.edits.current, { where: formatTests({ ...tests, tests: tests.tests.filter((_, i) => i !== at) }) });
  }

  drawHistogram() {
    const canvas = /** @type {HTMLCanvasElement} */ (document.getElementById("splat-histogram"));
    const { luminances } = this;
    const width = canvas.clientWidth;
    if (!luminances || width === 0) return;
    const dots = devicePixelRatio;
    [canvas.width, canvas.height] = [Math.round(width * dots), HEIGHT * dots];
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    context.setTransform(dots, 0, 0, dots, 0, 0);
    const { bins, low_log2: low, high_log2: high } = luminances;
    const x = (/** @type {number} */ value) => Math.min(width, Math.max(0, ((Math.log2(value) - low) / (high - low)) * width));
    const range = this.range();
    if (range) {
      context.fillStyle = "#3a3a3a";
      context.fillRect(x(range[0]), 0, Math.max(1, x(range[1]) - x(range[0])), HEIGHT);
    }
    const peak = Math.max(1, ...bins.map(Math.sqrt));
    context.fillStyle = "#b4b4b4";
    bins.forEach((count, i) => {
      const tall = (Math.sqrt(count) / peak) * (HEIGHT - 4);
      context.fillRect((i / bins.length) * width, HEIGHT - tall, width / bins.length - 0.3, tall);
    });
    context.fillStyle = "#777";
    for (const percent of [5, 50, 95]) context.fillRect(x(luminances.percentiles[percent]), 0, 1, HEIGHT);
    byId("splat-low").textContent = Number((2 ** low).toPrecision(2)).toString();
    byId("splat-middle").textContent = [5, 50, 95].map((percent) => `p${percent} ${Number(luminances.percentiles[percent].toPrecision(2))}`).join(" · ");
    byId("splat-high").textContent = short(2 ** high);
  }
}
