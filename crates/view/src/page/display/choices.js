/** What a picture can be drawn with; shaders are compiled for places in these lists. */

/** @typedef {"none" | "mulaw" | "reinhard" | "aces" | "agx" | "ocio"} Curve */
/** @typedef {"radiance" | "stops" | "depth" | "alpha" | "normals"} Layer */
/** @typedef {"off" | "wipe" | "difference" | "flicker" | "beside"} Compare */

/** Tone curves, as the program has them, and the display of OpenColorIO that it was started with. @type {readonly Curve[]} */
export const CURVES = ["none", "mulaw", "reinhard", "aces", "agx", "ocio"];
/** @type {readonly Layer[]} */
export const LAYERS = ["radiance", "stops", "depth", "alpha", "normals"];
/** @type {readonly Compare[]} */
export const COMPARES = ["off", "wipe", "difference", "flicker", "beside"];
/** @type {readonly import("./falsecolor.js").ErrorKind[]} */
export const ERRORS = ["stops", "signed", "relative"];
