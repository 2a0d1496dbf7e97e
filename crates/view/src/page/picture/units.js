/** Luminance in the units of the data set, or in cd/m2 where the length of a unit is known. */

import { MIDDLE_GREY, text } from "./pixels.js";

/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** EV at ISO 100 of 1 cd/m2, as a factor: 2^EV = L S / K with S = 100 and K = 12.5 (ISO 2720). */
const EV100_PER_CD_M2 = 100 / 12.5;

/** Luminance in cd/m2 of one unit of the data set: as the user states it, else as the data set does; 0 where unknown. @param {Viewer} viewer */
export const cdM2PerUnit = ({ state, scene }) => (state.cdm2 > 0 ? state.cdm2 : (scene?.cd_m2_per_unit ?? 0));

/** Factor from the units of the data set to those that are shown. @param {Viewer} viewer */
export const luminanceFactor = (viewer) => cdM2PerUnit(viewer) || 1;

/** Name of the unit of luminance. @param {Viewer} viewer */
export const unitName = (viewer) => (cdM2PerUnit(viewer) > 0 ? "cd/m²" : "units");

/** A luminance of the data set, with its unit. @param {Viewer} viewer @param {number} luminance */
export function luminanceText(viewer, luminance) {
  const factor = cdM2PerUnit(viewer);
  return factor > 0 ? `${text(luminance * factor)} cd/m²` : text(luminance);
}

/** Exposure value at ISO 100 of a luminance of the data set; null where it is not calibrated. @param {Viewer} viewer @param {number} luminance */
export function ev100(viewer, luminance) {
  const factor = cdM2PerUnit(viewer);
  return factor > 0 ? Math.log2(luminance * factor * EV100_PER_CD_M2) : null;
}

/** Stops around middle grey below and above which stripes are drawn, at the exposure in force; infinite for none. @param {Viewer} viewer @returns {[number, number]} */
export function zebraStops(viewer) {
  const { state, scene } = viewer;
  if (state.scale !== "luminance") return [state.zebraLow, state.zebraHigh];
  const grey = (MIDDLE_GREY * (scene?.radiance_scale ?? 1) * luminanceFactor(viewer)) / 2 ** state.exposure;
  return [state.zebraBelow > 0 ? Math.log2(state.zebraBelow / grey) : -1000, state.zebraAbove > 0 ? Math.log2(state.zebraAbove / grey) : 1000];
}

/** Decimals that resolve a thousandth of a length, or of its `part`. @param {number} size @param {number} [part] */
export const decimals = (size, part = 1e-3) => Math.min(12, Math.max(0, Math.ceil(-Math.log10(Math.max(size * part, 1e-12)))));

/** Coordinates of a point as text, to a thousandth of the scene's size. @param {Viewer} viewer @param {readonly number[]} point @param {number} [part] */
export const pointText = (viewer, point, part) => point.map((v) => v.toFixed(decimals(viewer.controls.size, part)));
