/** Meshes of objects: what they are made of, the frame in which they stand, and the simple ones. */

/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/** A surface as glTF describes it: linear reflectance, 0 to 1 each, and the strength of the gloss of what is no metal. @typedef {{ base: Vec3, metallic: number, roughness: number, specular: number }} Material */
/** Triangles with a normal at each corner, facing outwards; `materialOf` has an index for each triangle. @typedef {{ positions: Float32Array, normals: Float32Array, indices: Uint32Array, materials: readonly Material[], materialOf: Uint16Array }} Mesh */
/** A mesh on the plane y = 0, over its middle, with a longest side of 2; `reach` is the radius of the ball around it. @typedef {Mesh & { height: number, reach: number }} StandingMesh */

/** A matt surface. @param {number} reflectance @returns {Material} */
export const matt = (reflectance) => ({ base: [reflectance, reflectance, reflectance], metallic: 0, roughness: 1, specular: 0 });
/** A mirror. @type {Material} */
export const CHROME = { base: [1, 1, 1], metallic: 1, roughness: 0, specular: 1 };

/** Lowest and highest corner of what the triangles use. @param {Mesh} mesh */
function boundsOf({ positions, indices }) {
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (const index of indices) {
    for (let axis = 0; axis < 3; axis++) {
      const value = positions[3 * index + axis];
      [low[axis], high[axis]] = [Math.min(low[axis], value), Math.max(high[axis], value)];
    }
  }
  return { low, high };
}

/** The mesh as it stands; an error for one without a size. @param {Mesh} mesh @returns {StandingMesh} */
export function standing(mesh) {
  const { low, high } = boundsOf(mesh);
  const longest = Math.max(...[0, 1, 2].map((axis) => high[axis] - low[axis]));
  if (!(longest > 0 && longest < Infinity)) throw new Error("the triangles have no size");
  const factor = 2 / longest;
  const from = [(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2];
  const positions = mesh.positions.map((value, i) => (value - from[i % 3]) * factor);
  const height = (high[1] - low[1]) * factor;
  let reach = 0;
  for (const i of mesh.indices) reach = Math.max(reach, Math.hypot(positions[3 * i], positions[3 * i + 1] - height / 2, positions[3 * i + 2]));
  return { ...mesh, positions, height, reach };
}

/** A card as photographers have them, 10 by 8, of which both sides are seen: it stands upright and faces z, or lies and faces y. @param {Material} material @param {boolean} isLying @returns {Mesh} */
export function card(material, isLying) {
  const corners = [[-1, -0.8], [1, -0.8], [1, 0.8], [-1, 0.8]];
  const positions = Float32Array.from(corners.flatMap(([a, b]) => (isLying ? [a, 0, -b] : [a, b, 0])));
  const normals = Float32Array.from(corners.flatMap(() => (isLying ? [0, 1, 0] : [0, 0, 1])));
  return { positions, normals, indices: Uint32Array.of(0, 1, 2, 0, 2, 3), materials: [material], materialOf: new Uint16Array(2) };
}
