/** The controls: what they set, and how they show what is set. */

import { colorOfDifference, colorOfStops, DIFFERENCE, STOPS } from "./falsecolor.js";
import { fillHelp } from "./help.js";
import { histogram, MIDDLE_GREY, signed } from "./measure.js";
import { COMPARES, MODES } from "./state.js";

/** @typedef {import("./main.js").Viewer} Viewer */
/** @typedef {import("./scene.js").Frame} Frame */
/** @typedef {import("./state.js").State} State */

/** Time without typing after which an edit is shown, ms. */
const EDIT_MS = 350;

/** Stops of the histogram, around middle grey at the exposure in force. */
const HISTOGRAM = { low: -12, high: 12, bins: 96 };

/** @template {HTMLElement} [T=HTMLInputElement] @param {string} id @returns {T} */
export const byId = (id) => /** @type {T} */ (document.getElementById(id));

/** @param {HTMLElement} group @param {readonly string[]} names @param {(name: string) => void} chosen */
function segmented(group, names, chosen) {
  for (const name of names) {
    const button = Object.assign(document.createElement("button"), { textContent: name, type: "button" });
    button.dataset.value = name;
    button.addEventListener("click", () => chosen(name));
    group.append(button);
  }
}

/** Connects the controls. @param {Viewer} viewer */
export function connect(viewer) {
  const number = (/** @type {string} */ id, /** @type {keyof State} */ field) =>
    byId(id).addEventListener("input", () => Number.isFinite(byId(id).valueAsNumber) && viewer.set({ [field]: byId(id).valueAsNumber }));
  const choice = (/** @type {string} */ id, /** @type {keyof State} */ field) => byId(id).addEventListener("change", () => viewer.set({ [field]: byId(id).value }));
  const flag = (/** @type {string} */ id, /** @type {keyof State} */ field) => byId(id).addEventListener("change", () => viewer.set({ [field]: byId(id).checked }));
  const click = (/** @type {string} */ id, /** @type {() => void} */ act) => byId(id).addEventListener("click", act);
  byId("exposure").addEventListener("input", () => viewer.set({ exposure: byId("exposure").valueAsNumber, autoExposure: false }));
  number("fov", "fov");
  byId("fov").addEventListener("input", () => viewer.controls.left());
  number("zebra-low", "zebraLow");
  number("zebra-high", "zebraHigh");
  choice("layer", "layer");
  choice("curve", "curve");
  flag("zebra", "zebra");
  flag("auto-exposure", "autoExposure");
  click("exposure-once", () => viewer.fitExposure());
  click("exposure-reset", () => viewer.set({ exposure: 0, autoExposure: false }));
  click("home", () => viewer.home());
  click("level", () => viewer.controls.level());
  click("show-cameras", () => viewer.set({ showCameras: !viewer.state.showCameras }));
  click("toggle-panel", () => viewer.togglePanel());
  click("open-help", () => viewer.toggleHelp());
  click("save-exr", () => viewer.saveExr());
  click("save-png", () => viewer.savePng());
  click("copy-link", () => viewer.copyLink());
  segmented(byId("compare"), COMPARES, (name) => viewer.set({ compare: /** @type {State["compare"]} */ (name) }));
  segmented(byId("mode"), MODES, (name) => viewer.set({ mode: /** @type {State["mode"]} */ (name) }));
  let waiting = 0;
  byId("edit").addEventListener("input", () => {
    clearTimeout(waiting);
    waiting = setTimeout(() => viewer.set({ edit: byId("edit").value.trim() }), EDIT_MS);
  });
  byId("edit-example").addEventListener("change", () => {
    if (byId("edit-example").value) viewer.set({ edit: byId("edit-example").value });
    byId("edit-example").value = "";
  });
  click("edit-clear", () => viewer.set({ edit: "" }));
  click("copy-command", () => void navigator.clipboard?.writeText(commandOf(viewer)).catch(() => undefined));
  fillHelp(byId("help-body"));
}

/** The command that makes the edit: each statement is an option of the same name. @param {Viewer} viewer */
function commandOf(viewer) {
  const statements = viewer.state.edit.split(/[;|]/).map((statement) => statement.trim()).filter(Boolean);
  const options = statements.map((statement) => {
    const [, name, value] = /** @type {RegExpMatchArray} */ (statement.match(/^(\S+)\s*(.*)$/));
    return `--${name} ${/^[\w.,:-]+$/.test(value) ? value : `'${value.replaceAll("'", "'\\''")}'`}`;
  });
  return `luxel edit ${viewer.scene?.name ?? ""} ${options.join(" ")} -o edited.ply`;
}

/** Shows what is set. @param {Viewer} viewer */
export function reflect(viewer) {
  const { state, scene } = viewer;
  byId("exposure").value = String(state.exposure);
  byId("exposure-text").textContent = `${signed(state.exposure, 1)} EV`;
  byId("auto-exposure").checked = state.autoExposure;
  byId("layer").value = state.layer;
  byId("curve").value = state.curve;
  byId("curve").toggleAttribute("disabled", state.layer !== "radiance");
  byId("zebra").checked = state.zebra;
  for (const [id, value] of /** @type {const} */ ([["zebra-low", state.zebraLow], ["zebra-high", state.zebraHigh]])) {
    if (document.activeElement !== byId(id)) byId(id).value = String(value);
  }
  byId("fov").value = String(Math.round(state.fov));
  byId("fov-text").textContent = `${state.fov.toFixed(0)}°`;
  byId("show-cameras").setAttribute("aria-pressed", String(state.showCameras));
  press("compare", state.compare);
  press("mode", state.mode);
  const view = viewer.viewCamera();
  const canCompare = Boolean(view?.has_ground_truth);
  for (const button of byId("compare").querySelectorAll("button")) button.disabled = !canCompare && button.dataset.value !== "off";
  byId("compare-section").hidden = !scene?.cameras.some((camera) => camera.has_ground_truth);
  byId("compare-text").textContent = canCompare ? `${view?.name} (${view?.split})` : "Choose a camera below to compare with its image.";
  for (const button of byId("strip").querySelectorAll("button")) button.setAttribute("aria-pressed", String(button.dataset.view === state.view));
  byId("edit-section").hidden = viewer.training.newest !== null;
  if (document.activeElement !== byId("edit")) byId("edit").value = state.edit;
  byId("edit-text").textContent = state.edit ? commandOf(viewer) : "";
  byId("edit-text").hidden = byId("edit-clear").hidden = byId("copy-command").hidden = !state.edit;
  legend(state, viewer.isComparing());
}

/** @param {string} id @param {string} value */
function press(id, value) {
  for (const button of byId(id).querySelectorAll("button")) button.setAttribute("aria-pressed", String(button.dataset.value === value));
}

/** @param {State} state @param {boolean} isComparing */
function legend(state, isComparing) {
  const element = byId("legend");
  const isDifference = isComparing && state.compare === "difference";
  const kind = isDifference ? "difference" : state.layer === "stops" ? "stops" : "";
  element.hidden = kind === "";
  if (element.dataset.kind === kind || !kind) return;
  element.dataset.kind = kind;
  const line = (/** @type {number} */ value, /** @type {[number, number, number]} */ color, /** @type {string} */ text) => {
    const row = document.createElement("div");
    row.dataset.stops = String(value);
    const swatch = document.createElement("i");
    swatch.style.background = `rgb(${color.join(",")})`;
    row.append(swatch, text);
    return row;
  };
  const heading = Object.assign(document.createElement("p"), { textContent: isDifference ? "difference, stops" : "stops around middle grey" });
  const lines = [];
  if (isDifference) for (let s = DIFFERENCE.high; s >= DIFFERENCE.low; s -= 0.5) lines.push(line(s, colorOfDifference(s), s === DIFFERENCE.high ? `${s} and more` : String(s)));
  else for (let s = STOPS.high; s >= STOPS.low; s--) lines.push(line(s, colorOfStops(s), s === 0 ? "0 middle grey" : `${signed(s, 0)}${s === STOPS.high ? " and more" : s === STOPS.low ? " and less" : ""}`));
  element.replaceChildren(heading, ...lines);
}

/** Draws the histogram of a picture. @param {Viewer} viewer @param {Frame} frame */
export function drawHistogram(viewer, frame) {
  const { state, scene } = viewer;
  if (!scene) return;
  const canvas = /** @type {HTMLCanvasElement} */ (document.getElementById("histogram"));
  const unit = (MIDDLE_GREY * scene.radiance_scale) / 2 ** state.exposure;
  const counts = histogram(frame, scene.luminance_weights, { unit, ...HISTOGRAM });
  const dots = devicePixelRatio;
  const [width, height] = [canvas.clientWidth || 248, 64];
  if (canvas.width !== Math.round(width * dots)) [canvas.width, canvas.height] = [Math.round(width * dots), height * dots];
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.setTransform(dots, 0, 0, dots, 0, 0);
  context.clearRect(0, 0, width, height);
  const x = (/** @type {number} */ stops) => ((stops - HISTOGRAM.low) / (HISTOGRAM.high - HISTOGRAM.low)) * width;
  // White is where the curve "none" clips: log2(1 / 0.18) stops.
  context.fillStyle = "#242424";
  context.fillRect(x(-Math.log2(MIDDLE_GREY)), 0, width, height);
  const peak = Math.max(1, ...counts.map(Math.sqrt));
  context.fillStyle = "#b4b4b4";
  counts.forEach((count, i) => {
    const tall = (Math.sqrt(count) / peak) * (height - 4);
    context.fillRect((i / counts.length) * width, height - tall, width / counts.length - 0.5, tall);
  });
  const mark = (/** @type {number} */ stops, /** @type {string} */ color) => {
    context.fillStyle = color;
    context.fillRect(x(stops), 0, 1, height);
  };
  mark(0, "#777");
  if (state.zebra) [state.zebraLow, state.zebraHigh].forEach((stops) => mark(stops, "#fff"));
  byId("histogram-low").textContent = signed(HISTOGRAM.low, 0);
  byId("histogram-high").textContent = signed(HISTOGRAM.high, 0);
}
