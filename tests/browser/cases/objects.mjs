// Objects that are placed in the picture: their light, their shadow, and the files that they come from.

import assert from "node:assert/strict";
import { ball, glb } from "../gltf.mjs";
import { at, near, open, shot } from "../harness.mjs";

/** Opens the page, and places an object by a click. */
async function withObject() {
  const page = await open(at);
  await page.keyboard.press("u");
  const box = await page.locator("#picture").boundingBox();
  await page.mouse.click(box.x + box.width * 0.72, box.y + box.height * 0.7);
  await page.waitForFunction(() => window.luxel.placed.object?.light, null, { timeout: 120000 });
  await page.waitForFunction(() => window.luxel.shown.full && window.luxel.shown.frame.depth, null, { timeout: 60000 });
  return page;
}

const slide = (page, id, value) => page.evaluate(([id, value]) => {
  document.getElementById(id).value = value;
  document.getElementById(id).dispatchEvent(new Event("input"));
}, [id, String(value)]);
/** Waits until a mesh has its shadow, too. */
const rested = (page) => page.waitForFunction(() => window.luxel.placed.resting === undefined);

const file = (name, buffer) => ({ name, mimeType: "model/gltf-binary", buffer });
const says = (page, part) => page.waitForFunction((part) => document.getElementById("object-text").textContent.includes(part), part);

/** Values that the object changed, and whether one is no number. */
const seen = (page) => page.evaluate(() => {
  const { placed, shown } = window.luxel;
  const plain = placed.plain.get(shown.frame);
  let changed = 0;
  for (let i = 0; plain && i < plain.length; i++) changed += plain[i] !== shown.frame.rgb[i] ? 1 : 0;
  return { changed, bad: shown.frame.rgb.some((bits) => (bits & 0x7c00) === 0x7c00), lamps: placed.object?.light?.lamps.length };
});

export default {
  async "a ball placed by a click has the scene's light and a shadow, and goes again"() {
    const page = await withObject();
    assert.equal(await page.locator("#pins li").count(), 0);
    const grey = await seen(page);
    assert.ok(grey.changed > 300 && !grey.bad, JSON.stringify(grey));
    await page.waitForTimeout(300);
    await shot(page, "grey-ball");
    await page.selectOption("#object-kind", "chrome");
    await page.waitForTimeout(300);
    await shot(page, "chrome-ball");
    const chrome = await seen(page);
    assert.ok(chrome.changed > 300 && chrome.lamps === grey.lamps);
    await slide(page, "object-size", -3);
    assert.ok((await seen(page)).changed > chrome.changed, "a larger ball");
    await page.click("#object-remove");
    assert.ok(await page.locator("#object-row").isHidden());
    assert.equal((await seen(page)).changed, 0);
    await page.close();
  },

  async "cards and a teapot stand where they are placed, have a shadow, and turn"() {
    const page = await withObject();
    await slide(page, "object-size", -3);
    await rested(page);
    for (const kind of ["grey-card", "white-card", "teapot", "chrome-teapot"]) {
      await page.selectOption("#object-kind", kind);
      const still = await seen(page);
      assert.ok(still.changed > 300 && !still.bad, `${kind}: ${JSON.stringify(still)}`);
      const before = await page.evaluate(() => window.luxel.shown.frame.rgb.slice());
      await slide(page, "object-turn", 60);
      await rested(page);
      assert.ok(await page.evaluate((before) => window.luxel.shown.frame.rgb.some((value, i) => value !== before[i]), before), `${kind} turns`);
      await page.waitForTimeout(300);
      await shot(page, kind);
      await slide(page, "object-turn", 0);
      await rested(page);
    }
    await page.close();
  },

  async "a ball of triangles from a file has the light and the shadow of the grey ball"() {
    const page = await withObject();
    await slide(page, "object-size", -2.5);
    // Matt as the grey ball is: without the gloss that glTF gives to what is no metal.
    const material = { pbrMetallicRoughness: { baseColorFactor: [0.5, 0.5, 0.5, 1], metallicFactor: 0 }, extensions: { KHR_materials_specular: { specularFactor: 0 } } };
    const { json, binary } = ball(5, material);
    await page.setInputFiles("#object-file", file("ball.glb", glb(json, binary)));
    await says(page, "8,192 triangles");
    await rested(page);
    await page.waitForTimeout(300);
    await shot(page, "ball-of-triangles");
    const found = await page.evaluate(async () => {
      const { placed, shown } = window.luxel;
      const [{ fromHalf }, { project }] = await Promise.all([import("/page/math/half.js"), import("/page/math/lens.js")]);
      const picture = (kind) => {
        placed.kind.value = kind;
        placed.again();
        return shown.frame.rgb.slice();
      };
      const [grey, own] = [picture("grey"), picture("own")];
      const plain = placed.plain.get(shown.frame);
      const { lens } = shown;
      const { width, height } = shown.frame.head;
      const middle = project(lens, placed.middle());
      const radius = (lens.fx * placed.radius()) / middle.depth;
      const inside = { pixels: 0, grey: 0, own: 0 };
      const shadow = [];
      for (let i = 0; i < width * height; i++) {
        const away = Math.hypot((i % width) + 0.5 - middle.x, Math.floor(i / width) + 0.5 - middle.y);
        const [a, b, before] = [grey, own, plain].map((rgb) => fromHalf(rgb[3 * i + 1]));
        if (away < 0.85 * radius) Object.assign(inside, { pixels: inside.pixels + 1, grey: inside.grey + a, own: inside.own + b });
        else if (away > 1.15 * radius && before > 0 && a < before) shadow.push([a / before, b / before]);
      }
      // The middle of the shadow is where it is deepest.
      const deep = shadow.sort(([a], [b]) => a - b).slice(0, Math.ceil(shadow.length / 20));
      const mean = (list, k) => list.reduce((sum, pair) => sum + pair[k], 0) / list.length;
      return { inside, deep: [mean(deep, 0), mean(deep, 1)], count: shadow.length };
    });
    assert.ok(found.inside.pixels > 300 && found.count > 100, JSON.stringify(found));
    near(found.inside.own / found.inside.grey, 1, 0.03, "brightness against the grey ball");
    near(found.deep[1] / found.deep[0], 1, 0.1, `shadow factor ${found.deep[0]} against that of the grey ball`);
    await page.close();
  },

  async "files without triangles that can be read say so, and what is left out is named"() {
    const page = await withObject();
    const { json, binary } = ball(1, { pbrMetallicRoughness: { baseColorTexture: { index: 0 } }, alphaMode: "BLEND" });
    const opens = (name, description, content = binary) => page.setInputFiles("#object-file", file(name, glb(description, content)));
    await opens("textured.glb", json);
    await says(page, "textured.glb: 32 triangles; ignored: textures, transparency");
    await opens("packed.glb", { ...json, extensionsRequired: ["KHR_draco_mesh_compression"] });
    await says(page, "packed.glb: the file needs KHR_draco_mesh_compression, which is not read");
    await opens("splats.glb", { ...json, extensionsRequired: ["KHR_gaussian_splatting"] });
    await says(page, "splats.glb: the file holds splats: open it with luxel view");
    await opens("short.glb", json, binary.subarray(0, 100));
    await says(page, "reaches beyond the file");
    await opens("beyond.glb", { ...json, accessors: [{ ...json.accessors[0], count: 5 }, json.accessors[1]] });
    await says(page, "an index beyond the 5 corners");
    await opens("empty.glb", { asset: { version: "2.0" } });
    await says(page, "empty.glb: the file has no triangles");
    await opens("odd.glb", { ...json, meshes: [{ primitives: 3 }] });
    await says(page, "odd.glb: its description does not follow glTF 2.0");
    await opens("point.glb", json, Buffer.alloc(binary.length));
    await says(page, "point.glb: the file has no triangles");
    await page.setInputFiles("#object-file", file("text.glb", Buffer.from("no binary glTF at all")));
    await says(page, "not a binary glTF file");
    await page.close();
  },

  async "a lamp that is a mesh lights by its parts, is met where it is, and has an outline"() {
    const page = await open(at);
    const found = await page.evaluate(async () => {
      const { irradianceFrom, lampAlong, outline, reach, spread, visibility } = await import("/page/object/lamps.js");
      const { partsOf } = await import("/page/object/meshlamp.js");
      // A bar of 2 x 0.1 x 0.1 along x, its sides in 20 tiles.
      const points = Array.from({ length: 11 * 4 }, (_, i) => [Math.floor(i / 4) / 5 - 1, i & 1 ? 0.05 : -0.05, i & 2 ? 0.05 : -0.05]);
      const ring = [[0, 1], [1, 3], [3, 2], [2, 0]];
      const triangles = Array.from({ length: 10 }, (_, k) => ring.flatMap(([a, b]) => [[4 * k + a, 4 * k + b, 4 * k + 4 + a], [4 * k + b, 4 * k + 4 + b, 4 * k + 4 + a]])).flat();
      const lamp = { shape: "mesh", middle: [0, 0, 0], points, triangles, mean_area: 0.2, radiance: [10, 5, 1], intensity: [2, 1, 0.2], power: [25, 12.5, 2.5] };
      const towards = (point) => irradianceFrom(lamp, point, [0, 0, -1]);
      return {
        parts: partsOf(lamp).length,
        far: towards([0, 0, 100])[0] * 1e4,
        near: towards([0, 0, 0.5])[0],
        hit: [lampAlong([lamp], [0.9, 0, 3], [0, 0, -1]), lampAlong([lamp], [0.9, 0.2, 3], [0, 0, -1]), lampAlong([lamp], [0.9, 0, 3], [0, 0, 1])],
        outline: outline(lamp, [0, 0, 5], 16).map((line) => line.length),
        reach: reach(lamp),
        ends: spread(lamp, [0, 0, 5], 8).slice(0, 2).map(([x]) => x),
        seen: visibility(lamp, [0, 0, 3], [0.75, 0, 1], 0.3),
      };
    });
    assert.equal(found.parts, 8);
    near(found.far, 2, 0.001, "irradiance from afar");
    // Of a line of even light; as a point it is 8.
    near(found.near, 2 / (0.5 * Math.hypot(1, 0.5)), 0.25, "irradiance nearby");
    assert.deepEqual(found.hit, [[10, 5, 1], null, null]);
    // Twice along its length; the bar is open at its ends.
    assert.deepEqual(found.outline, [22]);
    near(found.reach, Math.hypot(1, 0.05, 0.05), 1e-6, "reach");
    assert.deepEqual(found.ends.map(Math.abs), [1, 1]);
    assert.ok(found.seen > 0.4 && found.seen < 0.95, `a ball before one end hides a part: ${found.seen}`);
    await page.close();
  },
};
