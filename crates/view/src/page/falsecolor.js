/**
 * Colours for numbers: the same table colours pictures (as a texture) and legends, so that a legend
 * cannot be wrong. Stops are relative to middle grey (0.18) at the exposure in force.
 */

/** Lowest and highest stop that has a colour of its own. */
export const STOPS = { low: -8, high: 8 };
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

/** Texels of the table of whole stops. */
export const STOP_TEXELS = STOPS.high - STOPS.low + 1;

/** Both tables as rows of RGBA pixels: whole stops, then 256 steps of difference. @returns {{ stops: Uint8Array, difference: Uint8Array }} */
export function tables() {
  const stops = new Uint8Array(4 * STOP_TEXELS);
  for (let i = 0; i < STOP_TEXELS; i++) stops.set([...colorOfStops(STOPS.low + i), 255], 4 * i);
  const difference = new Uint8Array(4 * 256);
  for (let i = 0; i < 256; i++) difference.set([...colorOfDifference((i / 255) * (DIFFERENCE.high - DIFFERENCE.low)), 255], 4 * i);
  return { stops, difference };
}
