// Walking on a proxy mesh.

import assert from "node:assert/strict";
import { mkdtempSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { rectangles } from "../gltf.mjs";
import { near, newPage, browser, run, serve } from "../harness.mjs";

const EYE = 1.6;
/** A floor, a step of .3 from z = -1 on, a wall at z = -3; y is up. */
const ROOM = rectangles([
  [[-5, 0, 5], [10, 0, 0], [0, 0, -10]],
  [[-5, 0.3, -1], [10, 0, 0], [0, 0, -2]],
  [[-5, 0, -3], [10, 0, 0], [0, 3, 0]],
]);

export default {
  async "walking keeps its height above the floor of a proxy mesh, climbs a step and stops before a wall"() {
    const path = join(mkdtempSync(join(tmpdir(), "luxel-walk-")), "room.glb");
    writeFileSync(path, ROOM);
    const server = serve("127.0.0.1:0", run, "--mesh", path);
    const page = await newPage(browser, { viewport: { width: 800, height: 600 } });
    await page.goto(await server.url);
    await page.waitForFunction(() => window.luxel.controls.proxy?.tree && window.luxel.shown);
    const found = await page.evaluate((height) => {
      const { luxel } = window;
      const { controls, state, scene } = luxel;
      const rows = scene.mesh.world_from_file;
      const world = (v) => rows.map((row) => row.reduce((sum, x, i) => sum + x * v[i], 0));
      const file = (v) => [0, 1, 2].map((i) => rows.reduce((sum, row, n) => sum + row[i] * v[n], 0));
      const stand = () => Object.assign(state, { mode: "walk", projection: "pinhole", eye: world([0.5, height, 1]), axes: { right: world([1, 0, 0]), up: world([0, 1, 0]), back: world([0, 0, 1]) } });
      controls.up = world([0, 1, 0]);
      controls.size = 1;
      stand();
      const places = [];
      controls.keys.add("KeyW");
      for (let i = 0; i < 400; i++) {
        controls.step(0.05);
        places.push(file(state.eye));
      }
      controls.keys.clear();
      stand();
      luxel.pivot(luxel.box.width / 2, luxel.box.height / 2);
      return { places, pivot: file(state.pivot), mode: state.mode };
    }, EYE);
    for (const [x, y, z] of found.places) {
      near(x, 0.5, 1e-3, "aside");
      near(y, z > -1 ? EYE : EYE + 0.3, 1e-3, `height at ${z}`);
    }
    near(found.places.at(-1)[2], -3 + 0.15 * EYE, 1e-3, "the wall");
    near(found.pivot[2], -3, 1e-3, "the pivot");
    assert.equal(found.mode, "orbit");
    assert.deepEqual(page.failures, []);
    await page.close();
    server.child.kill();
  },
};
