/** Pictures of a scene by the browser's GPU: splats to the device, a lens to a picture of half floats. */

import { dot, times } from "../math/vectors.js";
import { MAP_READ, USAGE } from "./device.js";
import { FORWARD } from "./forward.js";
import { Buffers, compile, Recorder } from "./passes.js";
import { changedRows, copyRow, wholeRow } from "./splats.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("../scene/scene.js").Frame} Frame */
/** @typedef {import("./passes.js").Shard} Shard */
/** @typedef {import("./passes.js").Sizes} Sizes */
/** @typedef {import("./splats.js").Changes} Changes */
/** @typedef {import("./splats.js").Splats} Splats */

/** Bytes in front of the planes of a packed picture. */
const HEAD_BYTES = 16;
/** Times that a picture is tried with more room. */
const TRIES = 4;

/** Fills a structure of the engine's shaders. @param {import("./passes.js").Structure} structure @param {{ [field: string]: number | readonly number[] }} values */
function filled(structure, values) {
  const bytes = new ArrayBuffer(structure.bytes);
  const view = new DataView(bytes);
  for (const [name, { offset, type }] of Object.entries(structure.fields)) {
    [values[name] ?? []].flat().forEach((value, i) => (type === "f32" ? view.setFloat32(offset + 4 * i, value, true) : view.setUint32(offset + 4 * i, value, true)));
  }
  return bytes;
}

/** The uniform of the camera, as the engine has it (screen.rs). @param {Lens} lens @param {Splats} splats @param {number} entries */
function cameraUniform(lens, { head }, entries) {
  const { options } = head;
  const { right, up, back } = lens.axes;
  const row = (/** @type {import("../math/vectors.js").Vec3} */ axis) => [...axis, -dot(axis, lens.eye)];
  const n = options.samples;
  const [size, focal, center] = [[lens.width * n, lens.height * n], [lens.fx * n, lens.fy * n], [lens.cx * n, lens.cy * n]];
  const margin = [0, 1].map((i) => (FORWARD.numbers.jacobianMargin * size[i]) / (2 * focal[i]));
  const { flags } = FORWARD;
  return filled(FORWARD.camera, {
    row_x: row(right),
    row_y: row(times(up, -1)),
    row_z: row(times(back, -1)),
    eye: [...lens.eye, 0],
    background: [...options.background, 0],
    focal_px: focal,
    center_px: center,
    slope_min: [0, 1].map((i) => -center[i] / focal[i] - margin[i]),
    slope_max: [0, 1].map((i) => (size[i] - center[i]) / focal[i] + margin[i]),
    size_px: size,
    tiles: size.map((side) => Math.ceil(side / FORWARD.numbers.tilePx)),
    min_alpha: options.minAlpha,
    min_contribution: options.minContribution ?? 3.4e38,
    alpha_floor: options.alphaFloor,
    min_transmittance: options.minTransmittance,
    max_alpha: options.maxAlpha,
    near: options.near,
    dilation_px2: options.dilationPx2,
    active_degree: options.activeDegree,
    flags: (options.compensatesOpacity ? flags.compensation : 0) + flags.editGain + (options.smooths ? flags.smoothing : 0) + (options.minContribution === null ? 0 : flags.minContribution),
    count: head.splats,
    entry_capacity: entries,
    samples: n,
    dropout_rate: 0,
    opacity_factor: 1,
    dropout_seed: 0,
    padding: 0,
  });
}

/** Copies splats to the device, in runs that fit into a binding. @param {GPUDevice} device @param {Splats} splats @returns {Shard[]} */
function upload(device, splats) {
  const { head } = splats;
  // Behind the parameters: the 3D filter, and the gains of edits, which may come later.
  const rows = head.parameters + 2;
  const most = Math.max(64, Math.floor(device.limits.maxStorageBufferBindingSize / (4 * rows) / 64) * 64);
  const shards = [];
  for (let base = 0; base < head.splats; base += most) {
    const len = Math.min(most, head.splats - base);
    const stride = Math.ceil(len / 64) * 64;
    const uniform = device.createBuffer({ label: "Shard", size: FORWARD.shard.bytes, usage: USAGE.UNIFORM | USAGE.COPY_DST });
    device.queue.writeBuffer(uniform, 0, filled(FORWARD.shard, { base, len, stride }));
    const parameters = device.createBuffer({ label: "Parameters", size: 4 * stride * rows, usage: USAGE.STORAGE | USAGE.COPY_DST, mappedAtCreation: true });
    const values = new Float32Array(parameters.getMappedRange());
    for (let n = 0; n < rows; n++) copyRow(splats, n, base, values.subarray(n * stride, n * stride + len));
    parameters.unmap();
    shards.push({ base, len, stride, uniform, parameters });
  }
  return shards;
}

export class GpuRenderer {
  /** @type {Shard[]} */ shards = [];
  /** @type {Splats | null} */ splats = null;
  /** Rows that differ from those of the scene. @type {number[]} */ changed = [];
  /** @type {Map<string, GPUComputePipeline>} */ pipelines = new Map();
  model = "";
  /** What the device found wrong; "" for nothing. */ fault = "";

  /** @param {GPUDevice} device */
  constructor(device) {
    this.device = device;
    this.buffers = new Buffers(device);
    device.addEventListener("uncapturederror", (event) => (this.fault ||= event.error.message));
  }

  /** Takes a scene in the place of the one before. @param {Splats} splats */
  async load(splats) {
    const { device } = this;
    if (splats.head.colorModel !== this.model) {
      this.pipelines = await compile(device, splats.head.colorModel);
      this.model = splats.head.colorModel;
    }
    device.pushErrorScope("out-of-memory");
    const shards = upload(device, splats);
    if (await device.popErrorScope()) throw new Error(`the GPU has too little memory for ${splats.head.splats.toLocaleString("en")} splats`);
    for (const { uniform, parameters } of this.shards) {
      uniform.destroy();
      parameters.destroy();
    }
    this.shards = shards;
    this.splats = splats;
    this.changed = [];
    this.buffers.setSplats(splats.head.splats);
  }

  /** Makes the scene one under edits; `null` for the scene as it is. @param {Changes | null} changes */
  change(changes) {
    const { splats, device } = this;
    if (!splats) return;
    const rows = changes ? changedRows(splats, changes) : new Map();
    const restored = this.changed.filter((row) => !rows.has(row));
    this.changed = [...rows.keys()];
    for (const row of restored) rows.set(row, wholeRow(splats, row));
    for (const [row, values] of rows) {
      for (const { base, len, stride, parameters } of this.shards) device.queue.writeBuffer(parameters, 4 * row * stride, values, base, len);
    }
  }

  /** Renders a picture. @param {Lens} lens @param {boolean} layers @returns {Promise<Frame>} */
  async render(lens, layers) {
    const { splats } = this;
    if (!splats) throw new Error("no scene is loaded");
    const start = performance.now();
    const { samples } = splats.head.options;
    const [width, height] = [lens.width * samples, lens.height * samples];
    const side = (/** @type {number} */ px) => Math.ceil(px / FORWARD.numbers.tilePx);
    const { firstEntries, expectedTiles } = FORWARD.numbers;
    const count = splats.head.splats;
    /** @type {Sizes} */
    const sizes = { splats: count, entries: Math.max(firstEntries, expectedTiles * count), tiles: side(width) * side(height), pixels: width * height };
    for (let tries = 0; ; tries++) {
      const { state, packed } = await this.once(lens, splats, layers, sizes);
      const field = (/** @type {string} */ name) => state.getUint32(FORWARD.state.fields[name].offset, true);
      if (field("halted") !== FORWARD.halt.overflow) return toFrame(packed, lens, layers, (performance.now() - start) / 1000);
      if (tries === TRIES) throw new Error("the GPU runs out of room for this view");
      // A quarter more, as the engine does.
      sizes.entries = Math.ceil(field("needed") * 1.25);
    }
  }

  /** Renders with the room there is. @param {Lens} lens @param {Splats} splats @param {boolean} layers @param {Sizes} sizes */
  async once(lens, splats, layers, sizes) {
    const { device, buffers } = this;
    const { head } = splats;
    buffers.grow(sizes);
    buffers.setTiles(sizes.tiles);
    const pixels = lens.width * lens.height;
    const pairs = Math.ceil(pixels / 2);
    const named = (/** @type {string} */ name) => /** @type {GPUBuffer} */ (buffers.named.get(name));
    buffers.uniform("Camera", cameraUniform(lens, splats, buffers.sizes.entries));
    const picture = new DataView(new ArrayBuffer(32));
    [lens.width, lens.height, head.options.samples, layers ? 1 : 0].forEach((value, i) => picture.setUint32(4 * i, value, true));
    [head.radianceScale, head.depthUnit].forEach((value, i) => picture.setFloat32(16 + 4 * i, value, true));
    [3 * pairs, 4 * pairs].forEach((value, i) => picture.setUint32(24 + 4 * i, value, true));
    buffers.uniform("picture", picture.buffer);
    device.queue.writeBuffer(named("State"), 0, new ArrayBuffer(FORWARD.state.bytes));
    device.queue.writeBuffer(named("packed"), 0, new ArrayBuffer(HEAD_BYTES));
    const recorder = new Recorder(device, this.pipelines, buffers, { ...sizes });
    recorder.forward(this.shards);
    if (layers) recorder.layers(this.shards);
    recorder.pack(pixels);
    recorder.pass.end();
    const bytes = HEAD_BYTES + 12 * pairs + (layers ? 12 * pairs : 0);
    const stateBytes = FORWARD.state.bytes;
    const back = device.createBuffer({ label: "back", size: stateBytes + bytes, usage: USAGE.MAP_READ | USAGE.COPY_DST });
    recorder.encoder.copyBufferToBuffer(named("State"), 0, back, 0, stateBytes);
    recorder.encoder.copyBufferToBuffer(named("packed"), 0, back, stateBytes, bytes);
    device.queue.submit([recorder.encoder.finish()]);
    await back.mapAsync(MAP_READ);
    if (this.fault) throw new Error(`the browser's GPU refuses: ${this.fault}`);
    const copy = back.getMappedRange().slice(0);
    back.destroy();
    return { state: new DataView(copy, 0, stateBytes), packed: copy.slice(stateBytes) };
  }

  destroy() {
    this.buffers.destroy();
    for (const { uniform, parameters } of this.shards) {
      uniform.destroy();
      parameters.destroy();
    }
  }
}

/** @param {ArrayBuffer} packed @param {Lens} lens @param {boolean} layers @param {number} seconds @returns {Frame} */
function toFrame(packed, { width, height }, layers, seconds) {
  const pixels = width * height;
  const pairs = Math.ceil(pixels / 2);
  const exponent = new DataView(packed).getInt32(4, true);
  return {
    head: { width, height, scale: 2 ** exponent, rgb: true, alpha: layers, depth: layers, version: 0, seconds },
    rgb: new Uint16Array(packed, HEAD_BYTES, 3 * pixels),
    alpha: layers ? new Uint16Array(packed, HEAD_BYTES + 12 * pairs, pixels) : null,
    depth: layers ? new Float32Array(packed, HEAD_BYTES + 16 * pairs, pixels) : null,
  };
}
