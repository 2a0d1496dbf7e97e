// Binary glTF files for the tests.

/** Joins the description and the binary part of a file. */
export function glb(json, binary) {
  const chunk = (bytes, kind, fill) => {
    const content = Buffer.concat([bytes, Buffer.alloc((4 - (bytes.length % 4)) % 4, fill)]);
    const head = Buffer.alloc(8);
    head.writeUInt32LE(content.length, 0);
    head.writeUInt32LE(kind, 4);
    return Buffer.concat([head, content]);
  };
  const body = Buffer.concat([chunk(Buffer.from(JSON.stringify(json)), 0x4e4f534a, 0x20), chunk(binary, 0x004e4942, 0)]);
  const head = Buffer.alloc(12);
  head.write("glTF");
  head.writeUInt32LE(2, 4);
  head.writeUInt32LE(head.length + body.length, 8);
  return Buffer.concat([head, body]);
}

const corner = (a, b) => [a, b].sort((x, y) => x - y).join();
const unit = (v) => v.map((x) => x / Math.hypot(...v));

/** A ball of triangles: an octahedron that is parted `levels` times, moved and scaled by its node. */
export function ball(levels, material) {
  const points = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
  let faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
  for (let level = 0; level < levels; level++) {
    const known = new Map();
    const middle = (a, b) => {
      const key = corner(a, b);
      if (!known.has(key)) known.set(key, points.push(unit(points[a].map((x, i) => x + points[b][i]))) - 1);
      return known.get(key);
    };
    faces = faces.flatMap(([a, b, c]) => {
      const [x, y, z] = [middle(a, b), middle(b, c), middle(c, a)];
      return [[a, x, z], [b, y, x], [c, z, y], [x, y, z]];
    });
  }
  const positions = Buffer.from(Float32Array.from(points.flat()).buffer);
  const indices = Buffer.from(Uint16Array.from(faces.flat()).buffer);
  const json = {
    asset: { version: "2.0" },
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0, translation: [3, -2, 5], scale: [2, 2, 2] }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0, NORMAL: 0 }, indices: 1, material: 0 }] }],
    materials: [material],
    accessors: [{ bufferView: 0, componentType: 5126, count: points.length, type: "VEC3" }, { bufferView: 1, componentType: 5123, count: 3 * faces.length, type: "SCALAR" }],
    bufferViews: [{ buffer: 0, byteOffset: 0, byteLength: positions.length }, { buffer: 0, byteOffset: positions.length, byteLength: indices.length }],
    buffers: [{ byteLength: positions.length + indices.length }],
  };
  return { json, binary: Buffer.concat([positions, indices]) };
}

/** Rectangles, each a corner and two sides from it. */
export function rectangles(list) {
  const points = list.flatMap(([corner, a, b]) => [[0, 0], [1, 0], [1, 1], [0, 1]].flatMap(([u, v]) => corner.map((x, i) => x + u * a[i] + v * b[i])));
  const faces = list.flatMap((_, i) => [0, 1, 2, 0, 2, 3].map((n) => 4 * i + n));
  const [positions, indices] = [Buffer.from(Float32Array.from(points).buffer), Buffer.from(Uint16Array.from(faces).buffer)];
  const json = {
    asset: { version: "2.0" },
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0 }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0 }, indices: 1 }] }],
    accessors: [{ bufferView: 0, componentType: 5126, count: points.length / 3, type: "VEC3" }, { bufferView: 1, componentType: 5123, count: faces.length, type: "SCALAR" }],
    bufferViews: [{ buffer: 0, byteOffset: 0, byteLength: positions.length }, { buffer: 0, byteOffset: positions.length, byteLength: indices.length }],
    buffers: [{ byteLength: positions.length + indices.length }],
  };
  return glb(json, Buffer.concat([positions, indices]));
}
