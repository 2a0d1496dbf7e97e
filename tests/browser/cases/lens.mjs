// A lens before the picture, and the display of OpenColorIO: what the page shows is what the program makes.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { at, camera, colors, luxel, near, open, run, serve, set, settled, shot } from "../harness.mjs";
import { pixelsOf } from "../png.mjs";

const CONFIG = "ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5";
const folder = mkdtempSync(path.join(tmpdir(), "luxel-lens-"));
process.on("exit", () => rmSync(folder, { recursive: true, force: true }));
const hasOcio = /features .*\bocio\b/.test(execFileSync(luxel, ["--version"], { encoding: "utf8" }));

/** Waits until all samples are there. */
const sampled = (page) => page.waitForFunction(() => window.luxel.aperture.parts === 16 && !window.luxel.aperture.adding, null, { timeout: 240_000 });

export default {
  async "a lens blurs what is out of focus, and ends with the samples of luxel render"() {
    const page = await open(`${at}&compare=off`, { viewport: { width: 700, height: 400 } });
    await page.keyboard.press("i");
    await settled(page);
    const plain = await page.evaluate(() => window.luxel.shown.frame.rgb.slice());
    await page.evaluate(() => window.luxel.set({ aperture: 0.08 * window.luxel.controls.size, focus: window.luxel.sample(0.5, 0.5).depth ?? window.luxel.controls.size }));
    await settled(page);
    await sampled(page);
    await page.waitForTimeout(300);
    await shot(page, "lens");
    const found = await page.evaluate(async () => {
      const { shown, state, aperture, source } = window.luxel;
      const { fromHalf } = await import("/page/math/half.js");
      // All samples at once, as the server and luxel render take them.
      const variant = window.luxel.variant();
      const whole = await source.frame(shown.lens, { edit: "", variant: { ...variant, lens: { ...variant.lens, part: [0, 1] } }, radiance: true, layers: false, name: "test" });
      const values = (frame) => Array.from(frame.rgb, (value) => fromHalf(value) * frame.head.scale);
      const [mean, expected] = [values(shown.frame), values(whole)];
      const off = mean.reduce((most, value, i) => Math.max(most, Math.abs(value - expected[i]) / Math.max(expected[i], 1e-2)), 0);
      return { off, focus: state.focus, line: aperture.line(), depth: shown.frame.depth !== null };
    });
    assert.ok(found.off < 2e-3 && found.depth, JSON.stringify(found));
    assert.match(found.line, /128 of 128 samples/);
    assert.ok(await page.evaluate((plain) => window.luxel.shown.frame.rgb.some((value, i) => value !== plain[i]), plain), "the lens changes the picture");
    await set(page, { aperture: 0 });
    assert.ok(await page.evaluate((plain) => window.luxel.shown.frame.rgb.every((value, i) => value === plain[i]), plain), "without a lens the picture is as before");
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "the focus is picked by a click, and an f-number needs a scale"() {
    const page = await open(at);
    await page.fill("#aperture", "0.01");
    await page.waitForFunction(() => window.luxel.state.focus > 0 && !document.getElementById("focus-row").hidden);
    await page.click("#focus-tool");
    const box = await page.locator("#picture").boundingBox();
    const place = [0.6, 0.7];
    await page.mouse.click(box.x + box.width * place[0], box.y + box.height * place[1]);
    await page.waitForFunction(() => !window.luxel.aperture.isPicking);
    await settled(page);
    const depth = await page.evaluate(([u, v]) => window.luxel.sample(u, v).depth, place);
    near(await page.evaluate(() => window.luxel.state.focus), depth, 0.02 * depth, "distance in focus");
    await page.fill("#f-stop", "2.8");
    const { state, text, metres } = await page.evaluate(() => ({ state: window.luxel.state, text: window.luxel.aperture.line(), metres: window.luxel.aperture.metres() }));
    assert.equal(state.aperture, 0);
    if (metres === 0) assert.match(text, /needs the length of a unit/);
    await set(page, { metres: 0.1 });
    const { diameter, expected } = await page.evaluate(() => {
      const { aperture, dots } = window.luxel;
      const { fx, width } = window.luxel.lens(dots.width, dots.height);
      return { diameter: aperture.diameter(), expected: (0.036 * fx) / width / 2.8 / 0.1 };
    });
    near(diameter, expected, 1e-9, "diameter of f/2.8");
    await page.close();
  },

  async "a display of OpenColorIO is what luxel render --ocio writes"() {
    if (!hasOcio) return console.log("  without OpenColorIO");
    execFileSync(luxel, ["render", run, "--split", camera.split, "--ocio", CONFIG, "--device", "cpu", "-o", path.join(folder, "frames"), "--quiet"], { stdio: ["ignore", "ignore", "inherit"] });
    const expected = pixelsOf(readFileSync(path.join(folder, "frames", `${camera.name.split("/").at(-1)}.png`)));
    const display = serve("127.0.0.1:0", run, "--ocio", CONFIG);
    // A pixel of the camera is a pixel of the picture.
    const page = await open(`${at}&compare=wipe&wipe=0`, { at: await display.url });
    await page.waitForFunction(() => window.luxel.scene.display?.values);
    assert.equal(await page.evaluate(() => window.luxel.state.curve), "ocio");
    assert.match(await page.locator("#curve option:checked").innerText(), /sRGB.*ACES 2/);
    assert.ok(!(await page.evaluate(() => location.hash)).includes("curve="));
    const places = Array.from({ length: 60 }, (_, i) => [Math.floor(((i * 0.618) % 1) * camera.w), Math.floor((((i + 0.5) / 60)) * camera.h)]);
    const found = await colors(page, places.map(([x, y]) => [(x + 0.5) / camera.w, (y + 0.5) / camera.h]));
    await shot(page, "ocio");
    places.forEach(([x, y], i) => found[i].forEach((value, c) => near(value, expected.at(x, y)[c], 3, `pixel ${x}, ${y}, channel ${c}`)));
    await page.keyboard.press("t");
    assert.equal(await page.evaluate(() => window.luxel.state.curve), "none");
    assert.deepEqual(page.failures, []);
    await page.close();
    display.child.kill();
  },
};
