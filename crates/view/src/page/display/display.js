/** Draws half-float pictures with WebGL2: tone curves, false colour, comparison with ground truth. */

import { MIDDLE_GREY, quantile } from "../picture/pixels.js";
import { COMPARES, CURVES, ERRORS, LAYERS } from "./choices.js";
import { DIFFERENCE, RELATIVE_HIGH, STOPS, STOP_TEXELS, tables } from "./falsecolor.js";
import { fragment, VERTEX } from "./shader.js";

/** @typedef {import("../scene/scene.js").Frame} Frame */
/** @typedef {import("../scene/scene.js").Scene} Scene */
/** @typedef {import("./shader.js").Choice} Choice */
/** @typedef {import("../viewer/state.js").State} State */
/** @typedef {"picture" | "truth" | "truthMask" | "depthMap" | "alphaMap" | "stopColors" | "differenceColors"} Unit */

/** A compiled shader and the places of its uniforms. @typedef {{ program: WebGLProgram, places: { [name: string]: WebGLUniformLocation | null } }} Program */

const IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

/** @type {readonly Unit[]} */
const UNITS = ["picture", "truth", "truthMask", "depthMap", "alphaMap", "stopColors", "differenceColors"];
/** The unit of the table of a display, which has three dimensions. */
const TABLE_UNIT = UNITS.length;

export class Display {
  /** @type {Frame | null} */ picture = null;
  /** @type {Frame | null} */ truth = null;
  /** Nearest and farthest depth that is shown. @type {[number, number]} */ depthRange = [0, 1];

  /** Factor from the data set's luminance to the unit that is shown, and the lowest band of false colour in it. */ values = { factor: 1, lowestBand: -8 };
  /** Lens of the depth that is there. @type {import("../math/lens.js").Lens | null} */ lens = null;
  /** Rows of the matrix from the other picture's colour space. */ firstFromOther = IDENTITY;
  /** The table of a display that was uploaded last. @type {Uint16Array | null} */ table = null;
  /** Weights of the other picture's pixels, half floats. @type {Uint16Array | null} */ truthMask = null;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false });
    if (!gl) throw new Error("this browser has no WebGL 2, which the picture is drawn with");
    this.gl = gl;
    /** Shaders by what they are compiled for. @type {Map<string, Program>} */
    this.programs = new Map();
    /** @type {{ [unit: string]: WebGLTexture }} */
    this.textures = {};
    /** @type {Scene | null} */
    this.scene = null;
    this.build();
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.build();
      if (this.picture) this.show(this.picture, true);
      if (this.truth) this.compareWith(this.truth, { firstFromOther: this.firstFromOther, mask: this.truthMask });
    });
  }

  build() {
    const { gl } = this;
    this.programs.clear();
    this.table = null;
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    for (const unit of UNITS) {
      const texture = gl.createTexture();
      this.textures[unit] = texture;
      this.bind(unit);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    }
    const { stops, difference } = tables();
    this.bind("stopColors");
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, STOP_TEXELS, 2, 0, gl.RGBA, gl.UNSIGNED_BYTE, stops);
    this.bind("differenceColors");
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 256, 2, 0, gl.RGBA, gl.UNSIGNED_BYTE, difference);
  }

  /** The shader for a choice, compiled when it is first needed. @param {Choice} choice @returns {Program} */
  program(choice) {
    const key = JSON.stringify(choice);
    const known = this.programs.get(key);
    if (known) return known;
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of /** @type {const} */ ([[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment(choice)]])) {
      const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(`shader: ${gl.getShaderInfoLog(shader)}`);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    gl.useProgram(program);
    /** @type {Program["places"]} */
    const places = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const name = gl.getActiveUniform(program, i)?.name ?? "";
      places[name] = gl.getUniformLocation(program, name);
    }
    UNITS.forEach((unit, i) => places[unit] && gl.uniform1i(places[unit], i));
    if (places.table) gl.uniform1i(places.table, TABLE_UNIT);
    this.programs.set(key, { program, places });
    return { program, places };
  }

  /** @param {Unit} unit */
  bind(unit) {
    this.gl.activeTexture(this.gl.TEXTURE0 + UNITS.indexOf(unit));
    this.gl.bindTexture(this.gl.TEXTURE_2D, this.textures[unit]);
  }

  /** @param {Unit} unit @param {Frame} frame @param {boolean} exact whether a pixel of the screen shows one pixel */
  uploadRadiance(unit, frame, exact) {
    const { gl } = this;
    this.bind(unit);
    const { width, height } = frame.head;
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB16F, width, height, 0, gl.RGB, gl.HALF_FLOAT, frame.rgb);
    const filter = exact ? gl.NEAREST : gl.LINEAR;
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
  }

  /** Takes a new picture. @param {Frame} frame @param {boolean} full whether it is more than a stopgap */
  show(frame, full) {
    const { gl } = this;
    this.picture = frame;
    this.uploadRadiance("picture", frame, full);
    const { width, height } = frame.head;
    if (frame.depth) {
      this.bind("depthMap");
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, width, height, 0, gl.RED, gl.FLOAT, frame.depth);
      this.depthRange = rangeOf(frame.depth);
    }
    if (frame.alpha) {
      this.bind("alphaMap");
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R16F, width, height, 0, gl.RED, gl.HALF_FLOAT, frame.alpha);
    }
  }

  /** Uploads the table of the scene's display. @param {import("../scene/scene.js").DisplayTable} display */
  uploadTable({ side, values }) {
    if (!values || values === this.table) return;
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + TABLE_UNIT);
    gl.bindTexture(gl.TEXTURE_3D, (this.textures.table ??= gl.createTexture()));
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_3D, filter, gl.NEAREST);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.RGB16F, side, side, side, 0, gl.RGB, gl.HALF_FLOAT, values);
    this.table = values;
  }

  /** Takes the ground truth, or a picture of another scene, to compare with. @param {Frame | null} frame @param {{ full?: boolean, firstFromOther?: number[][], mask?: Uint16Array | null }} [how] */
  compareWith(frame, { full = true, firstFromOther = IDENTITY, mask = null } = {}) {
    [this.truth, this.firstFromOther, this.truthMask] = [frame, firstFromOther, mask];
    if (!frame) return;
    this.uploadRadiance("truth", frame, full);
    const { gl } = this;
    this.bind("truthMask");
    // Without a mask every pixel counts.
    if (mask) gl.texImage2D(gl.TEXTURE_2D, 0, gl.R16F, frame.head.width, frame.head.height, 0, gl.RED, gl.HALF_FLOAT, mask);
    else gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4).fill(255));
  }

  /** Sets what turns luminance into colours and stripes. @param {Program["places"]} u @param {State} state @param {Scene} scene */
  setValues(u, state, scene) {
    const { gl, values, lens } = this;
    const grey = (MIDDLE_GREY * scene.radiance_scale) / 2 ** state.exposure;
    const isAbsolute = state.scale === "luminance";
    gl.uniform2f(u.bands, isAbsolute ? 2 * Math.log10(2) : 1, isAbsolute ? 2 * Math.log10(values.factor) - values.lowestBand : -Math.log2(grey) - STOPS.low);
    if (isAbsolute) gl.uniform2f(u.zebraRange, state.zebraBelow / values.factor, state.zebraAbove > 0 ? state.zebraAbove / values.factor : 3e38);
    else gl.uniform2f(u.zebraRange, grey * 2 ** state.zebraLow, grey * 2 ** state.zebraHigh);
    gl.uniform1f(u.differenceHigh, state.error === "relative" ? RELATIVE_HIGH : DIFFERENCE.high);
    gl.uniform1f(u.leastLuminance, grey * 2 ** STOPS.low);
    const rows = this.firstFromOther;
    gl.uniformMatrix3fv(u.firstFromOther, false, [0, 1, 2].flatMap((c) => rows.map((row) => row[c])));
    if (!lens) return;
    gl.uniform4f(u.lens, lens.fx, lens.fy, lens.cx, lens.cy);
    if (lens.projection.kind === "fisheye") gl.uniform4fv(u.fisheye, lens.projection.k);
    gl.uniformMatrix3fv(u.axes, false, [lens.axes.right, lens.axes.up, lens.axes.back].flat());
  }

  /** Draws. @param {State} state @param {boolean} showTruth for the flicker */
  draw(state, showTruth) {
    const { gl, scene, picture, truth } = this;
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    if (!scene || !picture) {
      gl.clearColor(0, 0, 0, 1);
      gl.clear(gl.COLOR_BUFFER_BIT);
      return;
    }
    if (state.curve === "ocio" && scene.display) this.uploadTable(scene.display);
    // Until the table is there.
    const curve = state.curve === "ocio" && !this.table ? "agx" : state.curve;
    const choice = { curve: CURVES.indexOf(curve), layer: LAYERS.indexOf(state.layer), compare: truth ? COMPARES.indexOf(state.compare) : 0, zebra: state.zebra, absolute: state.scale === "luminance", error: ERRORS.indexOf(state.error), projection: state.layer === "normals" && this.lens ? this.lens.projection.kind : "pinhole" };
    const { program, places: u } = this.program(choice);
    gl.useProgram(program);
    // Rows to columns.
    const m = scene.rec709_from_scene;
    gl.uniformMatrix3fv(u.rec709, false, [0, 1, 2].flatMap((c) => m.map((row) => row[c])));
    gl.uniform3fv(u.weights, scene.luminance_weights);
    gl.uniform1f(u.pictureScale, picture.head.scale);
    gl.uniform1f(u.truthScale, truth ? truth.head.scale : 1);
    gl.uniform1f(u.gain, 2 ** state.exposure / scene.radiance_scale);
    if (u.tableRange) gl.uniform2fv(u.tableRange, scene.display?.range_log2 ?? [0, 1]);
    gl.uniform1f(u.wipe, state.wipe);
    gl.uniform1i(u.showTruth, showTruth ? 1 : 0);
    this.setValues(u, state, scene);
    gl.uniform2f(u.depthRange, this.depthRange[0], this.depthRange[1]);
    gl.uniform1f(u.dotsPerPixel, Math.max(1, this.canvas.width / Math.max(1, this.canvas.clientWidth)));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

/** The depths between which most of a picture lies. @param {Float32Array} depth @returns {[number, number]} */
function rangeOf(depth) {
  const step = Math.max(1, Math.floor(depth.length / 4096));
  const values = [];
  for (let i = 0; i < depth.length; i += step) if (depth[i] < 1e30) values.push({ value: depth[i], weight: 1 });
  return values.length ? [quantile(values, 0.01), quantile(values, 0.99)] : [0, 1];
}
