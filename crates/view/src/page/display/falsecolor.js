/**
 * Colours for numbers: the same table colours pictures (as a texture) and legends, so that a legend
 * cannot be wrong. Stops are relative to middle grey (0.18) at the exposure in force; luminance has a
 * band for every half decade.
 */

/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */
/** How pixels that differ are coloured. @typedef {"stops" | "signed" | "relative"} ErrorKind */

import { MIDDLE_GREY } from "../picture/pixels.js";
import { cdM2PerUnit } from "../picture/units.js";

/** Lowest and highest stop that has a colour of its own. */
export const STOPS = { low: -8, high: 8 };
/** Number of bands, for stops and for luminance. */
const BANDS = STOPS.high - STOPS.low + 1;
/** Lowest band of luminance in cd/m2, in half decades: 0.01. */
const LOWEST_CD_M2 = -4;
/** Largest relative error that has a colour of its own. */
export const RELATIVE_HIGH = 1;
/** Stops of the map of differences. */
export const DIFFERENCE = { low: 0, high: 4 };

/** Colours at equal distances, dark to bright: blue over green and yellow to red and white; lightness rises. */
const RAMP = [
  [26, 18, 63], [47, 45, 125], [49, 88, 160], [39, 127, 165], [44, 160, 140], [92, 187, 99], [160, 204, 62], [226, 202, 58], [247, 160, 59], [236, 105, 67], [222, 62, 82], [232, 100, 140], [249, 190, 214],
];
/** Within half a stop of middle grey. */
const GREY = [128, 128, 128];

/** @param {number} t 0 to 1 @returns {[number, number, number]} */
function ramp(t) {
  const at = Math.min(Math.max(t, 0), 1) * (RAMP.length - 1);
  const i = Math.min(Math.floor(at), RAMP.length - 2);
  const mix = (/** @type {number} */ c) => Math.round(RAMP[i][c] + (RAMP[i + 1][c] - RAMP[i][c]) * (at - i));
  return [mix(0), mix(1), mix(2)];
}

/** Colour of a number of stops: one per whole stop, middle grey in grey. @param {number} stops @returns {[number, number, number]} */
export function colorOfStops(stops) {
  if (Number.isNaN(stops)) return [255, 0, 255];
  const band = Math.round(Math.min(Math.max(stops, STOPS.low), STOPS.high));
  return band === 0 ? [GREY[0], GREY[1], GREY[2]] : ramp((band - STOPS.low) / (STOPS.high - STOPS.low));
}

/** Colour of a difference in stops. @param {number} stops @returns {[number, number, number]} */
export const colorOfDifference = (stops) => (stops <= 0 ? [0, 0, 0] : ramp((stops - DIFFERENCE.low) / (DIFFERENCE.high - DIFFERENCE.low)));

/** Colour of a band of luminance, 0 to 16. @param {number} band */
export const colorOfBand = (band) => ramp(band / (BANDS - 1));

/** Colour of a signed difference in stops: the render is darker (blue) or brighter (orange). @param {number} stops @returns {[number, number, number]} */
export function colorOfSigned(stops) {
  const t = Math.min(1, Math.abs(stops) / DIFFERENCE.high);
  const end = stops < 0 ? [70, 150, 255] : [255, 150, 50];
  const mix = (/** @type {number} */ c) => Math.round(28 + (end[c] - 28) * t);
  return [mix(0), mix(1), mix(2)];
}

/** The lowest band of luminance, in half decades of the unit that is shown. @param {Viewer} viewer */
export function lowestBand(viewer) {
  if (cdM2PerUnit(viewer) > 0) return LOWEST_CD_M2;
  return Math.round(2 * Math.log10(MIDDLE_GREY * (viewer.scene?.radiance_scale ?? 1))) - (BANDS - 1) / 2;
}

/** Luminance in the middle of a band, in the unit that is shown. @param {Viewer} viewer @param {number} band */
export const luminanceOfBand = (viewer, band) => 10 ** ((lowestBand(viewer) + band) / 2);

/** Texels of the table of whole stops. */
export const STOP_TEXELS = STOPS.high - STOPS.low + 1;

/** Tables of RGBA pixels, two rows each: whole stops, and bands of luminance; 256 steps of a difference, and of a signed one. @returns {{ stops: Uint8Array, difference: Uint8Array }} */
export function tables() {
  const stops = new Uint8Array(2 * 4 * STOP_TEXELS);
  for (let i = 0; i < STOP_TEXELS; i++) {
    stops.set([...colorOfStops(STOPS.low + i), 255], 4 * i);
    stops.set([...colorOfBand(i), 255], 4 * (STOP_TEXELS + i));
  }
  const difference = new Uint8Array(2 * 4 * 256);
  for (let i = 0; i < 256; i++) {
    difference.set([...colorOfDifference((i / 255) * (DIFFERENCE.high - DIFFERENCE.low)), 255], 4 * i);
    difference.set([...colorOfSigned((i / 127.5 - 1) * DIFFERENCE.high), 255], 4 * (256 + i));
  }
  return { stops, difference };
}
