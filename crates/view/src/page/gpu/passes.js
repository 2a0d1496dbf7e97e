/**
 * The engine's passes up to the image, run by the browser: shaders, buffers and the order of kernels
 * are those of the engine (forward.js).
 */

import { USAGE } from "./device.js";
import { FORWARD } from "./forward.js";
import { DEPTHS, LAYERS, PACK } from "./layers.js";

/** @typedef {"splats" | "entries" | "tiles" | "pixels"} Count */
/** @typedef {{ fixed?: number, count?: Count, plus?: number, per?: number, indirect?: number }} Workgroups */
/** @typedef {{ kernel: string, bindings: { slot: number, buffer: string }[], workgroups: Workgroups }} Dispatch */
/** @typedef {{ bytes: number, fields: { [name: string]: { offset: number, type: string, count: number } } }} Structure */
/**
 * @typedef {object} Forward
 * @property {Structure} camera
 * @property {Structure} shard
 * @property {Structure} state
 * @property {{ compensation: number, smoothing: number, minContribution: number, editGain: number }} flags
 * @property {{ none: number, overflow: number }} halt
 * @property {{ depth: number[][], tile: number[][][] }} sorts by tile: for each number of bits of the tiles' numbers
 * @property {{ tilePx: number, maxGroups: number, firstEntries: number, expectedTiles: number, jacobianMargin: number }} numbers
 * @property {{ [buffer: string]: { bytes: number, terms: { largestOf: string[], per: number, bytes: number }[] } }} extents
 * @property {Dispatch} project
 * @property {{ [digits: string]: Dispatch[] }} afterProjection
 * @property {{ [kernel: string]: { texts: number[], hasModel: boolean } }} kernels
 * @property {string[][]} texts
 * @property {{ [model: string]: string }} models
 */
/** How much of each there is. @typedef {{ [count in Count]: number }} Sizes */

/** Least size of a buffer: none is smaller than a structure in it. */
const LEAST_BYTES = 256;

/** The shader of a kernel of the engine. @param {string} kernel @param {string} model */
function source(kernel, model) {
  const { texts, hasModel } = FORWARD.kernels[kernel];
  const parts = texts.map((n) => FORWARD.texts[n].join("\n"));
  if (hasModel) parts[0] += FORWARD.models[model];
  return parts.join("\n");
}

/** The page's own kernels: constants, what all shaders share, and the text. @type {{ [kernel: string]: { text: string, after: string } }} */
const OWN = {
  depths_of_splats: { text: DEPTHS, after: "rasterize" },
  layers_of_samples: { text: LAYERS, after: "rasterize" },
  peak: { text: PACK, after: "sort_count" },
  exponent: { text: PACK, after: "sort_count" },
  pack: { text: PACK, after: "sort_count" },
};

/** The shader of a kernel of the page: all parts of an engine's shader but the last come before it. @param {string} kernel */
function ownSource(kernel) {
  const { text, after } = OWN[kernel];
  return [...FORWARD.kernels[after].texts.slice(0, -1).map((n) => FORWARD.texts[n].join("\n")), text].join("\n");
}

/** Digits of the sort by tile: shift, count, flags, bits. @param {number} tiles */
const tileSort = (tiles) => FORWARD.sorts.tile[32 - Math.clz32(tiles)];

/** Compiles what renders scenes of a colour model. @param {GPUDevice} device @param {string} model */
export async function compile(device, model) {
  if (!(model in FORWARD.models)) throw new Error(`this page does not know the colour model ${model}`);
  /** @type {Map<string, GPUComputePipeline>} */
  const pipelines = new Map();
  const one = async (/** @type {string} */ kernel, /** @type {string} */ code) => {
    const module = device.createShaderModule({ label: kernel, code });
    pipelines.set(kernel, await device.createComputePipelineAsync({ label: kernel, layout: "auto", compute: { module, entryPoint: kernel } }));
  };
  await Promise.all([...Object.keys(FORWARD.kernels).map((kernel) => one(kernel, source(kernel, model))), ...Object.keys(OWN).map((kernel) => one(kernel, ownSource(kernel)))]);
  return pipelines;
}

/** Buffers of a picture by their names, kept between pictures and enlarged when one needs more. */
export class Buffers {
  /** @type {Map<string, GPUBuffer>} */ named = new Map();
  /** @type {Sizes} */ sizes = { splats: 0, entries: 0, tiles: 0, pixels: 0 };

  /** @param {GPUDevice} device */
  constructor(device) {
    this.device = device;
    this.uniform("Camera", new ArrayBuffer(FORWARD.camera.bytes));
  }

  /** @param {string} name @param {ArrayBuffer | Uint32Array<ArrayBuffer>} content */
  uniform(name, content) {
    const known = this.named.get(name);
    const buffer = known ?? this.device.createBuffer({ label: name, size: Math.max(LEAST_BYTES, content.byteLength), usage: USAGE.UNIFORM | USAGE.COPY_DST });
    this.named.set(name, buffer);
    this.device.queue.writeBuffer(buffer, 0, content);
  }

  /** A storage buffer of at least this size. @param {string} name @param {number} bytes */
  storage(name, bytes) {
    const size = Math.ceil(Math.max(LEAST_BYTES, bytes) / 16) * 16;
    const known = this.named.get(name);
    if (known && known.size >= size) return;
    if (size > this.device.limits.maxStorageBufferBindingSize) throw new Error(`the GPU takes no buffer of ${Math.ceil(size / 2 ** 20)} MiB (${name})`);
    known?.destroy();
    const { STORAGE, COPY_DST, COPY_SRC, INDIRECT } = USAGE;
    this.named.set(name, this.device.createBuffer({ label: name, size, usage: STORAGE | COPY_DST | COPY_SRC | INDIRECT }));
  }

  /** Makes room. @param {Sizes} wanted */
  grow(wanted) {
    for (const count of /** @type {Count[]} */ (Object.keys(wanted))) this.sizes[count] = Math.max(this.sizes[count], wanted[count]);
    const sizes = /** @type {{ [count: string]: number }} */ (this.sizes);
    const uniforms = ["Camera", "Shard", "Parameters"];
    for (const [name, { bytes, terms }] of Object.entries(FORWARD.extents)) {
      if (uniforms.includes(name) || name.includes("Sort(")) continue;
      this.storage(name, terms.reduce((sum, term) => sum + term.bytes * Math.ceil(Math.max(...term.largestOf.map((count) => sizes[count])) / term.per), bytes));
    }
    this.storage("depths", 4 * this.sizes.splats);
    this.storage("layers", 8 * this.sizes.pixels);
    // Head, radiance, coverage, depth.
    this.storage("packed", 16 + 12 * Math.ceil(this.sizes.pixels / 2) * 2);
  }

  /** Sets the number of splats. @param {number} splats */
  setSplats(splats) {
    FORWARD.sorts.depth.forEach(([shift, , flags, bits], n) => this.uniform(`DepthSort(${n})`, new Uint32Array([shift, splats, flags, bits])));
  }

  /** Sets the digits of the sort by tile. @param {number} tiles */
  setTiles(tiles) {
    tileSort(tiles).forEach((digit, n) => this.uniform(`TileSort(${n})`, new Uint32Array(digit)));
  }

  destroy() {
    for (const buffer of this.named.values()) buffer.destroy();
  }
}

/** A run of splats whose parameters are bound together. @typedef {{ base: number, len: number, stride: number, uniform: GPUBuffer, parameters: GPUBuffer }} Shard */

/** Records the kernels of a picture. */
export class Recorder {
  /** @param {GPUDevice} device @param {Map<string, GPUComputePipeline>} pipelines @param {Buffers} buffers @param {Sizes} counts of this picture */
  constructor(device, pipelines, buffers, counts) {
    this.device = device;
    this.pipelines = pipelines;
    this.buffers = buffers;
    this.counts = counts;
    this.encoder = device.createCommandEncoder();
    this.pass = this.encoder.beginComputePass();
  }

  /** @param {Dispatch} dispatch @param {Shard} [shard] */
  dispatch({ kernel, bindings, workgroups }, shard) {
    const { device, pass, pipelines, buffers, counts } = this;
    const pipeline = /** @type {GPUComputePipeline} */ (pipelines.get(kernel));
    const buffer = (/** @type {string} */ name) => /** @type {GPUBuffer} */ (name === "Shard" ? shard?.uniform : name === "Parameters" ? shard?.parameters : buffers.named.get(name));
    const entries = bindings.map(({ slot, buffer: name }) => ({ binding: slot, resource: { buffer: buffer(name) } }));
    pass.setPipeline(pipeline);
    pass.setBindGroup(0, device.createBindGroup({ layout: pipeline.getBindGroupLayout(0), entries }));
    const { fixed, count, plus = 0, per = 1, indirect } = workgroups;
    if (indirect !== undefined) return pass.dispatchWorkgroupsIndirect(buffer("Dispatches"), indirect);
    const items = count === "splats" && shard ? shard.len : counts[count ?? "splats"];
    const groups = fixed ?? Math.ceil((items + plus) / per);
    const most = FORWARD.numbers.maxGroups;
    if (groups > 0) pass.dispatchWorkgroups(Math.min(groups, most), Math.ceil(groups / most));
  }

  /** The engine's passes. @param {readonly Shard[]} shards */
  forward(shards) {
    for (const shard of shards) this.dispatch(FORWARD.project, shard);
    for (const dispatch of FORWARD.afterProjection[tileSort(this.counts.tiles).length]) this.dispatch(dispatch);
  }

  /** Coverage and depth. @param {readonly Shard[]} shards */
  layers(shards) {
    const bound = (/** @type {string[]} */ ...names) => names.map((buffer, slot) => ({ slot, buffer }));
    for (const shard of shards) this.dispatch({ kernel: "depths_of_splats", bindings: bound("Camera", "Shard", "Parameters", "depths"), workgroups: { count: "splats", per: 256 } }, shard);
    const rasterize = /** @type {Dispatch} */ (FORWARD.afterProjection[tileSort(this.counts.tiles).length].at(-1));
    const bindings = [...rasterize.bindings.filter(({ slot }) => slot < 5), { slot: 5, buffer: "depths" }, { slot: 6, buffer: "layers" }];
    this.dispatch({ kernel: "layers_of_samples", bindings, workgroups: { count: "tiles" } });
  }

  /** Half floats. @param {number} pixels */
  pack(pixels) {
    const all = [{ slot: 0, buffer: "picture" }, { slot: 1, buffer: "Image" }, { slot: 2, buffer: "layers" }, { slot: 3, buffer: "packed" }];
    this.dispatch({ kernel: "peak", bindings: [all[0], all[1], all[3]], workgroups: { fixed: Math.ceil(pixels / 256) } });
    this.dispatch({ kernel: "exponent", bindings: [all[3]], workgroups: { fixed: 1 } });
    this.dispatch({ kernel: "pack", bindings: all, workgroups: { fixed: Math.ceil(pixels / 512) } });
  }
}
