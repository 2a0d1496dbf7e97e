/** What a page with its scene in it shows before its first picture, and where the browser cannot render: pictures that were made with the page. */

import { byId } from "../dom/elements.js";

/** @typedef {import("./embedded.js").Embedded} Embedded */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** @implements {Part} */
export class Poster {
  /** @param {Viewer} viewer @param {Embedded} source */
  constructor(viewer, source) {
    this.viewer = viewer;
    this.source = source;
    source.changed = () => viewer.changed();
    showPoster(source.facts.poster);
  }

  // Until there is a picture of the scene itself.
  reflect() {
    const { viewer, source } = this;
    // Nothing can be orbited.
    if (source.failure && !viewer.shown) byId("hint").classList.add("gone");
    const instead = source.failure === "" ? "" : source.thumbnail(viewer.state.view);
    showPoster(viewer.shown === null ? instead || source.facts.poster : "");
  }

  taken() {
    showPoster("");
  }
}

/** Shows a picture in the place of the scene; none for "". @param {string} address */
export function showPoster(address) {
  const image = byId("poster");
  image.hidden = address === "";
  if (address && image.src !== address) image.src = address;
}
