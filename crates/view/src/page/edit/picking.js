/** Selections made in the picture and on a histogram: luminance, hue, shapes, painted masks, a floor. */

import { byId } from "../dom/elements.js";
import { toJson } from "../math/lens.js";
import { add, cross, dot, sub, times, unit } from "../math/vectors.js";
import { ask } from "./edits.js";
import { hueOf, short } from "./selection.js";
import { entry } from "./stack.js";

/** @typedef {import("./edits.js").Edits} Edits */
/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../viewer/overlay.js").Overlay} Overlay */
/** @typedef {import("../viewer/part.js").Grip} Grip */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */
/** @typedef {"" | "hue" | "brush" | "lasso" | "floor" | "origin"} Tool */

/** Tools, and what the user does with each. @type {{ [tool in Tool]: string }} */
const TOOLS = {
  "": "",
  hue: "Click a colour in the picture.",
  brush: "Paint over the picture; Escape ends. Shift removes paint.",
  lasso: "Draw around splats in the picture; Escape ends. Shift removes.",
  floor: "Click three points of the floor.",
  origin: "Click the point that becomes the origin.",
};
/** Half the width of a new selection of hues, and its soft edge, degrees. */
const HUE_WIDTH = 20;
/** Soft edge of a new mask: a share. */
const MASK_SOFT = "0.2";

/** @implements {Part} */
export class Picking {
  /** @type {Tool} */ tool = "";
  /** @type {Vec3[]} */ points = [];
  /** Paint, and the camera that it was painted for. @type {{ canvas: HTMLCanvasElement, lens: Lens, test: string } | null} */ paint = null;
  /** @type {[number, number][]} */ outline = [];
  /** What is wrong with the last click, in place of what the tool is for. */ said = "";

  /** @param {Viewer} viewer @param {Edits} edits */
  constructor(viewer, edits) {
    this.viewer = viewer;
    this.edits = edits;
    for (const tool of /** @type {Tool[]} */ (["hue", "brush", "lasso", "floor", "origin"])) byId(`pick-${tool}`).addEventListener("click", () => this.take(this.tool === tool ? "" : tool));
    byId("pick-sphere").addEventListener("click", () => this.shape("sphere"));
    byId("pick-box").addEventListener("click", () => this.shape("box"));
    byId("pick-up").addEventListener("click", () => this.setAxes({ up: this.text(viewer.state.axes.up) }));
    addEventListener("keydown", (event) => event.key === "Escape" && this.tool && this.take(""));
  }

  /** @param {Tool} tool */
  take(tool) {
    [this.tool, this.points, this.paint, this.said] = [tool, [], null, ""];
    this.viewer.changed();
  }

  /** @param {Vec3} point */
  text(point) {
    return point.map((value) => Number(value.toPrecision(6))).join(",");
  }

  /** @param {"sphere" | "box"} name */
  shape(name) {
    const { pivot } = this.viewer.state;
    const half = this.viewer.controls.size * 0.1;
    const numbers = name === "sphere" ? [...pivot, half] : [...pivot.map((v) => v - half), ...pivot.map((v) => v + half)];
    this.edits.setTest({ not: false, body: `${name}(${numbers.map(short).join(",")})`, soft: short(half * 0.1) });
  }

  /** Changes the entry with the axes, or adds one. @param {{ up?: string, origin?: string }} fields */
  setAxes(fields) {
    const at = this.edits.entries.findIndex(({ kind }) => kind === "axes");
    if (at < 0) this.edits.add(entry({ kind: "axes", ...fields }));
    else this.edits.update(at, fields);
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event */
  clicked(x, y, event) {
    if (event.button !== 0 || !this.tool) return false;
    const { viewer, tool } = this;
    const [u, v] = [x / viewer.box.width, y / viewer.box.height];
    const sample = viewer.sample(u, v);
    this.said = "";
    if (tool === "hue" && sample) this.pickHue(sample.radiance);
    else if (tool === "origin" || tool === "floor") {
      viewer.clicks.at(u, v, ({ position }) => {
        if (this.tool !== tool) return;
        if (!position) this.said = "There is nothing; click a surface.";
        else if (tool === "floor") this.pickFloor(position);
        else {
          this.setAxes({ origin: this.text(position) });
          this.take("");
        }
        viewer.changed();
      });
    }
    viewer.changed();
    return true;
  }

  /** @param {number[]} radiance */
  pickHue(radiance) {
    const rows = this.viewer.scene?.rec709_from_scene ?? [];
    const hue = hueOf(rows.map((row) => row[0] * radiance[0] + row[1] * radiance[1] + row[2] * radiance[2]));
    if (hue === null) return void (this.said = "Grey has no hue; click a colour.");
    const turned = (/** @type {number} */ by) => Math.round((hue + by + 360) % 360);
    this.edits.setTest({ not: false, body: `hue in ${turned(-HUE_WIDTH)}..${turned(HUE_WIDTH)}`, soft: String(HUE_WIDTH) }, ({ body }) => body.startsWith("hue"));
    this.take("");
  }

  /** Up is the normal of the plane of three points, on the side of the eye; the first becomes the origin. @param {Vec3} point */
  pickFloor(point) {
    this.points = [...this.points, point];
    if (this.points.length < 3) return;
    const [a, b, c] = this.points;
    const normal = cross(sub(b, a), sub(c, a));
    const up = unit(dot(normal, sub(this.viewer.state.eye, a)) < 0 ? times(normal, -1) : normal);
    this.setAxes({ up: this.text(up), origin: this.text(a) });
    this.take("");
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event @returns {Grip | null} */
  grab(x, y, event) {
    if ((this.tool !== "brush" && this.tool !== "lasso") || event.button !== 0) return null;
    const paint = this.paper();
    const context = /** @type {CanvasRenderingContext2D} */ (paint.canvas.getContext("2d"));
    context.fillStyle = context.strokeStyle = "#fff";
    context.globalCompositeOperation = event.shiftKey ? "destination-out" : "source-over";
    context.lineCap = context.lineJoin = "round";
    context.lineWidth = byId("brush-size").valueAsNumber;
    const isLasso = this.tool === "lasso";
    this.outline = [[x, y]];
    const stroke = () => {
      if (!isLasso) this.trace(context, this.outline.slice(-2));
      this.viewer.needsDraw = true;
    };
    stroke();
    return {
      move: (nx, ny) => {
        this.outline.push([nx, ny]);
        stroke();
      },
      end: () => {
        if (isLasso) {
          context.beginPath();
          for (const [px, py] of this.outline) context.lineTo(px, py);
          context.fill();
        }
        this.outline = [];
        void this.send(paint).catch((error) => this.viewer.messages.notice(error.message));
      },
    };
  }

  /** @param {CanvasRenderingContext2D} context @param {[number, number][]} places */
  trace(context, places) {
    context.beginPath();
    context.moveTo(...places[0]);
    for (const place of places) context.lineTo(...place);
    context.stroke();
  }

  /** The paint of the camera in force. */
  paper() {
    const { width, height } = this.viewer.box;
    const lens = this.viewer.lens(width, height);
    if (this.paint && toJson(this.paint.lens) === toJson(lens) && this.paint.canvas.width === width) return this.paint;
    // Where there is no paint it is transparent, which is no part of a mask.
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    return (this.paint = { canvas, lens, test: "" });
  }

  /** Gives the mask to the server, and selects by it. @param {{ canvas: HTMLCanvasElement, lens: Lens, test: string }} paint */
  async send(paint) {
    const blob = await new Promise((/** @type {(blob: Blob | null) => void} */ resolve) => paint.canvas.toBlob(resolve, "image/png"));
    if (!blob) return;
    const answer = await ask("mask", { camera: toJson(paint.lens), width: paint.lens.width, height: paint.lens.height }, { method: "POST", body: blob });
    const { file, view } = await answer.json();
    const before = paint.test;
    paint.test = `mask("${file}", "${view}")`;
    this.edits.setTest({ not: false, body: paint.test, soft: MASK_SOFT }, ({ body }) => body === before);
  }

  /** @param {Overlay} overlay @param {Lens} lens */
  draw(overlay, lens) {
    const { context } = overlay;
    this.points.forEach((point, i) => overlay.pin(point, lens, `floor ${i + 1}`));
    if (this.paint && this.tool && toJson(this.paint.lens) === toJson(lens)) {
      context.globalAlpha = 0.3;
      context.drawImage(this.paint.canvas, 0, 0, this.viewer.box.width, this.viewer.box.height);
      context.globalAlpha = 1;
    }
    if (this.tool === "lasso" && this.outline.length > 1) {
      context.strokeStyle = "#fff";
      this.trace(context, this.outline);
    }
    const axes = this.edits.entries.find(({ kind, on }) => kind === "axes" && on);
    if (axes) this.drawAxes(overlay, lens, axes);
  }

  /** @param {Overlay} overlay @param {Lens} lens @param {import("./stack.js").Entry} axes */
  drawAxes(overlay, lens, axes) {
    const vector = (/** @type {string} */ text) => /** @type {Vec3} */ (text.split(",").map(Number));
    const origin = axes.origin ? vector(axes.origin) : /** @type {Vec3} */ ([0, 0, 0]);
    const up = axes.up ? unit(vector(axes.up)) : /** @type {Vec3} */ ([...this.viewer.controls.up]);
    if (![...origin, ...up].every(Number.isFinite)) return;
    overlay.context.strokeStyle = "#fff";
    overlay.path([origin, add(origin, times(up, this.viewer.controls.size * 0.2))], lens);
    overlay.pin(origin, lens, "origin, up");
  }

  reflect() {
    for (const tool of ["hue", "brush", "lasso", "floor", "origin"]) byId(`pick-${tool}`).setAttribute("aria-pressed", String(this.tool === tool));
    byId("pick-hint").textContent = this.said || TOOLS[this.tool];
    byId("brush-row").hidden = this.tool !== "brush";
    byId("axes-tools").hidden = !this.edits.entries.some(({ kind }) => kind === "axes");
  }
}
