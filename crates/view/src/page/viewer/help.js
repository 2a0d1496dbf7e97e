/** Keys: what each does, once for the handler and for the page of help. */

import { SPLATS } from "../scene/variant.js";

/** @typedef {import("./viewer.js").Viewer} Viewer */
/** @typedef {{ keys: string[], shown: string, what: string, act: (viewer: Viewer) => void }} Key */

/** @param {Viewer} viewer @param {number} by */
const expose = (viewer, by) => viewer.set({ exposure: Math.round((viewer.state.exposure + by) * 100) / 100, autoExposure: false });

/** @template T @param {readonly T[]} all @param {T} now @returns {T} */
export const next = (all, now) => all[(all.indexOf(now) + 1) % all.length];

/** @type {readonly Key[]} */
export const KEYS = [
  { keys: ["+", "="], shown: "+", what: "half a stop brighter", act: (v) => expose(v, 0.5) },
  { keys: ["-", "_"], shown: "−", what: "half a stop darker", act: (v) => expose(v, -0.5) },
  { keys: ["0"], shown: "0", what: "exposure of 0 stops", act: (v) => v.set({ exposure: 0, autoExposure: false }) },
  { keys: ["x"], shown: "X", what: "automatic exposure", act: (v) => v.set({ autoExposure: !v.state.autoExposure }) },
  { keys: ["t"], shown: "T", what: "next tone curve", act: (v) => v.cycle("curve") },
  { keys: ["f"], shown: "F", what: "false colour", act: (v) => v.set({ layer: v.state.layer === "stops" ? "radiance" : "stops" }) },
  { keys: ["l"], shown: "L", what: "radiance, false colour, depth, coverage, normals", act: (v) => v.cycle("layer") },
  { keys: ["z"], shown: "Z", what: "zebra", act: (v) => v.set({ zebra: !v.state.zebra }) },
  { keys: ["v"], shown: "V", what: "values in stops or in luminance", act: (v) => v.radiometry?.choose(v.state.scale === "stops" ? "luminance" : "stops") },
  { keys: ["k"], shown: "K", what: "splats blended, as ellipsoids, as centres", act: (v) => v.set({ splats: next(SPLATS, v.state.splats) }) },
  { keys: ["g"], shown: "G", what: "compare: wipe, difference, flicker, side by side", act: (v) => v.cycle("compare") },
  { keys: ["n"], shown: "N", what: "next camera", act: (v) => v.standAtNext(1) },
  { keys: ["b"], shown: "B", what: "camera before", act: (v) => v.standAtNext(-1) },
  { keys: ["c"], shown: "C", what: "cameras in the scene", act: (v) => v.set({ showCameras: !v.state.showCameras }) },
  { keys: ["m"], shown: "M", what: "orbit, fly, walk", act: (v) => v.cycle("mode") },
  { keys: ["h"], shown: "H", what: "home", act: (v) => v.home() },
  { keys: ["j"], shown: "J", what: "level the horizon", act: (v) => v.controls.level() },
  { keys: ["p"], shown: "P", what: "pin the value under the pointer", act: (v) => v.probes?.pinHere() },
  { keys: ["o"], shown: "O", what: "place a light probe with the next click", act: (v) => v.environment?.toggle() },
  { keys: ["u"], shown: "U", what: "place an object with the next click", act: (v) => v.placed?.toggle() },
  { keys: ["y"], shown: "Y", what: "add the view to the camera path", act: (v) => v.path?.add() },
  { keys: ["r"], shown: "R", what: "play the camera path, or stop it", act: (v) => v.path?.toggle() },
  { keys: ["i"], shown: "I", what: "picture alone", act: (v) => v.togglePanel() },
  { keys: ["?"], shown: "?", what: "this page", act: (v) => v.toggleHelp() },
];

/** Gestures. @type {readonly [string, string][]} */
const GESTURES = [
  ["drag", "orbit about the pivot; look around in fly and walk"],
  ["right drag, Shift", "move sideways"],
  ["wheel, pinch", "nearer or farther"],
  ["double-click", "set the pivot on what is there"],
  ["click", "pin the value there; on a camera, stand there"],
  ["two fingers", "move sideways, nearer or farther"],
];

/** @param {HTMLElement} body */
export function fillHelp(body) {
  const heading = (/** @type {string} */ text) => body.append(Object.assign(document.createElement("h3"), { textContent: text }));
  const line = (/** @type {HTMLElement} */ left, /** @type {string} */ text) => {
    const row = document.createElement("div");
    const [a, b] = [document.createElement("span"), document.createElement("span")];
    a.append(left);
    b.textContent = text;
    row.append(a, b);
    body.append(row);
  };
  const key = (/** @type {string} */ text) => Object.assign(document.createElement("kbd"), { textContent: text });
  heading("Pointer");
  for (const [gesture, what] of GESTURES) line(Object.assign(document.createElement("span"), { textContent: gesture }), what);
  heading("Keys");
  line(key("W A S D, arrows"), "move; Q and E down and up, Shift faster");
  for (const { shown, what } of KEYS) line(key(shown), what);
  heading("Numbers");
  line(Object.assign(document.createElement("span"), { textContent: "radiance" }), "in the units of the data set, as luxel render writes it; half precision");
  line(Object.assign(document.createElement("span"), { textContent: "EV100" }), "exposure value at ISO 100: log2 of luminance in cd/m² times 8, where the data set is calibrated");
  line(Object.assign(document.createElement("span"), { textContent: "stops" }), "log2 of luminance over middle grey (0.18 of white) at the exposure in force");
}
