/** Reads the triangles of a binary glTF 2.0 file: positions, normals, nodes, factors of materials. */

import { cross, length, sub, times } from "../math/vectors.js";

/** @typedef {import("./mesh.js").Material} Material */
/** @typedef {import("./mesh.js").Mesh} Mesh */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** A 4x4 matrix, columns one after the other. @typedef {readonly number[]} Matrix */

/** Limits of a file: bytes, triangles, and nodes above one another. */
const [MOST_BYTES, MOST_TRIANGLES, MOST_DEPTH] = [64 * 2 ** 20, 200_000, 64];
const [MAGIC, JSON_CHUNK, BINARY_CHUNK] = [0x46546c67, 0x4e4f534a, 0x004e4942];
/** @type {Matrix} */
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

/** How numbers of a component type are read. @type {{ [type: number]: { bytes: number, most: number, read: (view: DataView, at: number) => number } }} */
const COMPONENTS = {
  5120: { bytes: 1, most: 127, read: (view, at) => view.getInt8(at) },
  5121: { bytes: 1, most: 255, read: (view, at) => view.getUint8(at) },
  5122: { bytes: 2, most: 32767, read: (view, at) => view.getInt16(at, true) },
  5123: { bytes: 2, most: 65535, read: (view, at) => view.getUint16(at, true) },
  5125: { bytes: 4, most: 1, read: (view, at) => view.getUint32(at, true) },
  5126: { bytes: 4, most: 1, read: (view, at) => view.getFloat32(at, true) },
};

/** Extensions without which the shape is what it is. */
const isHarmless = (/** @type {string} */ name) => /^KHR_(materials|texture)_|^KHR_(mesh_quantization|lights_punctual)$|^EXT_texture_/.test(name);

/** @param {string} message @returns {never} */
const refuse = (message) => {
  throw new Error(message);
};

/** @param {ArrayBuffer} bytes @param {number} at @param {number} size */
function description(bytes, at, size) {
  try {
    return JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, at, size)));
  } catch {
    return refuse("its description is not JSON");
  }
}

/** The parts of a file. @param {ArrayBuffer} bytes @returns {{ json: any, binary: DataView }} */
function chunks(bytes) {
  const view = new DataView(bytes);
  if (bytes.byteLength < 20 || view.getUint32(0, true) !== MAGIC) refuse("not a binary glTF file (.glb)");
  if (view.getUint32(4, true) !== 2) refuse(`glTF version ${view.getUint32(4, true)}, expected 2`);
  let json = null;
  let binary = new DataView(new ArrayBuffer(0));
  for (let at = 12; at + 8 <= bytes.byteLength; ) {
    const [size, kind] = [view.getUint32(at, true), view.getUint32(at + 4, true)];
    at += 8;
    if (at + size > bytes.byteLength) refuse("the file is cut off");
    if (kind === JSON_CHUNK && !json) json = description(bytes, at, size);
    else if (kind === BINARY_CHUNK && binary.byteLength === 0) binary = new DataView(bytes, at, size);
    at += size;
  }
  if (!json || typeof json !== "object") refuse("the file has no description");
  return { json, binary };
}

class Reader {
  /** @type {number[]} */ positions = [];
  /** @type {number[]} */ normals = [];
  /** @type {number[]} */ indices = [];
  /** @type {number[]} */ materialOf = [];
  /** Nodes that were met. @type {Set<number>} */ met = new Set();
  /** What the file has and the page leaves out. @type {Set<string>} */ ignored = new Set();

  /** @param {any} json @param {DataView} binary @param {(rgb: Vec3) => Vec3} toScene */
  constructor(json, binary, toScene) {
    this.json = json;
    this.binary = binary;
    const given = (json.materials ?? []).map((/** @type {any} */ material) => this.material(material, toScene));
    /** The last one is that of triangles without. @type {Material[]} */
    this.materials = [...given, this.material({}, toScene)];
  }

  /** @param {any} material @param {(rgb: Vec3) => Vec3} toScene @returns {Material} */
  material({ pbrMetallicRoughness: pbr = {}, ...rest }, toScene) {
    if (Object.keys({ ...pbr, ...rest }).some((key) => key.endsWith("Texture"))) this.ignored.add("textures");
    if (rest.alphaMode === "BLEND" || rest.alphaMode === "MASK") this.ignored.add("transparency");
    if (rest.emissiveFactor?.some((/** @type {number} */ value) => value > 0)) this.ignored.add("light of its own");
    const extensions = Object.keys(rest.extensions ?? {}).filter((name) => name !== "KHR_materials_specular");
    extensions.forEach((name) => this.ignored.add(name));
    const within = (/** @type {unknown} */ value, /** @type {number} */ usual) => (typeof value === "number" && Number.isFinite(value) ? Math.min(1, Math.max(0, value)) : usual);
    const [r, g, b] = [0, 1, 2].map((c) => within(pbr.baseColorFactor?.[c], 1));
    const base = /** @type {Vec3} */ (toScene([r, g, b]).map((value) => Math.max(0, value)));
    return { base, metallic: within(pbr.metallicFactor, 1), roughness: within(pbr.roughnessFactor, 1), specular: within(rest.extensions?.KHR_materials_specular?.specularFactor, 1) };
  }

  /** The numbers of an accessor. @param {number} index @param {string} what @param {number} width numbers of each element */
  numbers(index, what, width) {
    const { json, binary } = this;
    const accessor = json.accessors?.[index] ?? refuse(`${what}: accessor ${index} is not there`);
    if (accessor.sparse) refuse(`${what}: sparse accessors are not read`);
    const view = json.bufferViews?.[accessor.bufferView] ?? refuse(`${what}: accessor ${index} has no data`);
    if ((view.buffer ?? 0) !== 0 || json.buffers?.[0]?.uri !== undefined) refuse(`${what}: data outside of the file is not read`);
    const component = COMPONENTS[accessor.componentType] ?? refuse(`${what}: component type ${accessor.componentType} is unknown`);
    const size = component.bytes * width;
    const [stride, from, count] = [view.byteStride ?? size, (view.byteOffset ?? 0) + (accessor.byteOffset ?? 0), accessor.count];
    const isWhole = [stride, from, count].every((value) => Number.isSafeInteger(value) && value >= 0);
    if (!isWhole || (count > 0 && from + (count - 1) * stride + size > binary.byteLength)) refuse(`${what}: accessor ${index} reaches beyond the file`);
    const factor = accessor.normalized ? 1 / component.most : 1;
    const found = new Float64Array(count * width);
    for (let i = 0; i < found.length; i++) found[i] = Math.max(component.read(binary, from + Math.floor(i / width) * stride + (i % width) * component.bytes) * factor, accessor.normalized ? -1 : -Infinity);
    return found;
  }

  /** @param {any} primitive @param {Matrix} world @param {string} what */
  primitive(primitive, world, what) {
    if (primitive.extensions?.KHR_gaussian_splatting) refuse("the file holds splats: open it with luxel view; expected triangles");
    if ((primitive.mode ?? 4) !== 4) return void this.ignored.add("points, lines and strips");
    if (primitive.targets) this.ignored.add("morph targets");
    if (primitive.attributes?.COLOR_0 !== undefined) this.ignored.add("colours of corners");
    if (primitive.attributes?.POSITION === undefined) return void this.ignored.add("triangles without positions");
    const points = this.numbers(primitive.attributes.POSITION, `${what}, positions`, 3);
    const order = primitive.indices === undefined ? Float64Array.from({ length: points.length / 3 }, (_, i) => i) : this.numbers(primitive.indices, `${what}, indices`, 1);
    if (order.some((corner) => corner >= points.length / 3)) refuse(`${what}: an index beyond the ${points.length / 3} corners`);
    if (points.some((value) => !Number.isFinite(value))) refuse(`${what}: a position that is no number`);
    if ((this.indices.length + order.length) / 3 > MOST_TRIANGLES) refuse(`more than ${MOST_TRIANGLES.toLocaleString("en")} triangles: reduce the mesh`);
    const moved = new Float64Array(points.length);
    for (let i = 0; i < points.length; i += 3) moved.set(placed(world, [points[i], points[i + 1], points[i + 2]]), i);
    // Counter-clockwise is outside, in a mirrored node, too.
    if (determinant(world) < 0) for (let i = 0; i + 2 < order.length; i += 3) [order[i + 1], order[i + 2]] = [order[i + 2], order[i + 1]];
    const normals = this.normalsOf(primitive, world, what, points.length);
    const before = this.indices.length;
    if (normals) this.smooth(moved, normals, order);
    else this.flat(moved, order);
    const material = this.materials[primitive.material] ? primitive.material : this.materials.length - 1;
    for (let i = before; i < this.indices.length; i += 3) this.materialOf.push(material);
  }

  /** Normals of a primitive in the world; null where it has none that can be used, which is then flat. @param {any} primitive @param {Matrix} world @param {string} what @param {number} expected */
  normalsOf(primitive, world, what, expected) {
    if (primitive.attributes.NORMAL === undefined) return null;
    const given = this.numbers(primitive.attributes.NORMAL, `${what}, normals`, 3);
    if (given.length !== expected) refuse(`${what}: ${given.length / 3} normals for ${expected / 3} corners`);
    for (let i = 0; i < given.length; i += 3) {
      const normal = turnedNormal(world, [given[i], given[i + 1], given[i + 2]]);
      const size = length(normal);
      if (!(size > 0 && size < Infinity)) return null;
      given.set(times(normal, 1 / size), i);
    }
    return given;
  }

  /** @param {Float64Array} points @param {Float64Array} normals @param {Float64Array} order */
  smooth(points, normals, order) {
    const first = this.positions.length / 3;
    for (const [list, values] of /** @type {const} */ ([[this.positions, points], [this.normals, normals]])) for (const value of values) list.push(value);
    for (let i = 0; i < order.length - (order.length % 3); i++) this.indices.push(first + order[i]);
  }

  /** @param {Float64Array} points @param {Float64Array} order */
  flat(points, order) {
    const point = (/** @type {number} */ corner) => /** @type {Vec3} */ ([points[3 * corner], points[3 * corner + 1], points[3 * corner + 2]]);
    for (let i = 0; i + 2 < order.length; i += 3) {
      const corners = [point(order[i]), point(order[i + 1]), point(order[i + 2])];
      const facet = cross(sub(corners[1], corners[0]), sub(corners[2], corners[0]));
      const size = length(facet);
      if (!(size > 0)) continue;
      for (const corner of corners) {
        this.indices.push(this.positions.length / 3);
        this.positions.push(...corner);
        this.normals.push(...times(facet, 1 / size));
      }
    }
  }

  /** @param {number} index @param {Matrix} above @param {number} depth */
  node(index, above, depth) {
    const node = this.json.nodes?.[index] ?? refuse(`node ${index} is not there`);
    if (depth > MOST_DEPTH) refuse(`more than ${MOST_DEPTH} nodes above one another`);
    if (this.met.has(index)) refuse(`node ${index} has two parents`);
    this.met.add(index);
    const world = product(above, matrixOf(node));
    if (node.skin !== undefined) this.ignored.add("skins");
    if (node.mesh !== undefined) {
      const mesh = this.json.meshes?.[node.mesh] ?? refuse(`mesh ${node.mesh} is not there`);
      (mesh.primitives ?? []).forEach((/** @type {any} */ primitive, /** @type {number} */ i) => this.primitive(primitive, world, `mesh ${node.mesh}, primitive ${i}`));
    }
    for (const child of node.children ?? []) this.node(child, world, depth + 1);
  }
}

/** @param {Matrix} a @param {Matrix} b @returns {Matrix} */
const product = (a, b) => Array.from({ length: 16 }, (_, i) => [0, 1, 2, 3].reduce((sum, k) => sum + a[4 * k + (i % 4)] * b[4 * Math.floor(i / 4) + k], 0));

/** @param {Matrix} m @param {Vec3} v a point @returns {Vec3} */
const placed = (m, v) => /** @type {Vec3} */ ([0, 1, 2].map((row) => m[row] * v[0] + m[4 + row] * v[1] + m[8 + row] * v[2] + m[12 + row]));

/** @param {Matrix} m */
const determinant = (m) => m[0] * (m[5] * m[10] - m[9] * m[6]) - m[4] * (m[1] * m[10] - m[9] * m[2]) + m[8] * (m[1] * m[6] - m[5] * m[2]);

/** A normal under a transform: by the cofactors, which keep it upright on the surface. @param {Matrix} m @param {Vec3} v @returns {Vec3} */
function turnedNormal(m, v) {
  const column = (/** @type {number} */ c) => /** @type {Vec3} */ ([m[4 * c], m[4 * c + 1], m[4 * c + 2]]);
  const sign = determinant(m) < 0 ? -1 : 1;
  const rows = [cross(column(1), column(2)), cross(column(2), column(0)), cross(column(0), column(1))];
  return /** @type {Vec3} */ ([0, 1, 2].map((c) => sign * (rows[0][c] * v[0] + rows[1][c] * v[1] + rows[2][c] * v[2])));
}

/** @param {any} node @returns {Matrix} */
function matrixOf({ matrix, translation: t = [0, 0, 0], rotation: q = [0, 0, 0, 1], scale: s = [1, 1, 1] }) {
  const given = matrix ?? [...t, ...q, ...s];
  if (!given.every((/** @type {unknown} */ value) => typeof value === "number" && Number.isFinite(value))) refuse("a node with a transform that is no number");
  if (matrix) return matrix.length === 16 ? matrix : refuse("a node whose matrix has not 16 numbers");
  const [x, y, z, w] = q;
  return [
    (1 - 2 * (y * y + z * z)) * s[0], 2 * (x * y + z * w) * s[0], 2 * (x * z - y * w) * s[0], 0,
    2 * (x * y - z * w) * s[1], (1 - 2 * (x * x + z * z)) * s[1], 2 * (y * z + x * w) * s[1], 0,
    2 * (x * z + y * w) * s[2], 2 * (y * z - x * w) * s[2], (1 - 2 * (x * x + y * y)) * s[2], 0,
    t[0], t[1], t[2], 1,
  ];
}

/** The triangles of a file, and what of it is left out. @param {ArrayBuffer} bytes @param {(rgb: Vec3) => Vec3} toScene from linear Rec.709 to the colours of the scene @returns {{ mesh: Mesh, ignored: string[] }} */
export function readGlb(bytes, toScene) {
  try {
    return trianglesOf(bytes, toScene);
  } catch (error) {
    // A list where a number should be, and the like.
    return error instanceof TypeError ? refuse("its description does not follow glTF 2.0") : refuse(/** @type {Error} */ (error).message);
  }
}

/** @param {ArrayBuffer} bytes @param {(rgb: Vec3) => Vec3} toScene @returns {{ mesh: Mesh, ignored: string[] }} */
function trianglesOf(bytes, toScene) {
  if (bytes.byteLength > MOST_BYTES) refuse(`${(bytes.byteLength / 1e6).toFixed(0)} MB, expected at most ${(MOST_BYTES / 1e6).toFixed(0)} MB`);
  const { json, binary } = chunks(bytes);
  for (const name of json.extensionsRequired ?? []) {
    if (name === "KHR_gaussian_splatting") refuse("the file holds splats: open it with luxel view; expected triangles");
    if (!isHarmless(name)) refuse(`the file needs ${name}, which is not read: save it without, and uncompressed`);
  }
  const reader = new Reader(json, binary, toScene);
  const children = new Set((json.nodes ?? []).flatMap((/** @type {any} */ node) => node.children ?? []));
  const roots = json.scenes?.[json.scene ?? 0]?.nodes ?? (json.nodes ?? []).map((/** @type {any} */ _, /** @type {number} */ i) => i).filter((/** @type {number} */ i) => !children.has(i));
  for (const root of roots) reader.node(root, IDENTITY, 0);
  if (json.animations?.length) reader.ignored.add("animations");
  if (reader.indices.length === 0) refuse("the file has no triangles");
  const mesh = { positions: Float32Array.from(reader.positions), normals: Float32Array.from(reader.normals), indices: Uint32Array.from(reader.indices), materials: reader.materials, materialOf: Uint16Array.from(reader.materialOf) };
  return { mesh, ignored: [...reader.ignored] };
}
