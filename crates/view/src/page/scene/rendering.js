/** The part that shows and chooses where pictures are rendered: by the server or by the page. */

import { byId, press, segmented } from "../dom/elements.js";
import { megabytes, RENDERINGS, Sources } from "./sources.js";

/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("./sources.js").Rendering} Rendering */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** @implements {Part} */
export class RenderingPanel {
  /** @param {Viewer} viewer @param {Sources} sources */
  constructor(viewer, sources) {
    this.viewer = viewer;
    this.sources = sources;
    segmented(byId("rendering"), RENDERINGS, (name) => viewer.set({ rendering: /** @type {Rendering} */ (name) }));
    sources.changed = (message) => this.changed(message);
  }

  /** @param {string} message */
  changed(message) {
    const { viewer } = this;
    viewer.stream.invalidate();
    viewer.needsReflect = true;
    if (message) viewer.messages.notice(message);
  }

  reflect() {
    const { sources } = this;
    const { rendering } = this.viewer.state;
    if (sources.rendering !== rendering) void sources.choose(rendering);
    press("rendering", rendering);
    byId("rendering-text").textContent = this.facts();
  }

  facts() {
    const { local, isLocal, isLoading, reason, facts } = this.sources;
    const edit = local?.changeBytes ? `, ${megabytes(local.changeBytes)} for the edits` : "";
    const { kind } = this.viewer.lens(1, 1).projection;
    if (isLocal && kind !== "pinhole") return `By the server: the page renders pinholes, this is ${kind === "fisheye" ? "a fisheye" : "a panorama"}.`;
    if (isLocal && local) return `In this page, on ${local.gpu.name}: ${megabytes(local.bytes)} downloaded${edit}.`;
    if (isLoading && !reason) return `By the server; ${megabytes(facts?.download_bytes ?? 0)} of splats are on their way.`;
    return reason ? `By the server: ${reason}.` : "By the server.";
  }
}
