/** Where pictures come from: the program that serves the page, or the page itself. */

/** @typedef {import("./connection.js").Listener} Listener */
/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("./scene.js").Frame} Frame */
/** @typedef {import("./scene.js").Scene} Scene */

/** What is rendered: edits in the text form of `luxel edit`; whether radiance is wanted; whether coverage and depth are; whether colours of a display stay as they are stored, in place of their light; a variant of the scene; a name for the one of two pictures at once. @typedef {{ edit: string, radiance: boolean, layers: boolean, isStored?: boolean, variant?: import("./variant.js").Variant, name?: string }} Picture */

/**
 * @typedef {object} Source
 * @property {boolean} isLocal whether the page renders by itself
 * @property {boolean} hasLenses whether it has pictures of fisheyes and panoramas, too
 * @property {boolean} layersApart whether it saves time to ask for coverage and depth after radiance
 * @property {() => Promise<Scene>} scene
 * @property {(lens: Lens, picture: Picture, signal?: AbortSignal) => Promise<Frame | null>} frame a picture; null if a newer one was asked for
 * @property {(view: string) => Promise<Frame>} truth the ground truth of a camera
 * @property {(view: string) => string} thumbnail address of a small picture of a camera's ground truth
 * @property {(on: Listener) => void} listen hears of changes for as long as the page is open
 * @property {(lens: Lens, picture: Picture) => string | null} exr address of the picture as OpenEXR; null where there is none
 */

export {};
