/**
 * What a part of the viewer may have: the viewer calls what is there. Each part owns a section of
 * the panel, or marks over the picture, or a use of the pointer.
 *
 * A part is constructed with the viewer, connects its own controls, and changes what the user
 * chooses through `viewer.set({...})`, after which `reflect` of all parts is called. A section or
 * control that needs the program has the attribute `data-server`, and is not in a page that was
 * saved with its scene (`viewer.source` is then an `Embedded`).
 */

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("./overlay.js").Overlay} Overlay */
/** @typedef {import("../scene/scene.js").Scene} Scene */
/** @typedef {import("../scene/scene.js").Status} Status */
/** @typedef {import("../scene/stream.js").Shown} Shown */

/** A drag that a part has taken hold of; places are pixels of the screen in the picture. @typedef {{ move: (x: number, y: number, event: PointerEvent) => void, end?: () => void }} Grip */

/**
 * @typedef {object} Part
 * @property {(scene: Scene, isAgain: boolean) => void} [sceneSet] a scene came, or the same again after the connection was lost
 * @property {(status: Status) => void} [followed] the newest state of the server
 * @property {() => void} [reflect] shows what is set, after something has changed
 * @property {(shown: Shown) => void} [altered] changes a picture that came, before anybody sees it
 * @property {(shown: Shown) => void} [taken] a picture came
 * @property {(now: number, seconds: number) => void} [step] at each beat of the clock (dom/pace.js)
 * @property {(overlay: Overlay, lens: Lens) => void} [draw] marks over the picture; `lens` is in pixels of the screen
 * @property {(x: number, y: number, event: PointerEvent) => Grip | null} [grab] takes hold of a drag that starts here
 * @property {(x: number, y: number, event: PointerEvent) => boolean} [clicked] uses a click; true if nobody else shall
 * @property {(x: number, y: number) => void} [hovered] the pointer is here; outside of the picture at -1, -1
 */

export {};
