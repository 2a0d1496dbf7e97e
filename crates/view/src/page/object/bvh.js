/** A tree of boxes around the triangles of a mesh, for rays that ask whether and where anything is in their way. */

/** Triangles of a leaf, at most. */
const LEAF = 4;
/** Depth of the tree from which on boxes are split at the median, so that no mesh makes it deep. */
const DEEP = 32;
/** Places of the stack: `DEEP`, and the logarithm of the largest mesh. */
const STACK = 64;
/** Numbers of a triangle: a corner, and the edges from it. */
const NUMBERS = 9;

export class Tree {
  /** @param {Float32Array} positions of the corners @param {Uint32Array} indices three of each triangle */
  constructor(positions, indices) {
    const count = indices.length / 3;
    this.positions = positions;
    this.indices = indices;
    /** Triangles in the order of the leaves. */ this.order = Uint32Array.from({ length: count }, (_, i) => i);
    this.middles = new Float32Array(3 * count);
    for (let i = 0; i < 3 * count; i++) {
      const [triangle, axis] = [Math.floor(i / 3), i % 3];
      for (let k = 0; k < 3; k++) this.middles[i] += positions[3 * indices[3 * triangle + k] + axis] / 3;
    }
    const most = Math.max(1, 2 * count);
    /** Lowest and highest corner of each box. */ this.boxes = new Float32Array(6 * most);
    /** First child of a box, whose other one is the next, or first triangle of a leaf. */ this.first = new Uint32Array(most);
    /** Triangles of a leaf; 0 for a box with children. */ this.counts = new Uint32Array(most);
    this.build(count);
    this.triangles = new Float32Array(NUMBERS * count);
    this.order.forEach((triangle, i) => {
      for (let n = 0; n < NUMBERS; n++) {
        const [corner, axis] = [Math.floor(n / 3), n % 3];
        const from = corner ? positions[3 * indices[3 * triangle] + axis] : 0;
        this.triangles[NUMBERS * i + n] = positions[3 * indices[3 * triangle + corner] + axis] - from;
      }
    });
    this.stack = new Uint32Array(STACK);
  }

  /** @param {number} count */
  build(count) {
    let nodes = 1;
    const waiting = [{ node: 0, from: 0, to: count, depth: 0 }];
    for (let next = waiting.pop(); next; next = waiting.pop()) {
      const { node, from, to, depth } = next;
      this.bound(node, from, to);
      const middle = to - from > LEAF ? this.split(from, to, depth) : from;
      if (middle === from) {
        [this.first[node], this.counts[node]] = [from, to - from];
        continue;
      }
      this.first[node] = nodes;
      waiting.push({ node: nodes, from, to: middle, depth: depth + 1 }, { node: nodes + 1, from: middle, to, depth: depth + 1 });
      nodes += 2;
    }
  }

  /** @param {number} node @param {number} from @param {number} to */
  bound(node, from, to) {
    const box = this.boxes.subarray(6 * node, 6 * node + 6);
    box.fill(Infinity, 0, 3).fill(-Infinity, 3);
    for (let i = 3 * from; i < 3 * to; i++) {
      const corner = this.indices[3 * this.order[Math.floor(i / 3)] + (i % 3)];
      for (let axis = 0; axis < 3; axis++) {
        const value = this.positions[3 * corner + axis];
        if (value < box[axis]) box[axis] = value;
        if (value > box[axis + 3]) box[axis + 3] = value;
      }
    }
  }

  /** Parts triangles along the longest axis of their middles; returns the first of the second part. @param {number} from @param {number} to @param {number} depth */
  split(from, to, depth) {
    const { order, middles } = this;
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (let i = from; i < to; i++) {
      for (let axis = 0; axis < 3; axis++) {
        const value = middles[3 * order[i] + axis];
        [low[axis], high[axis]] = [Math.min(low[axis], value), Math.max(high[axis], value)];
      }
    }
    const sides = [0, 1, 2].map((axis) => high[axis] - low[axis]);
    const axis = sides.indexOf(Math.max(...sides));
    const half = (low[axis] + high[axis]) / 2;
    let middle = from;
    for (let i = from; depth < DEEP && i < to; i++) {
      if (middles[3 * order[i] + axis] >= half) continue;
      [order[i], order[middle]] = [order[middle], order[i]];
      middle++;
    }
    if (middle > from && middle < to) return middle;
    order.subarray(from, to).sort((a, b) => middles[3 * a + axis] - middles[3 * b + axis]);
    return (from + to) >> 1;
  }

  /** Whether a ray meets a triangle before it is `most` of its directions long. @param {number} x @param {number} y @param {number} z @param {number} dx @param {number} dy @param {number} dz @param {number} most */
  isHit(x, y, z, dx, dy, dz, most) {
    return this.distance(x, y, z, dx, dy, dz, most, true) < Infinity;
  }

  /** How many of its directions a ray is long when it meets the first triangle, or with `isAny` one of them; infinite for none before `most`. @param {number} x @param {number} y @param {number} z @param {number} dx @param {number} dy @param {number} dz @param {number} most */
  distance(x, y, z, dx, dy, dz, most, isAny = false) {
    let nearest = Infinity;
    const { boxes, first, counts, stack } = this;
    // Plain variables, since arrays would cost more than the arithmetic.
    const rx = 1 / dx;
    const ry = 1 / dy;
    const rz = 1 / dz;
    let depth = 1;
    stack[0] = 0;
    while (depth > 0) {
      const node = stack[--depth];
      const b = 6 * node;
      const x0 = (boxes[b] - x) * rx;
      const x1 = (boxes[b + 3] - x) * rx;
      const y0 = (boxes[b + 1] - y) * ry;
      const y1 = (boxes[b + 4] - y) * ry;
      const z0 = (boxes[b + 2] - z) * rz;
      const z1 = (boxes[b + 5] - z) * rz;
      const near = Math.max(Math.min(x0, x1), Math.min(y0, y1), Math.min(z0, z1));
      const far = Math.min(Math.max(x0, x1), Math.max(y0, y1), Math.max(z0, z1));
      // Also where a ray lies in the side of a box, which makes no number.
      if (near > far || far < 0 || near > most) continue;
      const count = counts[node];
      if (count === 0) {
        stack[depth++] = first[node];
        stack[depth++] = first[node] + 1;
        continue;
      }
      for (let i = first[node]; i < first[node] + count; i++) {
        const away = this.away(NUMBERS * i, x, y, z, dx, dy, dz);
        if (!(away < most)) continue;
        if (isAny) return away;
        nearest = most = away;
      }
    }
    return nearest;
  }

  /** Möller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997. @param {number} t @param {number} x @param {number} y @param {number} z @param {number} dx @param {number} dy @param {number} dz */
  away(t, x, y, z, dx, dy, dz) {
    const n = this.triangles;
    const ax = n[t + 3];
    const ay = n[t + 4];
    const az = n[t + 5];
    const bx = n[t + 6];
    const by = n[t + 7];
    const bz = n[t + 8];
    const px = dy * bz - dz * by;
    const py = dz * bx - dx * bz;
    const pz = dx * by - dy * bx;
    const determinant = ax * px + ay * py + az * pz;
    if (determinant === 0) return Infinity;
    const inverse = 1 / determinant;
    const sx = x - n[t];
    const sy = y - n[t + 1];
    const sz = z - n[t + 2];
    const u = (sx * px + sy * py + sz * pz) * inverse;
    if (!(u >= 0 && u <= 1)) return Infinity;
    const qx = sy * az - sz * ay;
    const qy = sz * ax - sx * az;
    const qz = sx * ay - sy * ax;
    const v = (dx * qx + dy * qy + dz * qz) * inverse;
    if (!(v >= 0 && u + v <= 1)) return Infinity;
    const away = (bx * qx + by * qy + bz * qz) * inverse;
    return away > 0 ? away : Infinity;
  }
}
