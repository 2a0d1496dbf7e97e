/** Values under the pointer and pinned ones, the distance of the last two, the scale of the scene. */

import { MIDDLE_GREY, signed, text } from "./measure.js";
import { length, sub } from "./math.js";

/** @typedef {import("./measure.js").Sample} Sample */
/** @typedef {import("./main.js").Viewer} Viewer */

/** @param {Viewer} viewer @param {Sample} sample */
export function stopsOf(viewer, sample) {
  const gain = 2 ** viewer.state.exposure / (viewer.scene?.radiance_scale ?? 1);
  return Math.log2((sample.luminance * gain) / MIDDLE_GREY);
}

/** Rows of a sample: name and value. @param {Viewer} viewer @param {Sample} sample @returns {[string, string][]} */
function rows(viewer, sample) {
  /** @type {[string, string][]} */
  const all = [
    ["RGB", sample.radiance.map(text).join("  ")],
    ["luminance", text(sample.luminance)],
    ["stops", signed(stopsOf(viewer, sample), 2)],
  ];
  if (sample.depth !== null) all.push(["depth", viewer.lengthText(sample.depth)]);
  if (sample.position) all.push(["position", sample.position.map(text).join("  ")]);
  return all;
}

/** @param {HTMLElement} element @param {Viewer} viewer @param {Sample | null} sample @param {Sample | null} truth */
export function fillReadout(element, viewer, sample, truth) {
  element.hidden = sample === null;
  if (!sample) return;
  const all = [/** @type {[string, string]} */ (["pixel", `${sample.x}, ${sample.y}`]), ...rows(viewer, sample)];
  if (truth) all.push(["ground truth", truth.radiance.map(text).join("  ")], ["render / truth", `${signed(Math.log2(sample.luminance / truth.luminance), 2)} stops`]);
  element.replaceChildren(
    ...all.map(([name, value]) => {
      const item = document.createElement("span");
      item.append(Object.assign(document.createElement("b"), { textContent: name }), value);
      return item;
    }),
  );
}

/** A button for the light at a point. @param {Viewer} viewer @param {import("./math.js").Vec3} at */
function environmentButton(viewer, at) {
  const command = `luxel probe ${viewer.scene?.name ?? ""} --at ${at.map((v) => v.toPrecision(5)).join(",")} -o probe.exr`;
  const button = Object.assign(document.createElement("button"), { textContent: "copy probe command", title: `The light that arrives here, as an environment map: ${command}` });
  button.addEventListener("click", () => void navigator.clipboard?.writeText(command).catch(() => undefined));
  return button;
}

/** @param {HTMLElement} list @param {HTMLElement} distance @param {Viewer} viewer */
export function fillPins(list, distance, viewer) {
  list.replaceChildren(
    ...viewer.pins.map((pin, i) => {
      const item = document.createElement("li");
      const [name, values] = [document.createElement("span"), document.createElement("div")];
      name.textContent = `${i + 1}`;
      for (const [label, value] of rows(viewer, pin)) values.append(`${label} ${value}`, document.createElement("br"));
      const remove = Object.assign(document.createElement("button"), { textContent: "×", title: "Remove this probe" });
      remove.setAttribute("aria-label", `Remove probe ${i + 1}`);
      remove.addEventListener("click", () => viewer.unpin(i));
      if (pin.position) values.append(environmentButton(viewer, pin.position));
      item.append(name, values, remove);
      return item;
    }),
  );
  distance.replaceChildren();
  const apart = viewer.apart();
  if (apart === null) return;
  const row = document.createElement("div");
  row.className = "row";
  const scale = Object.assign(document.createElement("button"), { textContent: "this is 1 m", title: "Sets the length of a world unit, by which lengths are shown in metres" });
  scale.addEventListener("click", () => viewer.set({ metres: 1 / apart }));
  row.append(`distance ${viewer.lengthText(apart)}`, scale);
  if (viewer.state.metres > 0) {
    const forget = Object.assign(document.createElement("button"), { textContent: "world units" });
    forget.addEventListener("click", () => viewer.set({ metres: 0 }));
    row.append(forget);
  }
  distance.append(row);
}

/** Distance of the last two pins with a position, world units; null without them. @param {Sample[]} pins */
export function distanceOf(pins) {
  const [b, a] = pins.filter((pin) => pin.position).slice(-2).map((pin) => pin.position);
  return a && b ? length(sub(a, b)) : null;
}
