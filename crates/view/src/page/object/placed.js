/** An object placed by clicking: in the light of the scene, with its shadow on what the picture shows. */

import { byId } from "../dom/elements.js";
import { project } from "../math/lens.js";
import { add, cross, dot, length, sub, times, turn, unit } from "../math/vectors.js";
import { text } from "../picture/pixels.js";
import { checked } from "../scene/server.js";
import { ballCaster, drawBall, GREY } from "./ball.js";
import { readGlb } from "./glb.js";
import { irradianceOf, outline } from "./lamps.js";
import { card, CHROME, matt, standing } from "./mesh.js";
import { drawShadow } from "./shadow.js";
import { PlacedSolid, Solid } from "./solid.js";
import { surfaceAt } from "./surface.js";
import { teapot } from "./teapot.js";

/** @typedef {import("./lamps.js").Light} Light */
/** @typedef {import("./mesh.js").Mesh} Mesh */
/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../viewer/overlay.js").Overlay} Overlay */
/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Frame} Frame */
/** @typedef {import("../scene/stream.js").Shown} Shown */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */
/** An object that stands somewhere: the surface under it, where its front is before it is turned, its light. @typedef {{ under: import("./surface.js").Plane, front: Vec3, light: Light | null }} Standing */

/** Points around a lamp's mark. */
const MARKS = 32;
/** Reflectance of a photographer's grey card, and of its white side. */
const [CARD_GREY, CARD_WHITE] = [0.18, 0.9];
/** Time after the last change of a slider at which the shadow is drawn again, ms. */
const REST_MS = 200;

/** Objects of triangles by their names in the list; `isUpright` where the surface is level. @type {{ [kind: string]: (isLevel: boolean) => Mesh }} */
const MESHES = {
  "grey-card": (isLevel) => card(matt(CARD_GREY), !isLevel),
  "white-card": (isLevel) => card(matt(CARD_WHITE), !isLevel),
  teapot: () => teapot(matt(GREY)),
  "chrome-teapot": () => teapot(CHROME),
};

/** @implements {Part} */
export class Placed {
  /** @type {Standing | null} */ object = null;
  isPlacing = false;
  asked = 0;
  /** Ends the search for lamps that is under way. @type {AbortController | null} */ finding = null;
  message = "";
  /** The mesh of the user's file. @type {Solid | null} */ own = null;
  /** Meshes that were made, by kind and whether the surface is level. @type {Map<string, Solid>} */ made = new Map();
  /** Pictures as they came. @type {WeakMap<Frame, Uint16Array>} */ plain = new WeakMap();
  /** Set while a slider moves, when meshes have no shadow. @type {ReturnType<typeof setTimeout> | undefined} */ resting = undefined;

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    this.kind = /** @type {HTMLSelectElement} */ (/** @type {unknown} */ (byId("object-kind")));
    const file = byId("object-file");
    byId("object-tool").addEventListener("click", () => this.toggle());
    byId("object-remove").addEventListener("click", () => this.remove());
    byId("object-open").addEventListener("click", () => file.click());
    file.addEventListener("change", () => {
      if (file.files?.[0]) void this.open(file.files[0]);
      file.value = "";
    });
    this.kind.addEventListener("change", () => this.again());
    for (const id of ["object-size", "object-turn"]) byId(id).addEventListener("input", () => this.slide());
  }

  /** Half of the object's longest side, the radius of a ball, world units. */
  radius() {
    return this.viewer.controls.size * 2 ** byId("object-size").valueAsNumber;
  }

  /** The mesh of the kind that is chosen; null for a ball. @returns {Solid | null} */
  solid() {
    const kind = this.kind.value;
    if (kind === "own") return this.own;
    const make = MESHES[kind];
    if (!make || !this.object) return null;
    const isLevel = dot(this.object.under.normal, this.viewer.up()) > 0.99;
    const key = `${kind} ${isLevel}`;
    const solid = this.made.get(key) ?? new Solid(standing(make(isLevel)));
    this.made.set(key, solid);
    return solid;
  }

  /** Takes up the tool, or puts it down. */
  toggle() {
    this.isPlacing = !this.isPlacing;
    this.viewer.canvas.style.cursor = this.isPlacing ? "cell" : "";
    this.viewer.changed();
  }

  remove() {
    this.asked++;
    this.finding?.abort();
    [this.object, this.finding, this.message] = [null, null, ""];
    this.again();
  }

  /** Takes the triangles of a file as the object. @param {File} file */
  async open(file) {
    try {
      const { mesh, ignored } = readGlb(await file.arrayBuffer(), this.fromRec709());
      this.own = new Solid(standing(mesh));
      const option = /** @type {HTMLOptionElement} */ (this.kind.querySelector("[value=own]"));
      [option.hidden, option.textContent, this.kind.value] = [false, file.name, "own"];
      if (!this.object && !this.isPlacing) this.toggle();
      const count = `${(mesh.indices.length / 3).toLocaleString("en")} triangles`;
      this.say(`${file.name}: ${count}${ignored.length ? `; ignored: ${ignored.join(", ")}` : ""}${this.object ? "" : ". Click where it shall stand."}`);
      this.again();
    } catch (error) {
      this.say(`${file.name}: ${/** @type {Error} */ (error).message}`);
    }
  }

  /** Turns linear Rec.709 into the colours of the scene. @returns {(rgb: Vec3) => Vec3} */
  fromRec709() {
    const [a, b, c] = /** @type {[Vec3, Vec3, Vec3]} */ (this.viewer.scene?.rec709_from_scene ?? [[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
    const columns = [cross(b, c), cross(c, a), cross(a, b)];
    const whole = dot(a, columns[0]);
    return (rgb) => times(rgb.reduce((sum, value, i) => add(sum, times(columns[i], value)), /** @type {Vec3} */ ([0, 0, 0])), 1 / whole);
  }

  /** @param {number} x @param {number} y @param {PointerEvent} event */
  clicked(x, y, event) {
    if (!this.isPlacing || event.button !== 0) return false;
    const { box, clicks } = this.viewer;
    const [u, v] = [x / box.width, y / box.height];
    clicks.at(u, v, ({ position }) => {
      if (!this.isPlacing) return;
      const { shown } = this.viewer;
      const { width, height } = shown?.frame.head ?? { width: 0, height: 0 };
      const under = shown && position && surfaceAt(shown.frame, shown.lens, Math.floor(u * width), Math.floor(v * height), this.viewer.up());
      if (!under) return void this.say("There is nothing to stand on; click a surface in a picture of a pinhole.");
      this.toggle();
      void this.place(under);
    });
    return true;
  }

  /** Puts the object onto a surface, facing the camera, and finds the light there. @param {import("./surface.js").Plane} under */
  async place(under) {
    const asked = ++this.asked;
    this.finding?.abort();
    const abort = (this.finding = new AbortController());
    this.object = { under, front: this.frontOf(under), light: null };
    this.say("finding the lamps …");
    try {
      const { edit } = this.viewer.state;
      const middle = this.middle().map((v) => Number(v.toPrecision(7)));
      const found = await (await checked(await fetch(`/api/lamps?at=${middle.join(",")}${edit ? `&edit=${encodeURIComponent(edit)}` : ""}`, { signal: abort.signal }))).json();
      if (asked !== this.asked || !this.object) return;
      this.object.light = { lamps: found.lamps, map: found.map, fromMap: irradianceOf(found.map) };
      const unseen = found.unseen_share > 0.01 ? `; no view saw ${(100 * found.unseen_share).toFixed(0)} % of all directions` : "";
      this.say(`${found.lamps.length === 1 ? "1 lamp" : `${found.lamps.length} lamps`}${unseen}`);
    } catch (error) {
      if (asked === this.asked && !abort.signal.aborted) this.say(/** @type {Error} */ (error).message);
    } finally {
      if (this.finding === abort) this.finding = null;
    }
    this.again();
  }

  /** The direction along a surface that is towards the camera; where it is seen from straight above, towards the lower edge of the picture. @param {import("./surface.js").Plane} under @returns {Vec3} */
  frontOf({ point, normal }) {
    const { eye, axes } = this.viewer.state;
    const along = (/** @type {Vec3} */ way) => sub(way, times(normal, dot(way, normal)));
    const front = along(unit(sub(eye, point)));
    return unit(length(front) > 1e-3 ? front : along(times(axes.up, -1)));
  }

  /** @param {string} message */
  say(message) {
    this.message = message;
    this.viewer.changed();
  }

  /** Middle of a ball. @returns {Vec3} */
  middle() {
    const { point, normal } = /** @type {Standing} */ (this.object).under;
    return add(point, times(normal, this.radius()));
  }

  /** Draws the picture that is there again, with the object as it is now. */
  again() {
    const { shown } = this.viewer;
    if (shown) this.viewer.take(shown);
    this.viewer.changed();
  }

  /** Draws it again while a slider moves: the shadow of a mesh follows when it rests. */
  slide() {
    clearTimeout(this.resting);
    this.resting = setTimeout(() => {
      this.resting = undefined;
      this.again();
    }, REST_MS);
    this.again();
  }

  /** Puts the object into a picture. @param {Shown} shown */
  altered({ frame, lens, full }) {
    const plain = this.plain.get(frame) ?? frame.rgb;
    frame.rgb = plain;
    const { light, under, front } = this.object ?? {};
    if (!light || !under || !front || lens.projection.kind !== "pinhole" || !frame.head.rgb) return;
    this.plain.set(frame, plain);
    frame.rgb = plain.slice();
    const solid = this.solid();
    if (!solid) {
      const caster = ballCaster(this.middle(), this.radius());
      if (full && frame.depth) drawShadow(frame, lens, light, caster, under);
      return drawBall(frame, lens, light, caster, this.kind.value === "chrome");
    }
    const turned = turn(front, under.normal, (byId("object-turn").valueAsNumber * Math.PI) / 180);
    const pose = { origin: under.point, right: cross(under.normal, turned), up: under.normal, front: turned, scale: this.radius() };
    const placed = new PlacedSolid(solid, pose, light);
    const isRested = full && this.resting === undefined;
    if (isRested && frame.depth) drawShadow(frame, lens, light, placed, under);
    placed.draw(frame, lens, isRested);
  }

  /** @param {Overlay} overlay @param {Lens} lens */
  draw(overlay, lens) {
    const { object, viewer } = this;
    if (!object?.light) return;
    const weights = viewer.scene?.luminance_weights ?? [0, 0, 0];
    overlay.context.strokeStyle = "#ffd76a";
    object.light.lamps.forEach((lamp, i) => {
      for (const line of outline(lamp, lens.eye, MARKS)) overlay.path(line, lens, true);
      const place = project(lens, lamp.middle);
      if (place) overlay.label(`lamp ${i + 1} · power ${text(dot(lamp.power, weights))}`, place.x + 10, place.y - 10);
    });
  }

  reflect() {
    byId("object-tool").setAttribute("aria-pressed", String(this.isPlacing));
    byId("object-row").hidden = byId("object-file-row").hidden = !this.object && !this.isPlacing;
    byId("object-turn").disabled = this.kind.value === "grey" || this.kind.value === "chrome";
    byId("object-text").textContent = this.message;
  }
}
