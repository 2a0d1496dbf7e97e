// Camera paths, light probes, stills: what the page makes and saves is what the program makes.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { at, luxel, open, run, set, settled, shot } from "../harness.mjs";
import { pixelsOf } from "../png.mjs";

const stamp = `test-${process.pid}`;
const work = mkdtempSync(path.join(tmpdir(), "luxel-paths-"));
process.on("exit", () => {
  for (const folder of [work, path.join(run, "paths", stamp), path.join(run, "paths", `${stamp}-long`), path.join(run, "probes", `${stamp}.exr`)]) rmSync(folder, { recursive: true, force: true });
});
const program = (...args) => execFileSync(luxel, [...args, "--quiet"], { stdio: ["ignore", "pipe", "inherit"] });

/** Waits for a file that a click downloads. */
async function downloaded(page, selector) {
  const [file] = await Promise.all([page.waitForEvent("download"), page.click(selector)]);
  return readFileSync(await file.path());
}

const fill = (page, selector, value) => page.fill(selector, String(value)).then(() => page.locator(selector).blur());

/** Opens the page, and makes a small path of two cameras. */
async function withPath(seconds = 1, rate = 4) {
  const page = await open(at);
  await page.locator("#path-section").scrollIntoViewIfNeeded();
  await page.click("#path-add");
  await page.evaluate(() => window.luxel.standAtNext(2));
  await settled(page);
  await page.click("#path-add");
  await fill(page, "#path-duration", seconds);
  await fill(page, "#path-fps", rate);
  await fill(page, "#path-width", 96);
  await fill(page, "#path-height", 54);
  await page.waitForFunction((count) => window.luxel.path.frames.length === count && window.luxel.path.makeAt === 0, Math.round(seconds * rate));
  return page;
}

export default {
  async "a path renders the frames that luxel render makes, and never over them"() {
    const page = await withPath();
    await set(page, { edit: "gain 0.5" });
    const file = path.join(work, "path.json");
    writeFileSync(file, await downloaded(page, "#path-save"));
    await page.fill("#path-name", stamp);
    await page.click("#path-render");
    await page.waitForFunction(() => window.luxel.path.render.status?.state === "finished", null, { timeout: 120000 });
    const frames = path.join(run, "paths", stamp);
    program("render", run, "--cameras", file, "--edit", "gain 0.5", "--device", "cpu", "-o", path.join(work, "frames"));
    const names = readdirSync(path.join(work, "frames")).filter((name) => name.endsWith(".exr"));
    assert.equal(names.length, 4);
    for (const name of names) assert.ok(readFileSync(path.join(frames, name)).equals(readFileSync(path.join(work, "frames", name))), name);
    assert.ok(readFileSync(path.join(frames, "cameras.json")).equals(readFileSync(file)));
    await shot(page, "path");
    // The next render has another name; the old one is refused.
    assert.equal(await page.inputValue("#path-name"), stamp.replace(/-(\d+)$/, (_, n) => `-${Number(n) + 1}`));
    await page.fill("#path-name", stamp);
    await page.click("#path-render");
    await page.waitForFunction(() => document.getElementById("path-render-text").textContent.includes("exists already"));
    page.failures = page.failures.filter((text) => !text.includes("409"));
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a render of a path is cancelled, and the page stays usable"() {
    const page = await withPath(100, 24);
    await page.fill("#path-name", `${stamp}-long`);
    await page.click("#path-render");
    await page.waitForFunction(() => window.luxel.path.render.status?.done >= 1);
    await set(page, { exposure: 1, fov: 41 });
    await page.click("#path-cancel");
    await page.waitForFunction(() => window.luxel.path.render.status?.state === "cancelled");
    assert.ok((await page.innerText("#path-render-text")).startsWith("cancelled"));
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a path is played at its speed, and opened again from its file"() {
    const page = await withPath(2, 24);
    await page.click("#path-play");
    const start = performance.now();
    await page.waitForFunction(() => window.luxel.path.playing === null);
    assert.ok(performance.now() - start > 1800, "too fast");
    assert.ok(Math.abs((await page.evaluate(() => window.luxel.path.playhead)) - 2) < 1e-6);
    const before = await page.evaluate(() => window.luxel.path.path);
    const content = await downloaded(page, "#path-save");
    await page.click("#path-clear");
    await page.waitForFunction(() => document.getElementById("timeline").hidden);
    await page.setInputFiles("#path-file", { name: "shot.json", mimeType: "application/json", buffer: content });
    await page.waitForFunction(() => window.luxel.path.frames.length === 48);
    assert.deepEqual(await page.evaluate(() => window.luxel.path.path), before);
    // The keyframe in the end is moved in time by keys, and stays within the path.
    await page.locator("#keyframes button").nth(1).press("ArrowLeft");
    assert.ok(Math.abs((await page.evaluate(() => window.luxel.path.path.keyframes[1].time)) - (2 - 2 / 47)) < 0.03);
    await page.setInputFiles("#path-file", { name: "bad.json", mimeType: "application/json", buffer: Buffer.from("{}") });
    await page.waitForFunction(() => document.getElementById("path-text").textContent.includes("not a camera file"));
    // Frames that are made afterwards leave the message there.
    await fill(page, "#path-fps", 12);
    await page.waitForFunction(() => window.luxel.path.frames.length === 24 && window.luxel.path.makeAt === 0);
    assert.ok((await page.innerText("#path-text")).includes("not a camera file"));
    await page.close();
  },

  async "a light probe placed by a click is that of luxel probe"() {
    const page = await open(at);
    await page.keyboard.press("o");
    await page.evaluate(() => (document.getElementById("environment-width").value = "512"));
    const box = await page.locator("#picture").boundingBox();
    await page.mouse.click(box.x + box.width * 0.55, box.y + box.height * 0.6);
    await page.waitForFunction(() => window.luxel.environment.frame, null, { timeout: 120000 });
    assert.equal(await page.locator("#pins li").count(), 0);
    await page.waitForTimeout(300);
    await shot(page, "light-probe");
    const place = await page.evaluate(() => window.luxel.environment.at);
    const expected = path.join(work, "probe.exr");
    program("probe", run, `--at=${place.join(",")}`, "--size", "512", "--device", "cpu", "-o", expected);
    assert.ok((await downloaded(page, "#environment-exr")).equals(readFileSync(expected)), "probe.exr");
    await page.fill("#environment-name", stamp);
    await page.click("#environment-save");
    await page.waitForFunction(() => document.getElementById("environment-text").textContent.startsWith("saved"));
    assert.ok(readFileSync(path.join(run, "probes", `${stamp}.exr`)).equals(readFileSync(expected)));
    await page.click("#environment-save");
    await page.waitForFunction(() => document.getElementById("environment-text").textContent.includes("exists already"));
    await page.locator("#environment-map").hover();
    assert.ok((await page.innerText("#environment-value")).includes("luminance"));
    await page.click("#environment-close");
    assert.ok(await page.locator("#environment").isHidden());
    await page.close();
  },

  async "a large light probe shows how far it is, and is given up"() {
    const page = await open(at);
    await page.keyboard.press("o");
    await page.evaluate(() => (document.getElementById("environment-width").value = "4096"));
    const box = await page.locator("#picture").boundingBox();
    await page.mouse.click(box.x + box.width * 0.55, box.y + box.height * 0.6);
    await page.waitForFunction(() => document.getElementById("environment-progress").value > 0 && document.getElementById("environment-progress").max > 6, null, { timeout: 120000 });
    assert.match(await page.innerText("#environment-text"), /rendering, \d+ of \d+ views/);
    const query = await page.evaluate(() => window.luxel.environment.query());
    await shot(page, "light-probe-progress");
    // Pictures come meanwhile.
    await set(page, { exposure: 1, fov: 41 });
    assert.equal(await page.evaluate(() => window.luxel.environment.frame), null);
    await page.click("#environment-cancel");
    await page.waitForFunction(() => document.getElementById("environment-text").textContent.startsWith("cancelled"));
    await page.locator("#environment-progress-row").waitFor({ state: "hidden" });
    // The server gives it up, too.
    await page.waitForFunction(async (query) => (await (await fetch(`/api/environment/progress?${query}`)).json()).total === 0, query);
    await page.selectOption("#environment-width", "512");
    await page.waitForFunction(() => window.luxel.environment.frame, null, { timeout: 120000 });
    assert.equal(await page.evaluate(() => window.luxel.environment.frame.head.width), 512);
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a PNG is what the screen shows, and twice as large on request"() {
    const page = await open(`${at}&curve=aces`);
    const png = pixelsOf(await downloaded(page, "#save-png"));
    const { width, height } = await page.evaluate(() => window.luxel.dots);
    assert.deepEqual([png.width, png.height, png.bits], [width, height, 8]);
    await page.evaluate(() => window.luxel.display.draw(window.luxel.state, false));
    const places = [[0.31, 0.42], [0.5, 0.5], [0.77, 0.61]];
    const seen = await page.evaluate((places) => {
      const { canvas, display, state } = window.luxel;
      display.draw(state, false);
      return places.map(([u, v]) => {
        const pixel = new Uint8Array(4);
        display.gl.readPixels(Math.floor(u * canvas.width), canvas.height - 1 - Math.floor(v * canvas.height), 1, 1, display.gl.RGBA, display.gl.UNSIGNED_BYTE, pixel);
        return [...pixel.slice(0, 3)];
      });
    }, places);
    places.forEach(([u, v], i) => assert.deepEqual(png.at(Math.floor(u * width), Math.floor(v * height)), seen[i]));
    await page.selectOption("#still-size", "2");
    const twice = pixelsOf(await downloaded(page, "#save-png"));
    assert.deepEqual([twice.width, twice.height], [2 * width, 2 * height]);
    const hdr = pixelsOf(await downloaded(page, "#save-hdr"));
    assert.deepEqual([hdr.width, hdr.height, hdr.bits], [2 * width, 2 * height, 16]);
    await page.close();
  },
};
