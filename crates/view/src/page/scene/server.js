/** Pictures and facts from the program that serves the page. */

import { toJson } from "../math/lens.js";
import { listen } from "./connection.js";
import { parameters } from "./variant.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("./scene.js").Frame} Frame */
/** @typedef {import("./scene.js").Head} Head */
/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {import("./source.js").Picture} Picture */
/** @typedef {import("./source.js").Source} Source */

/** @param {Response} response */
export async function checked(response) {
  if (response.ok) return response;
  let message = `the server answered ${response.status}`;
  try {
    message = (await response.json()).error ?? message;
  } catch {
    // An answer without words.
  }
  throw new Error(message);
}

/** A picture from an answer of the server; null if a newer request took its place. @param {Response} response @returns {Promise<Frame | null>} */
export async function decode(response) {
  if (response.status === 204) return null;
  /** @type {Head} */
  const head = JSON.parse(response.headers.get("luxel-frame") ?? "");
  const bytes = await response.arrayBuffer();
  const pixels = head.width * head.height;
  let at = head.rgb ? 6 * pixels : 0;
  const rgb = new Uint16Array(bytes, 0, head.rgb ? 3 * pixels : 0);
  let alpha = null;
  let depth = null;
  if (head.alpha) {
    alpha = new Uint16Array(bytes, at, pixels);
    at += 2 * pixels;
  }
  if (head.depth) depth = new Float32Array(at % 4 ? bytes.slice(at) : bytes, at % 4 ? 0 : at, pixels);
  return { head, rgb, alpha, depth };
}

/** The address of a picture. @param {Lens} lens @param {Picture} picture @param {string} more @param {string} [path] */
export function address(lens, { edit, variant }, more, path = "/api/frame") {
  const edits = edit ? `&edit=${encodeURIComponent(edit)}` : "";
  return `${path}?camera=${encodeURIComponent(toJson(lens))}&width=${lens.width}&height=${lens.height}${edits}${parameters(variant)}${more}`;
}

/** The program as a source of pictures. @implements {Source} */
export class Server {
  isLocal = false;
  hasLenses = true;
  layersApart = true;
  /** A name for this page, by which the server knows that a newer request replaces an older one. */
  viewer = crypto.getRandomValues(new Uint32Array(2)).join("-");

  /** @returns {Promise<Scene>} */
  async scene() {
    return (await checked(await fetch("/api/scene"))).json();
  }

  /** @param {Lens} lens @param {Picture} picture @param {AbortSignal} [signal] */
  async frame(lens, picture, signal) {
    const channels = [picture.radiance ? ["rgb"] : [], picture.layers ? ["alpha", "depth"] : []].flat().join(",");
    const more = `&channels=${channels}&viewer=${this.viewer}-${picture.name ?? picture.variant?.scene ?? 0}`;
    return decode(await checked(await fetch(address(lens, picture, more), { signal })));
  }

  /** @param {string} view */
  async truth(view) {
    const frame = await decode(await checked(await fetch(`/api/truth?view=${encodeURIComponent(view)}`)));
    if (!frame) throw new Error("no ground truth came");
    return frame;
  }

  /** @param {string} view */
  thumbnail(view) {
    return `/api/thumbnail?view=${encodeURIComponent(view)}`;
  }

  /** @param {Parameters<typeof listen>[0]} on */
  listen(on) {
    listen(on);
  }

  /** The address of the picture as OpenEXR. @param {Lens} lens @param {Picture} picture */
  exr(lens, picture) {
    return address(lens, picture, "&channels=rgb,alpha,depth", "/api/frame.exr");
  }
}
