/** The Utah teapot: the Bezier patches that Martin Newell measured in 1975, evaluated. */

/** @typedef {import("./mesh.js").Mesh} Mesh */
/** @typedef {import("../math/vectors.js").Vec3} Vec3 */

/** Pieces along a side of a patch. */
const PIECES = 7;
/** Place of the control points that make a quarter of a circle, radii. */
const ROUND = 0.56;

/**
 * Control points of the patches that are turned about the axis: their radius and height, from the top
 * outside downwards, in the units of the table; a third number is the place of the points that round it
 * where that is another. The bottom is Frank Crow's.
 * @type {readonly (readonly [number, number, number?][])[]}
 */
const TURNED = [
  [[1.4, 2.4], [1.3375, 2.53125], [1.4375, 2.53125], [1.5, 2.4]],
  [[1.5, 2.4], [1.75, 1.875], [2, 1.35], [2, 0.9]],
  [[2, 0.9], [2, 0.45], [1.5, 0.225], [1.5, 0.15]],
  [[1.5, 0.15], [1.5, 0.075], [1.425, 0], [0, 0]],
  [[0, 3.15], [0.8, 3.15, 0.45], [0, 2.85], [0.2, 2.7]],
  [[0.2, 2.7], [0.4, 2.55], [1.3, 2.55], [1.3, 2.4]],
];

/**
 * Control points of handle and spout, which are the same on both sides: in each row x and height of
 * the first two, x and height of the last two, and the distance from the middle of those between.
 */
const BENT = [
  [[-1.6, 2.025, -1.5, 2.25, 0.3], [-2.3, 2.025, -2.5, 2.25, 0.3], [-2.7, 2.025, -3, 2.25, 0.3], [-2.7, 1.8, -3, 1.8, 0.3]],
  [[-2.7, 1.8, -3, 1.8, 0.3], [-2.7, 1.575, -3, 1.35, 0.3], [-2.5, 1.125, -2.65, 0.9375, 0.3], [-2, 0.9, -1.9, 0.6, 0.3]],
  [[1.7, 1.425, 1.7, 0.6, 0.66], [2.6, 1.425, 3.1, 0.825, 0.66], [2.3, 2.1, 2.4, 2.025, 0.25], [2.7, 2.4, 3.3, 2.4, 0.25]],
  [[2.7, 2.4, 3.3, 2.4, 0.25], [2.8, 2.475, 3.525, 2.49375, 0.25], [2.9, 2.475, 3.45, 2.5125, 0.15], [2.8, 2.4, 3.2, 2.4, 0.15]],
];

/** The 32 patches, each of four rows of four points, whose z is up. @returns {Vec3[][][]} */
function patches() {
  const turned = TURNED.flatMap((profile) =>
    [[1, 0], [0, -1], [-1, 0], [0, 1]].map(([c, s]) =>
      profile.map(([r, z, k = ROUND * r]) => [[r, 0], [r, -k], [k, -r], [0, -r]].map(([x, y]) => /** @type {Vec3} */ ([c * x - s * y, s * x + c * y, z]))),
    ),
  );
  const bent = BENT.flatMap((rows) =>
    [1, -1].map((side) => {
      const points = rows.map(([x, z, u, w, y]) => /** @type {Vec3[]} */ ([[x, 0, z], [x, -side * y, z], [u, -side * y, w], [u, 0, w]]));
      // The other way round on the other side, so that both face outwards.
      return side > 0 ? points : points.map((row) => [...row].reverse());
    }),
  );
  return [...turned, ...bent];
}

/** Weights of four control points, and their slopes. @param {number} t */
function weights(t) {
  const s = 1 - t;
  return { values: [s * s * s, 3 * s * s * t, 3 * s * t * t, t * t * t], slopes: [-3 * s * s, 3 * s * s - 6 * s * t, 6 * s * t - 3 * t * t, 3 * t * t] };
}

/** @param {Vec3[][]} patch @param {number[]} along @param {number[]} down @returns {Vec3} */
function mixed(patch, along, down) {
  /** @type {Vec3} */ const sum = [0, 0, 0];
  patch.forEach((row, i) => row.forEach((point, j) => point.forEach((value, axis) => (sum[axis] += down[i] * along[j] * value))));
  return sum;
}

/** @param {Vec3[][]} patch @param {number} u @param {number} v @returns {Vec3} */
function normalAt(patch, u, v) {
  const [a, b] = [weights(u), weights(v)];
  const [along, down] = [mixed(patch, a.slopes, b.values), mixed(patch, a.values, b.slopes)];
  const normal = [along[1] * down[2] - along[2] * down[1], along[2] * down[0] - along[0] * down[2], along[0] * down[1] - along[1] * down[0]];
  const size = Math.hypot(...normal);
  // A side that is a point has no slope along it.
  if (size < 1e-6) return normalAt(patch, u, v < 0.5 ? v + 1e-3 : v - 1e-3);
  return /** @type {Vec3} */ (normal.map((value) => value / size));
}

/** The teapot, y up. @param {import("./mesh.js").Material} material @returns {Mesh} */
export function teapot(material) {
  /** @type {number[]} */ const positions = [];
  /** @type {number[]} */ const normals = [];
  /** @type {number[]} */ const indices = [];
  const side = PIECES + 1;
  for (const patch of patches()) {
    const first = positions.length / 3;
    for (let i = 0; i < side * side; i++) {
      const [u, v] = [(i % side) / PIECES, Math.floor(i / side) / PIECES];
      for (const [list, [x, y, z]] of /** @type {const} */ ([[positions, mixed(patch, weights(u).values, weights(v).values)], [normals, normalAt(patch, u, v)]])) list.push(x, z, -y);
    }
    for (let i = 0; i < PIECES * PIECES; i++) {
      const corner = first + Math.floor(i / PIECES) * side + (i % PIECES);
      indices.push(corner, corner + 1, corner + side, corner + 1, corner + side + 1, corner + side);
    }
  }
  return { positions: Float32Array.from(positions), normals: Float32Array.from(normals), indices: Uint32Array.from(indices), materials: [material], materialOf: new Uint16Array(indices.length / 3) };
}
