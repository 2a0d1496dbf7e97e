// Rendering in the page itself, on the WebGPU of a Chromium that plays it on the processor: a small
// scene and small pictures, and a browser of its own, because WebGPU needs other flags.

import { execFileSync } from "node:child_process";
import { createRequire } from "node:module";
import { mkdtempSync, rmSync, statSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { pathToFileURL } from "node:url";
import assert from "node:assert/strict";
import { browser as plain, executablePath, luxel, near, run, serve, settled, shot } from "../harness.mjs";

const require = createRequire(path.join(process.env.NODE_PATH ?? process.cwd(), "x.js"));
const { chromium } = require("playwright-core");

/** Splats of the scene, and side of its pictures, pixels. */
const [SPLATS, SIDE] = [400, 64];
/** A canvas of WebGPU needs a compositor on the same software device. */
const FLAGS = ["--no-sandbox", "--enable-unsafe-webgpu", "--enable-features=Vulkan", "--use-vulkan=swiftshader", "--use-angle=swiftshader", "--ignore-gpu-blocklist"];

let started = null;
/** The scene, its viewer and the browser, made at first use. */
function small() {
  started ??= (async () => {
    const folder = mkdtempSync(path.join(tmpdir(), "luxel-local-"));
    const file = path.join(folder, "small.ply");
    execFileSync(luxel, ["export", run, "-o", file, "--max-splats", String(SPLATS), "--refine", "0", "--device", "cpu", "--quiet"], { stdio: "ignore" });
    const server = serve("127.0.0.1:0", file);
    process.on("exit", () => {
      server.child.kill();
      rmSync(folder, { recursive: true, force: true });
    });
    const browser = await chromium.launch({ executablePath, args: FLAGS });
    return { folder, file, server, url: await server.url, browser };
  })();
  return started;
}

/** Opens a page in which a picture has SIDE x SIDE pixels. */
async function open(url, browser, options = {}) {
  const page = await browser.newPage({ viewport: { width: SIDE, height: SIDE + 36 }, ...options });
  page.failures = [];
  page.on("pageerror", (error) => page.failures.push(String(error)));
  page.on("console", (message) => message.type() === "error" && page.failures.push(message.text()));
  if (process.env.PAGE) await page.route("**/page/**", (route) => route.fulfill({ path: path.join(process.env.PAGE, new URL(route.request().url()).pathname.replace("/page/", "")) }));
  await page.goto(url);
  return page;
}

const isLocal = (page) => page.waitForFunction(() => window.luxel?.source.isLocal, null, { timeout: 90000 });

/** A picture of the page's source of this kind: radiance, coverage and depth as numbers. */
const picture = (page, kind, edit = "") =>
  page.evaluate(async ([kind, edit, side]) => {
    const { source } = window.luxel;
    const frame = await (kind === "server" ? source.server : source).frame(window.luxel.lens(side, side), { edit, radiance: true, layers: true });
    const half = (bits) => {
      const exponent = (bits >> 10) & 31;
      return exponent === 0 ? (bits & 1023) * 2 ** -24 : (1 + (bits & 1023) / 1024) * 2 ** (exponent - 15);
    };
    return { rgb: Array.from(frame.rgb, (bits) => half(bits) * frame.head.scale), alpha: Array.from(frame.alpha, half), depth: Array.from(frame.depth, (z) => (z < 1e30 ? z : null)) };
  }, [kind, edit, SIDE]);

/** PSNR of two pictures under the mu-law, white at `scale`. */
function psnr(a, b, scale) {
  const tone = (value) => Math.log1p((5000 * Math.max(0, value)) / scale) / Math.log(5001);
  const squares = a.map((value, i) => (tone(value) - tone(b[i])) ** 2);
  return -10 * Math.log10(squares.reduce((sum, square) => sum + square, 0) / squares.length);
}

export default {
  async "the page renders by itself what the server renders"() {
    const { url, browser } = await small();
    const page = await open(`${url}#rendering=local`, browser);
    await isLocal(page);
    await settled(page);
    const scale = await page.evaluate(() => window.luxel.scene.radiance_scale);
    const [local, server] = [await picture(page, "local"), await picture(page, "server")];
    const db = psnr(local.rgb, server.rgb, scale);
    console.log(`   local against server: ${db.toFixed(1)} dB in mu-law`);
    assert.ok(db >= 80, `${db} dB`);
    assert.ok(Math.max(...server.rgb) > 0.1 * scale, "the picture is black");
    server.alpha.forEach((value, i) => near(local.alpha[i], value, 2e-3, `coverage of pixel ${i}`));
    server.depth.forEach((value, i) => value === null || server.alpha[i] < 0.01 || near(local.depth[i], value, 2e-3 * value, `depth of pixel ${i}`));
    // The value of a pixel, against the render itself.
    for (const [x, y] of [[10, 12], [32, 32], [50, 41], [20, 55]]) {
      const camera = await page.evaluate(async () => (await import("/page/lens.js")).toJson(window.luxel.lens(64, 64)));
      const probe = await (await fetch(`${url}api/probe?camera=${encodeURIComponent(camera)}&width=${SIDE}&height=${SIDE}&x=${x}&y=${y}`)).json();
      const sample = await page.evaluate(([u, v]) => window.luxel.sample(u, v), [(x + 0.5) / SIDE, (y + 0.5) / SIDE]);
      assert.deepEqual([sample.x, sample.y], [x, y]);
      probe.radiance.forEach((value, c) => near(sample.radiance[c], value, Math.abs(value) * 2e-3 + 1e-6 * scale, `radiance ${c} at ${x}, ${y}`));
      if (probe.position && probe.alpha > 0.01) probe.position.forEach((value, c) => near(sample.position[c], value, 2e-3 * probe.depth, `position ${c}`));
    }
    const edit = "where L > p50 ~1; gain 3";
    const [edited, expected] = [await picture(page, "local", edit), await picture(page, "server", edit)];
    assert.ok(psnr(edited.rgb, expected.rgb, scale) >= 80 && psnr(edited.rgb, local.rgb, scale) < 60, "the edit");
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a lost GPU goes back to the server, in words"() {
    const { url, browser } = await small();
    const page = await open(`${url}#rendering=local`, browser);
    await isLocal(page);
    await page.evaluate(() => window.luxel.source.lose("the browser's GPU was lost (a test)"));
    await page.waitForFunction(() => document.getElementById("message").textContent.includes("the server renders"));
    await settled(page);
    assert.equal(await page.evaluate(() => window.luxel.source.isLocal), false);
    await page.close();
  },

  async "without WebGPU the server renders, and the page says why"() {
    const { url } = await small();
    const page = await open(url, plain);
    await settled(page);
    await page.evaluate(() => window.luxel.set({ rendering: "local" }));
    await page.waitForFunction(() => /By the server: .*(no WebGPU|no GPU)/.test(document.getElementById("rendering-text").textContent));
    await page.close();
  },

  async "an exported page opens from disk and shows the same picture"() {
    const { folder, file, url, browser } = await small();
    const page = path.join(folder, "small.html");
    execFileSync(luxel, ["export", file, "-o", page, "--device", "cpu", "--quiet"], { stdio: "ignore" });
    const served = await open(`${url}#rendering=server`, browser);
    await settled(served);
    const expected = await picture(served, "server");
    const [scale, hash] = await served.evaluate(() => [window.luxel.scene.radiance_scale, location.hash]);
    await served.close();
    const alone = await open(pathToFileURL(page).href + hash, browser);
    await settled(alone);
    const found = await picture(alone, "local");
    const db = psnr(found.rgb, expected.rgb, scale);
    console.log(`   ${(statSync(page).size / 1e3).toFixed(0)} kB, from disk against the server: ${db.toFixed(1)} dB in mu-law`);
    assert.ok(db >= 80, `${db} dB`);
    assert.equal(await alone.title(), "small.ply");
    for (const id of ["edit-section", "rendering-section", "save-exr"]) assert.equal(await alone.evaluate((id) => getComputedStyle(document.getElementById(id)).display, id), "none", id);
    await alone.waitForFunction(() => location.hash.includes("eye="));
    assert.deepEqual(alone.failures, []);
    await alone.setViewportSize({ width: 640, height: 400 });
    await shot(alone, "exported");
    await alone.close();
    // Without WebGPU it says what is missing, and still has its facts.
    const without = await open(pathToFileURL(page).href, plain);
    await without.waitForFunction(() => /No picture: .*(WebGPU|GPU)/.test(document.getElementById("message").textContent));
    assert.ok((await without.locator("#facts").textContent()).includes(`${SPLATS} splats`));
    await without.close();
  },
};
