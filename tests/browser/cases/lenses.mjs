// Fisheyes and panoramas: cameras of a data set with their images, and the choice of a projection.

import { execFileSync } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import assert from "node:assert/strict";
import { camera, luxel, near, open, run, scene, serve, set, settled, shot, url } from "../harness.mjs";

/** Side of a fisheye's image, and height of a panorama's, pixels. */
const SIDE = 64;
/** The lenses of the data set, as frames of transforms.json. */
const LENSES = {
  fisheye: { size: [SIDE, SIDE], fields: { camera_model: "OPENCV_FISHEYE", fl_x: SIDE / ((200 * Math.PI) / 180), fl_y: SIDE / ((200 * Math.PI) / 180), k1: 0, k2: 0, k3: 0, k4: 0, fisheye_crop_radius: SIDE / 2 } },
  equirectangular: { size: [2 * SIDE, SIDE], fields: { camera_model: "EQUIRECTANGULAR", fl_x: SIDE, fl_y: SIDE } },
};

/** A viewer of the scene with a data set of its own renders through these lenses. */
async function wide() {
  const folder = mkdtempSync(path.join(tmpdir(), "luxel-lenses-"));
  process.on("exit", () => rmSync(folder, { recursive: true, force: true }));
  const frames = [];
  for (const [kind, { size: [w, h], fields }] of Object.entries(LENSES)) {
    const frame = { file_path: `${kind}.exr`, transform_matrix: camera.transform_matrix, w, h, cx: w / 2, cy: h / 2, ...fields };
    const file = path.join(folder, `${kind}.json`);
    writeFileSync(file, JSON.stringify({ frames: [frame] }));
    execFileSync(luxel, ["render", run, "--cameras", file, "-o", folder, "--device", "cpu", "--quiet"], { stdio: "ignore" });
    frames.push(frame);
  }
  writeFileSync(path.join(folder, "transforms.json"), JSON.stringify({ frames }));
  return serve("127.0.0.1:0", run, "--data", folder);
}

/** Places of a picture, 0 to 1. */
const PLACES = [0.2, 0.35, 0.45, 0.5, 0.55, 0.65, 0.8].flatMap((v) => [0.25, 0.4, 0.5, 0.6, 0.75].map((u) => [u, v]));

/** Checks that the page and the program see the same at the same pixels, a few of which must show something. */
async function checkPixels(page, address, query) {
  const { width, height } = await page.evaluate(() => window.luxel.shown.frame.head);
  let seen = 0;
  for (const [u, v] of PLACES) {
    if (seen === 4) return;
    const [x, y] = [Math.floor(u * width), Math.floor(v * height)];
    const sample = await page.evaluate(([u, v]) => window.luxel.sample(u, v), [(x + 0.5) / width, (y + 0.5) / height]);
    if (!sample.position || sample.alpha < 0.5) continue;
    seen++;
    const probe = await (await fetch(`${address}api/probe?${query}&x=${x}&y=${y}`)).json();
    assert.deepEqual([sample.x, sample.y], [x, y]);
    probe.radiance.forEach((value, c) => near(sample.radiance[c], value, Math.abs(value) * 2e-3 + 1e-6, `radiance ${c} at ${x}, ${y}`));
    probe.position.forEach((value, c) => near(sample.position[c], value, 1e-4 * probe.depth, `position ${c} at ${x}, ${y}`));
    // What is clicked is marked where it is seen.
    const back = await page.evaluate(async (position) => {
      const { project } = await import("/page/math/lens.js");
      return project(window.luxel.shown.lens, position);
    }, sample.position);
    near(back.x, x + 0.5, 1e-3, "column");
    near(back.y, y + 0.5, 1e-3, "row");
    near(back.depth, sample.depth, 1e-5 * sample.depth, "depth");
  }
  assert.ok(seen > 1, `${seen} places show something`);
}

export default {
  async "cameras of fisheyes and panoramas are shown through their own lens, pixel by pixel over their images"() {
    const viewer = await wide();
    const address = await viewer.url;
    const { cameras } = await (await fetch(`${address}api/scene`)).json();
    assert.deepEqual(cameras.map(({ camera_model: model }) => model), ["EQUIRECTANGULAR", "OPENCV_FISHEYE"]);
    for (const { name, w, h } of cameras) {
      const page = await open(`#view=${encodeURIComponent(name)}&compare=difference`, { at: address });
      await page.waitForFunction(() => window.luxel.comparison.isOn());
      await settled(page);
      assert.deepEqual(await page.evaluate(() => [window.luxel.shown.frame.head.width, window.luxel.shown.frame.head.height]), [w, h]);
      assert.equal(await page.locator("#projection").inputValue(), name.includes("fisheye") ? "fisheye" : "equirectangular");
      // The images are the scene's own, so the error is that of half floats.
      const worst = await page.evaluate(() => {
        const { luxel } = window;
        const differences = [];
        for (let i = 0; i < 4000; i++) {
          const [u, v] = window.centre(i * 37, i * 91);
          const [here, there] = [luxel.sample(u, v), luxel.comparison.sample(u, v)];
          if (!luxel.comparison.isMasked(there)) differences.push(Math.abs(here.luminance - there.luminance) / (here.luminance + 1e-4));
        }
        return [differences.length, Math.max(...differences)];
      });
      assert.ok(worst[0] > 2000 && worst[1] < 4e-3, `${name}: ${worst}`);
      await checkPixels(page, address, `view=${encodeURIComponent(name)}`);
      await shot(page, name.replace(/\W/g, "-"));
      assert.deepEqual(page.failures, []);
      await page.close();
    }
    viewer.child.kill();
  },

  async "a fisheye or a panorama is chosen for the picture, and its pixels are those of the program"() {
    const page = await open(`#view=${encodeURIComponent(camera.name)}`, { viewport: { width: 1000, height: 420 } });
    for (const [kind, change] of [["fisheye", { circle: 220 }], ["equirectangular", {}]]) {
      await page.locator("#projection").selectOption(kind);
      await set(page, change);
      const [view, width, height, json] = await page.evaluate(async () => {
        const { toJson } = await import("/page/math/lens.js");
        const { shown, state } = window.luxel;
        return [state.view, shown.lens.width, shown.lens.height, toJson(shown.lens)];
      });
      assert.equal(view, "");
      if (kind === "equirectangular") near(width / height, 2, 2 / height, "width over height");
      await checkPixels(page, url, `camera=${encodeURIComponent(json)}&width=${width}&height=${height}`);
      // Lines and marks follow the projection, and normals and frusta are drawn.
      await set(page, { showCameras: true, layer: "normals" });
      await shot(page, `${kind}-normals`);
      await set(page, { showCameras: false, layer: "radiance" });
      const hash = await page.waitForFunction((kind) => location.hash.includes(`projection=${kind}`) && location.hash, kind);
      const again = await open(await hash.jsonValue(), { viewport: { width: 1000, height: 420 } });
      assert.equal(await again.evaluate(() => window.luxel.shown.lens.projection.kind), kind);
      await again.close();
    }
    await page.evaluate((name) => window.luxel.standAt(name), scene.cameras[0].name);
    await settled(page);
    assert.equal(await page.evaluate(() => window.luxel.shown.lens.projection.kind), "pinhole");
    assert.equal(await page.locator("#projection").inputValue(), "pinhole");
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "the other eye is beside the picture, as far away as it should be"() {
    const page = await open(`#view=${encodeURIComponent(camera.name)}&against=eye&compare=beside&eyes=0.05`, { viewport: { width: 900, height: 300 } });
    await page.waitForFunction(() => window.luxel.comparison.isOn() && window.luxel.comparison.other.full && window.luxel.comparison.other.frame.depth);
    const { apart, right, middle, eyes } = await page.evaluate(() => {
      const { shown, comparison, scene, state } = window.luxel;
      const eyes = [comparison.other.lens.eye, shown.lens.eye];
      const own = scene.cameras.find(({ name }) => name === state.view).transform_matrix.slice(0, 3).map((row) => row[3]);
      return { apart: eyes[1].map((v, i) => v - eyes[0][i]), right: shown.lens.axes.right, middle: own, eyes };
    });
    apart.forEach((v, i) => near(v, 0.05 * right[i], 1e-9, "from eye to eye"));
    middle.forEach((v, i) => near((eyes[0][i] + eyes[1][i]) / 2, v, 1e-9, "between the eyes"));
    // Each picture is read where the pointer is, through its own eye.
    const box = await page.locator("#picture").boundingBox();
    for (const [pane, eye] of [[0, "other"], [1, "shown"]]) {
      await page.mouse.move(box.x + (box.width * (pane + 0.5)) / 2, box.y + box.height / 2);
      const { json, w, h, sample } = await page.evaluate(async (eye) => {
        const { toJson } = await import("/page/math/lens.js");
        const { lens } = eye === "other" ? window.luxel.comparison.other : window.luxel.shown;
        return { json: toJson(lens), w: lens.width, h: lens.height, sample: window.luxel.sample(0.5, 0.5) };
      }, eye);
      const probe = await (await fetch(`${url}api/probe?camera=${encodeURIComponent(json)}&width=${w}&height=${h}&x=${sample.x}&y=${sample.y}`)).json();
      probe.radiance.forEach((value, c) => near(sample.radiance[c], value, Math.abs(value) * 2e-3 + 1e-6, `${eye} ${c}`));
      probe.position?.forEach((value, c) => near(sample.position[c], value, 1e-4 * probe.depth, `${eye}: position ${c}`));
    }
    await shot(page, "two-eyes");
    assert.deepEqual(page.failures, []);
    await page.close();
  },
};
