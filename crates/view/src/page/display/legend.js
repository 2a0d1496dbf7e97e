/** The legend of false colour, of the map of differences, and of normals. */

import { byId } from "../dom/elements.js";
import { signed } from "../picture/pixels.js";
import { unitName } from "../picture/units.js";
import { colorOfBand, colorOfDifference, colorOfSigned, colorOfStops, DIFFERENCE, luminanceOfBand, RELATIVE_HIGH, STOP_TEXELS, STOPS } from "./falsecolor.js";

/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */
/** A line: the value, which tests read too, its colour and its text. @typedef {{ value: number, color: readonly number[], text: string }} Line */

/** Two digits, without a power of ten where people would write none. @param {number} v */
const short = (v) => (v >= 1e7 || v < 1e-3 ? v.toExponential(0) : String(Number(v.toPrecision(2))));

/** @param {number} low @param {number} high @param {number} step @param {(value: number) => Line} line */
const lines = (low, high, step, line) => Array.from({ length: Math.round((high - low) / step) + 1 }, (_, i) => line(high - i * step));

/** Heading and lines of what is shown; null where there is nothing to explain. @param {Viewer} viewer @returns {{ heading: string, lines: Line[] } | null} */
function content(viewer) {
  const { state, comparison } = viewer;
  if (comparison?.isOn() && state.compare === "difference") {
    const { high } = DIFFERENCE;
    const masked = viewer.display.truthMask ? "; hatched: masked" : "";
    const more = (/** @type {number} */ value, /** @type {string} */ text) => (value === high ? `${text} and more` : value === -high ? `${text} and less` : text);
    if (state.error === "relative") return { heading: `relative error${masked}`, lines: lines(0, RELATIVE_HIGH, 0.125, (value) => ({ value, color: colorOfDifference((value / RELATIVE_HIGH) * high), text: `${(100 * value).toFixed(1)} %${value === RELATIVE_HIGH ? " and more" : ""}` })) };
    if (state.error === "signed") return { heading: `brighter or darker than ${comparison.otherName()}, stops${masked}`, lines: lines(-high, high, 0.5, (value) => ({ value, color: colorOfSigned(value), text: more(value, signed(value, 1)) })) };
    return { heading: `difference, stops${masked}`, lines: lines(0, high, 0.5, (value) => ({ value, color: colorOfDifference(value), text: more(value, String(value)) })) };
  }
  if (state.layer === "normals") {
    const axes = [["+x", [255, 128, 128]], ["+y", [128, 255, 128]], ["+z", [128, 128, 255]]];
    return { heading: "normals from depth, world", lines: axes.map(([text, color], i) => ({ value: i, color: /** @type {number[]} */ (color), text: String(text) })) };
  }
  if (state.layer !== "stops") return null;
  if (state.scale === "luminance") {
    const last = STOP_TEXELS - 1;
    return { heading: `luminance, ${unitName(viewer)}`, lines: lines(0, last, 1, (band) => ({ value: band, color: colorOfBand(band), text: `${short(luminanceOfBand(viewer, band))}${band === last ? " and more" : band === 0 ? " and less" : ""}` })) };
  }
  return { heading: "stops around middle grey", lines: lines(STOPS.low, STOPS.high, 1, (value) => ({ value, color: colorOfStops(value), text: value === 0 ? "0 middle grey" : `${signed(value, 0)}${value === STOPS.high ? " and more" : value === STOPS.low ? " and less" : ""}` })) };
}

/** @param {Viewer} viewer */
export function showLegend(viewer) {
  const element = byId("legend");
  const shown = content(viewer);
  element.hidden = shown === null;
  const kind = shown ? shown.heading + shown.lines.map((line) => line.text).join() : "";
  if (!shown || element.dataset.kind === kind) return;
  element.dataset.kind = kind;
  const heading = Object.assign(document.createElement("p"), { textContent: shown.heading });
  element.setAttribute("aria-label", `Legend: ${shown.heading}`);
  element.replaceChildren(
    heading,
    ...shown.lines.map(({ value, color, text }) => {
      const row = document.createElement("div");
      row.dataset.stops = String(value);
      const swatch = document.createElement("i");
      swatch.style.background = `rgb(${color.join(",")})`;
      row.append(swatch, text);
      return row;
    }),
  );
}
