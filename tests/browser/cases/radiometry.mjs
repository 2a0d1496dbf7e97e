// Radiometry: units, false colour in luminance, maps of errors, two scenes, splats as bodies, clip planes, far scenes.

import assert from "node:assert/strict";
import { cpSync, mkdirSync, mkdtempSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { exrOf } from "../exr.mjs";
import { at, camera, colors, decode, near, open, run, scene, serve, set, settled, shot, url } from "../harness.mjs";
import { greyPng } from "../png.mjs";

/** Origin of a scene in UTM coordinates. */
const ORIGIN = [455123, 4600321, 212];

/** The newest scene of a run. */
const newest = (folder) => {
  const clouds = path.join(folder, "point_cloud");
  const steps = readdirSync(clouds).map((name) => Number(name.split("_").at(-1)));
  return path.join(clouds, `iteration_${Math.max(...steps)}`, "point_cloud.ply");
};

/** A scene file whose splats are held relative to an origin in UTM coordinates. */
function atUtm(bytes) {
  const line = "comment luxel scene 1\n";
  const at = bytes.indexOf(line) + line.length;
  const frame = Buffer.from(`comment luxel local_frame ${JSON.stringify({ origin: ORIGIN, unit: 1 })}\n`);
  return Buffer.concat([bytes.subarray(0, at), frame, bytes.subarray(at)]);
}

/** Address of a picture's facts. */
const probe = async (base, x, y, more = "") => (await fetch(`${base}api/probe?view=${encodeURIComponent(camera.name)}&x=${x}&y=${y}${more}`)).json();

/** The middles of some pixels that are lit, 0 to 1, with their samples. */
const lit = (page) =>
  page.evaluate(() => {
    const found = [];
    for (let i = 0; i < 3000 && found.length < 6; i++) {
      const place = window.centre(i * 37, i * 91);
      const sample = window.luxel.sample(...place);
      if (sample?.depth && sample.luminance > 0) found.push({ place, sample });
    }
    return found;
  });

export default {
  async "luminance is shown in cd/m2 and EV where a unit is known"() {
    const page = await open(`${at}&cdm2=100&layer=stops&scale=luminance`);
    const found = await lit(page);
    const seen = await colors(page, found.map(({ place }) => place));
    for (const [i, { sample }] of found.entries()) {
      // Half decades of cd/m2, from 0.01.
      const exact = 2 * Math.log10(sample.luminance * 100) + 4;
      const band = Math.round(Math.min(16, Math.max(0, exact)));
      if (Math.abs(exact - Math.floor(exact) - 0.5) < 0.05) continue;
      const swatch = await page.locator(`#legend [data-stops="${band}"] i`).evaluate((element) => getComputedStyle(element).backgroundColor);
      assert.equal(`rgb(${seen[i].join(", ")})`, swatch, `${sample.luminance * 100} cd/m2`);
    }
    assert.ok((await page.locator("#legend").innerText()).includes("cd/m²"));
    await shot(page, "false-colour-luminance");
    const box = await page.locator("#picture").boundingBox();
    const { place, sample } = found[0];
    await page.mouse.move(box.x + place[0] * box.width, box.y + place[1] * box.height);
    const readout = await page.locator("#readout").innerText();
    const ev = Number(readout.match(/EV100\s*([+−][\d.]+)/)[1].replace("−", "-"));
    near(ev, Math.log2((sample.luminance * 100 * 100) / 12.5), 0.01, "EV100");
    assert.ok(readout.includes("cd/m²"), readout);
    // Without a unit there is no EV.
    await set(page, { cdm2: 0 });
    if (!scene.cd_m2_per_unit) assert.ok(!(await page.locator("#readout").innerText()).includes("EV100"));
    await page.close();
  },

  async "maps of errors have the colours of their legends"() {
    const page = await open(`${at}&compare=difference`);
    await page.waitForFunction(() => window.luxel.comparison.isOn());
    for (const error of ["stops", "signed", "relative"]) {
      await set(page, { error });
      const found = await page.evaluate((error) => {
        const { luxel } = window;
        const least = (0.18 * luxel.scene.radiance_scale * 2 ** -8) / 2 ** luxel.state.exposure;
        const places = [[0.3, 0.3], [0.7, 0.6], [0.5, 0.8], [0.2, 0.9], [0.6, 0.2], [0.8, 0.4], [0.1, 0.5]];
        const all = places.map((place) => {
          const [a, b] = [luxel.sample(...place), luxel.comparison.sample(...place)].map((sample) => Math.max(least, sample.luminance));
          const value = error === "relative" ? Math.abs(a - b) / b : error === "signed" ? Math.log2(a / b) : Math.abs(Math.log2(a / b));
          return { place, value };
        });
        // The first step of the table of 256 is that of no difference at all.
        return all.filter(({ value }) => Math.abs(error === "relative" ? 4 * value : value) > 0.02);
      }, error);
      assert.ok(found.length >= 3, `${found.length} places differ`);
      const seen = await colors(page, found.map(({ place }) => place));
      const expected = await page.evaluate(
        async ([error, values]) => {
          const colors = await import("/page/display/falsecolor.js");
          return values.map((value) => (error === "signed" ? colors.colorOfSigned(value) : colors.colorOfDifference(error === "relative" ? 4 * value : value)));
        },
        [error, found.map(({ value }) => value)],
      );
      // A table of 256 steps.
      seen.forEach((color, i) => color.forEach((code, c) => near(code, expected[i][c], 8, `${error} ${found[i].value}`)));
      await shot(page, `error-${error}`);
    }
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "two scenes are shown from the same camera"() {
    const second = serve("127.0.0.1:0", run, "--with", run);
    const address = await second.url;
    const page = await open(`${at}&compare=beside`, { at: address });
    await page.waitForFunction(() => window.luxel.comparison.isOn() && window.luxel.comparison.other.full);
    await settled(page);
    const [u, v] = [0.4, 0.6];
    // A run beside itself: both halves are the same.
    const [left, right] = await colors(page, [[u / 2, v], [0.5 + u / 2, v]]);
    left.forEach((code, c) => near(right[c], code, 1, "halves"));
    const [a, b] = await page.evaluate(([u, v]) => [window.luxel.sample(u, v), window.luxel.comparison.sample(u, v)], [u, v]);
    near(b.luminance, a.luminance, 2e-3 * a.luminance, "both values");
    await shot(page, "two-scenes");
    // Cameras stay linked, and the edit is of the first alone.
    await page.evaluate(() => window.luxel.controls.rotate(40, 10));
    await set(page, { edit: "gain 0.5" });
    await page.waitForFunction(() => window.luxel.comparison.stream.fullKey === window.luxel.want().key);
    await settled(page);
    const [edited, plain] = await page.evaluate(([u, v]) => [window.luxel.sample(u, v), window.luxel.comparison.sample(u, v)], [u, v]);
    near(edited.luminance, plain.luminance / 2, 0.01 * plain.luminance, "edited beside plain");
    for (const compare of ["wipe", "difference", "flicker"]) {
      await set(page, { compare });
      await page.waitForFunction(() => window.luxel.comparison.isOn());
      await shot(page, `two-scenes-${compare}`);
    }
    const refused = await fetch(`${address}api/frame?view=${encodeURIComponent(camera.name)}&scene=2`);
    assert.equal(refused.status, 400);
    assert.deepEqual(page.failures, []);
    await page.close();
    second.child.kill();
  },

  async "a second scene in another colour space is converted to that of the first"() {
    const folder = mkdtempSync(path.join(tmpdir(), "luxel-acescg-"));
    const file = path.join(folder, "acescg.ply");
    // The same numbers, which now are of AP1 primaries.
    const bytes = readFileSync(newest(run));
    const line = Buffer.from(`comment luxel color_space ${scene.color_space}\n`);
    const start = bytes.indexOf(line);
    assert.ok(start > 0, "the scene names no colour space");
    writeFileSync(file, Buffer.concat([bytes.subarray(0, start), Buffer.from("comment luxel color_space acescg\n"), bytes.subarray(start + line.length)]));
    assert.equal(scene.color_space, "linear-rec709");
    const second = serve("127.0.0.1:0", run, "--with", file);
    try {
      const address = await second.url;
      const page = await open(`${at}&compare=beside&curve=none`, { at: address });
      await page.waitForFunction(() => window.luxel.comparison.isOn() && window.luxel.comparison.other.full);
      await settled(page);
      // From AP1 (D60) to Rec.709 (D65), adapted by Bradford's matrix.
      const matrix = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.1408, -0.01055], [-0.024, -0.12897, 1.15297]];
      const places = [[0.3, 0.3], [0.5, 0.5], [0.6, 0.7], [0.2, 0.8], [0.75, 0.4]];
      const found = await page.evaluate((places) => places.map((place) => [window.luxel.sample(...place), window.luxel.comparison.sample(...place)]), places);
      const gain = await page.evaluate(() => 2 ** window.luxel.state.exposure / window.luxel.scene.radiance_scale);
      const seen = await colors(page, places.map(([u, v]) => [u / 2, v]));
      for (const [i, [first, other]] of found.entries()) {
        const size = Math.max(...first.radiance);
        const expected = matrix.map((row) => row.reduce((sum, weight, c) => sum + weight * first.radiance[c], 0));
        expected.forEach((value, c) => near(other.radiance[c], value, 4e-3 * size, `channel ${c} at ${places[i]}`));
        near(other.luminance, 0.2126 * expected[0] + 0.7152 * expected[1] + 0.0722 * expected[2], 4e-3 * size, "luminance");
        // The picture on the left has the converted colour.
        expected.forEach((value, c) => near(decode(seen[i][c]), Math.min(1, Math.max(0, value * gain)), 0.012, `colour ${c} at ${places[i]}`));
      }
      // It differs, and the difference is that of luminance.
      await set(page, { compare: "difference", error: "signed" });
      await page.waitForFunction(() => document.getElementById("error-text").textContent.startsWith("mean"));
      await shot(page, "two-colour-spaces");
      assert.deepEqual(page.failures, []);
      await page.close();
    } finally {
      second.child.kill();
      rmSync(folder, { recursive: true });
    }
  },

  async "masked pixels of the ground truth are hatched in maps of errors, and not in their numbers"() {
    const folder = mkdtempSync(path.join(tmpdir(), "luxel-masked-"));
    cpSync(path.join(run, "dataset"), folder, { recursive: true });
    // The left quarter of each image does not count.
    const { width, height } = exrOf(readFileSync(path.join(folder, "images", readdirSync(path.join(folder, "images"))[0])));
    const mask = greyPng(width, height, (x) => (x < width / 4 ? 0 : 255));
    mkdirSync(path.join(folder, "masks"));
    for (const name of readdirSync(path.join(folder, "images"))) writeFileSync(path.join(folder, "masks", `${path.parse(name).name}.png`), mask);
    const masked = serve("127.0.0.1:0", run, "--data", folder);
    try {
      const address = await masked.url;
      const page = await open(`${at}&compare=difference`, { at: address });
      await page.waitForFunction(() => window.luxel.comparison.isOn());
      await settled(page);
      await page.waitForFunction(() => document.getElementById("error-text").textContent.includes("25.00 % masked"));
      // The numbers are those of the pixels that count.
      const [said, expected] = await page.evaluate(() => {
        const { luxel } = window;
        const least = (0.18 * luxel.scene.radiance_scale * 2 ** -8) / 2 ** luxel.state.exposure;
        const { width, height } = luxel.display.truth.head;
        let [sum, count] = [0, 0];
        for (let y = 0; y < height; y++) for (let x = width / 4; x < width; x++) {
          const place = [(x + 0.5) / width, (y + 0.5) / height];
          const [a, b] = [luxel.sample(...place), luxel.comparison.sample(...place)].map((sample) => Math.max(least, sample.luminance));
          sum += Math.abs(Math.log2(a / b));
          count++;
        }
        return [document.getElementById("error-text").textContent, sum / count];
      });
      near(Number(said.match(/^mean ([\d.e-]+) stops/)[1]), expected, 1e-3 * expected, "mean error");
      for (const error of ["stops", "signed", "relative"]) {
        await set(page, { error });
        const seen = await colors(page, Array.from({ length: 24 }, (_, i) => [0.1, 0.3 + i / 100]));
        for (const color of seen) assert.ok([64, 102].some((code) => color.every((value) => Math.abs(value - code) <= 1)), `${error}: ${color}`);
        assert.ok(new Set(seen.map(String)).size > 1, "no hatching");
        const beside = await colors(page, Array.from({ length: 24 }, (_, i) => [0.3 + i / 50, 0.55]));
        assert.ok(beside.filter(([r, g, b]) => r === g && g === b && (Math.abs(r - 64) <= 1 || Math.abs(r - 102) <= 1)).length < 3, "hatched beside the mask");
      }
      assert.ok((await page.locator("#legend").innerText()).includes("hatched: masked"));
      const box = await page.locator("#picture").boundingBox();
      await page.mouse.move(box.x + 0.1 * box.width, box.y + 0.5 * box.height);
      assert.match(await page.locator("#readout").innerText(), /difference\s*masked/);
      await page.mouse.move(box.x + 0.6 * box.width, box.y + 0.5 * box.height);
      assert.match(await page.locator("#readout").innerText(), /difference\s*[+−]/);
      await shot(page, "error-masked");
      assert.deepEqual(page.failures, []);
      await page.close();
    } finally {
      masked.child.kill();
      rmSync(folder, { recursive: true, force: true });
    }
  },

  async "depth, coverage, normals and bodies move with the camera at a reduced resolution"() {
    const page = await open(at);
    for (const change of [{ layer: "depth" }, { layer: "alpha" }, { layer: "normals" }, { layer: "radiance", splats: "ellipsoids" }, { layer: "normals", splats: "centres" }]) {
      await set(page, change);
      const before = await page.evaluate(() => window.luxel.shown.frame.head.height);
      // Moves until a picture of the movement is shown.
      const moving = await page.evaluate(async (layer) => {
        const { luxel } = window;
        const layers = [];
        for (let i = 0; i < 400; i++) {
          luxel.controls.rotate(2, 0);
          await new Promise(requestAnimationFrame);
          const { shown } = luxel;
          if (!shown.full && luxel.stream.frames > 0) {
            const plane = layer === "alpha" ? shown.frame.alpha : layer === "radiance" ? shown.frame.rgb : shown.frame.depth;
            layers.push({ height: shown.frame.head.height, has: plane?.length > 0, isOfPicture: layer === "radiance" || luxel.display.lens.width === shown.frame.head.width, eye: shown.lens.eye[0] });
            if (new Set(layers.map(({ eye }) => eye)).size >= 3) break;
          }
        }
        return layers;
      }, change.layer);
      const name = JSON.stringify(change);
      assert.ok(new Set(moving.map(({ eye }) => eye)).size >= 3, `${name} stands still`);
      assert.ok(moving.every(({ has, height }) => has && height <= before), `${name}: ${JSON.stringify(moving.at(-1))}`);
      assert.ok(moving.every(({ isOfPicture }) => isOfPicture), `${name}: depth is of another picture`);
      await settled(page);
      assert.equal(await page.evaluate(() => window.luxel.shown.frame.head.height), await page.evaluate(() => window.luxel.want().height));
    }
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "splats are drawn as bodies, with normals and clip planes"() {
    const page = await open(`${at}&splats=ellipsoids`);
    const [x, y] = [Math.floor(camera.w / 2), Math.floor(camera.h / 2)];
    await set(page, { compare: "wipe" });
    const expected = await probe(url, x, y, "&splats=ellipsoids&splat_size=1&splat_opacity=0.1");
    const sample = await page.evaluate(([u, v]) => window.luxel.sample(u, v), [(x + 0.5) / camera.w, (y + 0.5) / camera.h]);
    if (expected.depth) near(sample.depth, expected.depth, 1e-5 * expected.depth, "depth of a body");
    near(sample.luminance, expected.luminance, 2e-3 * expected.luminance + 1e-6, "luminance of a body");
    await set(page, { compare: "off" });
    await shot(page, "ellipsoids");
    await set(page, { layer: "normals" });
    await shot(page, "normals");
    await set(page, { layer: "radiance", splats: "centres", splatSize: 1.5 });
    await shot(page, "centres");
    await set(page, { splats: "blended" });
    const depths = await page.evaluate(() => [...window.luxel.shown.frame.depth].filter((z) => z < 1e30).sort((a, b) => a - b));
    const middle = depths[Math.floor(depths.length / 2)];
    await set(page, { far: middle });
    const farthest = await page.evaluate(() => window.luxel.shown.frame.depth.reduce((most, z) => (z < 1e30 && z > most ? z : most), 0));
    assert.ok(farthest < 1.2 * middle, `${farthest} beyond ${middle}`);
    await shot(page, "clipped");
    await set(page, { far: 0, layer: "normals" });
    await shot(page, "normals-of-blend");
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "the up axis is chosen, and sections fold"() {
    const page = await open();
    await page.locator("#up").selectOption("1,0,0");
    await page.evaluate(() => window.luxel.controls.level());
    const axes = await page.evaluate(() => window.luxel.state.axes);
    near(axes.right[0], 0, 1e-6, "level");
    assert.ok((await page.waitForFunction(() => location.hash.includes("upaxis=1") && location.hash)));
    const heading = page.locator("#shading-section h2 button");
    assert.equal(await heading.getAttribute("aria-expanded"), "false");
    await heading.click();
    assert.ok(await page.locator("#splats").isVisible());
    await page.getByRole("button", { name: "ellipsoids" }).click();
    await settled(page);
    assert.ok(await page.locator("#splat-size").isVisible());
    await page.close();
  },

  async "scenes far from the origin keep their digits"() {
    const folder = mkdtempSync(path.join(tmpdir(), "luxel-far-"));
    const file = path.join(folder, "far.ply");
    writeFileSync(file, atUtm(readFileSync(newest(run))));
    const other = serve("127.0.0.1:0", file);
    const address = await other.url;
    const facts = await (await fetch(`${address}api/scene`)).json();
    facts.bounds[0].forEach((value, c) => near(value, ORIGIN[c], 2000, "bounds"));
    const page = await open("", { at: address });
    const sample = await page.evaluate(() => window.luxel.sample(...window.centre(Math.floor(window.luxel.shown.frame.head.width / 2), Math.floor(window.luxel.shown.frame.head.height / 2))));
    const [lens, head] = await page.evaluate(async () => [(await import("/page/math/lens.js")).toJson(window.luxel.shown.lens), window.luxel.shown.frame.head]);
    const found = await (await fetch(`${address}api/probe?camera=${encodeURIComponent(lens)}&width=${head.width}&height=${head.height}&x=${sample.x}&y=${sample.y}`)).json();
    assert.ok(found.depth > 0, "nothing in the middle");
    near(sample.luminance, found.luminance, 2e-3 * found.luminance + 1e-6, "luminance");
    found.position.forEach((value, c) => near(sample.position[c], value, 1e-4, `position ${c}`));
    // Moving, the address and the readout keep to fractions of a millimetre.
    await page.evaluate(() => window.luxel.controls.rotate(30, 5));
    await page.waitForFunction(() => window.luxel.saveAt === 0 && location.hash.includes("eye="));
    const eye = await page.evaluate(() => window.luxel.state.eye);
    const again = await open(await page.evaluate(() => location.hash), { at: address });
    (await again.evaluate(() => window.luxel.state.eye)).forEach((value, c) => near(value, eye[c], 1e-4, `eye ${c}`));
    const box = await again.locator("#picture").boundingBox();
    await again.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
    await shot(again, "far");
    assert.match(await again.locator("#readout").innerText(), /455\d{3}\.\d{3}/);
    await again.close();
    await page.close();
    other.child.kill();
    rmSync(folder, { recursive: true });
  },
};
