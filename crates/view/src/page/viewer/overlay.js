/** Lines and labels over the picture: cameras of the data set, pinned probes, the pivot, the wipe. */

import { lensOfView, poseOf, project, runsOf } from "../math/lens.js";
import { ring } from "../math/projections.js";
import { add, times } from "../math/vectors.js";

/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../scene/scene.js").ViewCamera} ViewCamera */

/** Points around the field of a camera that is no pinhole; each fourth part has a spoke. */
const SIDES = 16;

/** Points around the edge of a camera's field at a distance, in the world: of a pinhole the corners of its picture. @param {ViewCamera} camera @param {number} distance @returns {Vec3[]} */
function outlineOf(camera, distance) {
  const lens = lensOfView(camera, camera.w, camera.h);
  const { right, up, back } = lens.axes;
  const corners = [[0, 0], [camera.w, 0], [camera.w, camera.h], [0, camera.h]].map(([x, y]) => /** @type {Vec3} */ ([(x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy, 1]));
  const rays = lens.projection.kind === "pinhole" ? corners : ring(lens.projection, SIDES);
  return rays.map(([x, y, z]) => add(lens.eye, times(add(add(times(right, x), times(up, -y)), times(back, -z)), distance)));
}

export class Overlay {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    this.plain = context;
    this.isEmpty = true;
  }

  /** Where marks are drawn. */
  get context() {
    this.isEmpty = false;
    return this.plain;
  }

  /** Begins a picture of `width` x `height` screen pixels. @param {number} width @param {number} height */
  clear(width, height) {
    const dots = devicePixelRatio;
    const [w, h] = [Math.round(width * dots), Math.round(height * dots)];
    if (this.canvas.width !== w || this.canvas.height !== h) [this.canvas.width, this.canvas.height] = [w, h];
    this.plain.setTransform(dots, 0, 0, dots, 0, 0);
    this.plain.clearRect(0, 0, width, height);
    this.isEmpty = true;
  }

  /** Ends a picture: an empty layer is taken away, since it costs as much as a full one. */
  end() {
    this.plain.restore();
    this.canvas.hidden = this.isEmpty;
  }

  /** Begins the marks of one of the pictures side by side. @param {number} left @param {number} width @param {number} height */
  begin(left, width, height) {
    const dots = devicePixelRatio;
    this.plain.restore();
    this.plain.save();
    this.plain.setTransform(dots, 0, 0, dots, left * dots, 0);
    this.plain.beginPath();
    this.plain.rect(0, 0, width, height);
    this.plain.clip();
  }

  /** @param {Vec3[]} points @param {Lens} lens @param {boolean} [closed] */
  path(points, lens, closed = false) {
    const { context } = this;
    context.beginPath();
    for (const run of runsOf(lens, points, closed)) run.forEach(({ x, y }, i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.stroke();
  }

  /** @param {ViewCamera[]} cameras @param {Lens} lens @param {number} size @param {string} current */
  cameras(cameras, lens, size, current) {
    const { context } = this;
    for (const camera of cameras) {
      if (camera.name === current) continue;
      context.strokeStyle = camera.split === "test" ? "#ffffffaa" : "#ffffff66";
      context.setLineDash(camera.split === "test" ? [3, 3] : []);
      const { eye } = poseOf(camera);
      const far = outlineOf(camera, size);
      this.path(far, lens, true);
      far.forEach((point, i) => i % (far.length / 4) === 0 && this.path([eye, point], lens));
    }
    context.setLineDash([]);
  }

  /** The camera whose eye is nearest to a place on the screen, within a few pixels. @param {ViewCamera[]} cameras @param {Lens} lens @param {number} x @param {number} y */
  static cameraAt(cameras, lens, x, y) {
    let [best, nearest] = [/** @type {ViewCamera | null} */ (null), 14];
    for (const camera of cameras) {
      const place = project(lens, poseOf(camera).eye);
      const away = place ? Math.hypot(place.x - x, place.y - y) : Infinity;
      if (away < nearest) [best, nearest] = [camera, away];
    }
    return best;
  }

  /** @param {Vec3} point @param {Lens} lens @param {string} label */
  pin(point, lens, label) {
    const place = project(lens, point);
    if (!place) return;
    const { context } = this;
    context.lineWidth = 3;
    context.strokeStyle = "#000a";
    for (const pass of [0, 1]) {
      if (pass) [context.lineWidth, context.strokeStyle] = [1, "#fff"];
      context.beginPath();
      context.arc(place.x, place.y, 5, 0, 2 * Math.PI);
      context.moveTo(place.x - 9, place.y);
      context.lineTo(place.x + 9, place.y);
      context.moveTo(place.x, place.y - 9);
      context.lineTo(place.x, place.y + 9);
      context.stroke();
    }
    this.label(label, place.x + 11, place.y - 6);
  }

  /** A mirror ball. @param {Vec3} point @param {Lens} lens @param {string} label */
  ball(point, lens, label) {
    const place = project(lens, point);
    if (!place) return;
    const { context } = this;
    const shine = context.createRadialGradient(place.x - 3, place.y - 4, 1, place.x, place.y, 9);
    shine.addColorStop(0, "#fff");
    shine.addColorStop(0.5, "#888");
    shine.addColorStop(1, "#222");
    context.beginPath();
    context.arc(place.x, place.y, 9, 0, 2 * Math.PI);
    context.fillStyle = shine;
    context.fill();
    [context.strokeStyle, context.lineWidth] = ["#fff", 1];
    context.stroke();
    this.label(label, place.x + 14, place.y + 4);
  }

  /** @param {Vec3} a @param {Vec3} b @param {Lens} lens @param {string} label */
  ruler(a, b, lens, label) {
    const [from, to] = [project(lens, a), project(lens, b)];
    if (!from || !to) return;
    this.context.strokeStyle = "#fffc";
    this.context.setLineDash([4, 3]);
    this.path([a, b], lens);
    this.context.setLineDash([]);
    this.label(label, (from.x + to.x) / 2 + 8, (from.y + to.y) / 2);
  }

  /** @param {string} text @param {number} x @param {number} y */
  label(text, x, y) {
    const { context } = this;
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = "#161616d9";
    context.fillRect(x - 3, y - 11, context.measureText(text).width + 6, 15);
    context.fillStyle = "#eee";
    context.fillText(text, x, y);
  }

  /** @param {number} x @param {number} height */
  wipe(x, height) {
    const { context } = this;
    context.fillStyle = "#000";
    context.fillRect(x - 1.5, 0, 3, height);
    context.fillStyle = "#fff";
    context.fillRect(x - 0.5, 0, 1, height);
    context.beginPath();
    context.arc(x, height / 2, 9, 0, 2 * Math.PI);
    context.fillStyle = "#161616";
    context.fill();
    context.strokeStyle = "#fff";
    context.lineWidth = 1;
    context.stroke();
    context.fillStyle = "#fff";
    context.font = "11px system-ui, sans-serif";
    context.fillText("◂▸", x - 8, height / 2 + 4);
  }
}
