/** Everything that a user chooses, in one object, and its form in the address of the page. */

import { COMPARES, CURVES, ERRORS, LAYERS } from "../display/choices.js";
import { KINDS } from "../math/projections.js";
import { looking } from "../math/vectors.js";
import { decimals } from "../picture/units.js";
import { RENDERINGS } from "../scene/sources.js";
import { SPLATS } from "../scene/variant.js";

/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../math/vectors.js").Axes} Axes */
/** @typedef {"orbit" | "fly" | "walk"} Mode */
/** @typedef {import("../display/choices.js").Compare} Compare */
/** @typedef {import("../display/choices.js").Curve} Curve */
/** @typedef {import("../display/choices.js").Layer} Layer */
/** @typedef {"stops" | "luminance"} Scale */

/** @type {readonly Scale[]} */
const SCALES = ["stops", "luminance"];
/** @type {readonly Mode[]} */
export const MODES = ["orbit", "fly", "walk"];

export class State {
  /** @type {Vec3} */ eye = [0, 0, 0];
  /** @type {Axes} */ axes = { right: [1, 0, 0], up: [0, 1, 0], back: [0, 0, 1] };
  /** Point that is orbited. @type {Vec3} */ pivot = [0, 0, -1];
  /** Vertical field of view, degrees. */ fov = 50;
  /** Elsewhere than at a camera of the data set. @type {import("../math/projections.js").Kind} */ projection = "pinhole";
  /** Field of view across the circle of a fisheye, degrees. */ circle = 180;
  /** Camera of the data set in whose place the viewer stands; "" elsewhere. */ view = "";
  /** @type {Mode} */ mode = "orbit";
  /** Stops. */ exposure = 0;
  autoExposure = false;
  /** @type {Curve} */ curve = "agx";
  /** The curve that a scene begins with: none where its colours are a display's. @type {Curve} */ usualCurve = "agx";
  /** @type {Layer} */ layer = "radiance";
  /** @type {Compare} */ compare = "off";
  /** Place of the wipe, 0 to 1. */ wipe = 0.5;
  zebra = false;
  /** Stops around middle grey outside of which stripes are drawn. */ zebraLow = -6;
  zebraHigh = 2.5;
  /** The same as luminance in the unit that is shown; 0 for none. */ zebraBelow = 0;
  zebraAbove = 0;
  /** The values of false colour, zebra and histogram. @type {Scale} */ scale = "stops";
  /** Luminance of a unit of the data set, cd/m2, as the user states it; 0 for that of the data set. */ cdm2 = 0;
  /** @type {import("../display/falsecolor.js").ErrorKind} */ error = "stops";
  /** What is compared with; the ground truth where there is no other scene. @type {"scene" | "truth" | "eye"} */ against = "scene";
  /** Distance between two eyes, world units. */ eyes = 0.064;
  /** How splats are drawn. @type {import("../scene/variant.js").Splats} */ splats = "blended";
  /** Size of ellipsoids, standard deviations, and radius of centres, pixels. */ splatSize = 1;
  /** Opacity below which ellipsoids and centres are left out. */ splatOpacity = 0.1;
  /** Clip planes, world units; 0 for none. */ near = 0;
  far = 0;
  /** F-number of the lens, or the diameter of its aperture in world units; 0 for none. */ fStop = 0;
  aperture = 0;
  /** Distance in focus, world units; 0 where none was chosen. */ focus = 0;
  /** Direction that is up, as three numbers; "" for that of the data set. */ upAxis = "";
  showCameras = false;
  /** Length of a world unit in metres; 0 where unknown. */ metres = 0;
  /** Edits in the text form of `luxel edit`. */ edit = "";
  /** Whether light above white is shown brighter than white, where the screen can. */ hdr = true;
  /** Stops above white; 0 for what the screen tells. */ headroom = 0;
  /** Where pictures are rendered. @type {import("../scene/sources.js").Rendering} */ rendering = "automatic";
}

/** Names in the address, and what kind of value each has. @type {readonly [keyof State, string, "number" | "text" | "flag"][]} */
const FIELDS = [
  ["fov", "fov", "number"],
  ["projection", "projection", "text"],
  ["circle", "circle", "number"],
  ["view", "view", "text"],
  ["mode", "mode", "text"],
  ["exposure", "ev", "number"],
  ["autoExposure", "auto", "flag"],
  ["curve", "curve", "text"],
  ["layer", "layer", "text"],
  ["compare", "compare", "text"],
  ["wipe", "wipe", "number"],
  ["zebra", "zebra", "flag"],
  ["zebraLow", "zlow", "number"],
  ["zebraHigh", "zhigh", "number"],
  ["zebraBelow", "zmin", "number"],
  ["zebraAbove", "zmax", "number"],
  ["scale", "scale", "text"],
  ["cdm2", "cdm2", "number"],
  ["error", "error", "text"],
  ["against", "against", "text"],
  ["eyes", "eyes", "number"],
  ["splats", "splats", "text"],
  ["splatSize", "size", "number"],
  ["splatOpacity", "opacity", "number"],
  ["near", "near", "number"],
  ["far", "far", "number"],
  ["fStop", "fstop", "number"],
  ["aperture", "aperture", "number"],
  ["focus", "focus", "number"],
  ["upAxis", "upaxis", "text"],
  ["showCameras", "cameras", "flag"],
  ["metres", "metres", "number"],
  ["edit", "edit", "text"],
  ["hdr", "hdr", "flag"],
  ["headroom", "headroom", "number"],
  ["rendering", "rendering", "text"],
];

/** Values that a text may have. @type {{ [name: string]: readonly string[] }} */
const CHOICES = { projection: KINDS, mode: MODES, curve: CURVES, layer: LAYERS, compare: COMPARES, scale: SCALES, error: ERRORS, against: ["scene", "truth", "eye"], splats: SPLATS, rendering: RENDERINGS };

/** @param {readonly number[]} v */
const rounded = (v) => v.map((x) => Number(x.toPrecision(7))).join(",");

/** @param {State} state @param {number} size a length of the scene, which decides about digits of places @returns {string} */
export function toHash(state, size) {
  const place = (/** @type {readonly number[]} */ v) => v.map((x) => Number(x.toFixed(decimals(size, 1e-7)))).join(",");
  const fresh = new State();
  fresh.curve = state.usualCurve;
  const query = new URLSearchParams();
  query.set("eye", place(state.eye));
  query.set("look", rounded(state.axes.back.map((x) => -x)));
  query.set("up", rounded(state.axes.up));
  query.set("pivot", place(state.pivot));
  for (const [field, name, kind] of FIELDS) {
    const value = state[field];
    if (value === fresh[field]) continue;
    query.set(name, kind === "flag" ? (value ? "1" : "0") : kind === "number" ? String(Number(Number(value).toPrecision(6))) : String(value));
  }
  return `#${query}`;
}

/** Takes what an address states; a value that makes no sense is left out. Returns whether it has a camera. @param {State} state @param {string} hash */
export function applyHash(state, hash) {
  const query = new URLSearchParams(hash.replace(/^#/, ""));
  const fields = /** @type {{ [name: string]: unknown }} */ (/** @type {unknown} */ (state));
  for (const [field, name, kind] of FIELDS) {
    const text = query.get(name);
    if (text === null) continue;
    if (kind === "flag") fields[field] = text === "1";
    else if (kind === "number" && text !== "" && Number.isFinite(Number(text))) fields[field] = Number(text);
    else if (kind === "text" && (CHOICES[field]?.includes(text) ?? true)) fields[field] = text;
  }
  state.fov = Math.min(Math.max(state.fov, 1), 170);
  state.circle = Math.min(Math.max(state.circle, 1), 300);
  state.splatSize = Math.min(Math.max(state.splatSize, state.splats === "centres" ? 0.5 : 0.01), 10);
  state.splatOpacity = Math.min(Math.max(state.splatOpacity, 0), 1);
  state.eyes = Math.max(state.eyes, 0);
  for (const field of /** @type {const} */ (["fStop", "aperture", "focus"])) state[field] = Math.max(state[field], 0);
  state.near = Math.max(state.near, 0);
  state.far = state.far > state.near ? state.far : 0;
  const vector = (/** @type {string} */ name) => {
    const parts = (query.get(name) ?? "").split(",").map(Number);
    return parts.length === 3 && parts.every(Number.isFinite) ? /** @type {Vec3} */ (parts) : null;
  };
  const [eye, look, up, pivot] = ["eye", "look", "up", "pivot"].map(vector);
  if (!eye || !look || !up) return state.view !== "";
  state.eye = eye;
  state.axes = looking(look, up);
  if (pivot) state.pivot = pivot;
  return true;
}
