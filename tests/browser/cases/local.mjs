// Rendering in the page itself, on the WebGPU of a Chromium that plays it on the processor: a small
// scene and small pictures, and a browser of its own, because WebGPU needs other flags.

import { execFileSync } from "node:child_process";
import { createRequire } from "node:module";
import { mkdtempSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { pathToFileURL } from "node:url";
import assert from "node:assert/strict";
import { exrOf } from "../exr.mjs";
import { browser as plain, executablePath, luxel, near, newPage, run, serve, settled, shot } from "../harness.mjs";

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
    return { folder, file, server, url: await server.url, browser, model: "lcd" };
  })();
  return started;
}

let withHarmonics = null;
/** The same scene as spherical harmonics. */
function harmonics() {
  withHarmonics ??= (async () => {
    const { folder, file } = await small();
    const baked = path.join(folder, "harmonics.ply");
    execFileSync(luxel, ["export", file, "-o", baked, "--bake", "linear", "--device", "cpu", "--quiet"], { stdio: "ignore" });
    const server = serve("127.0.0.1:0", baked);
    process.on("exit", () => server.child.kill());
    return { url: await server.url, model: "harmonics" };
  })();
  return withHarmonics;
}

/** Opens a page in which a picture has SIDE x SIDE pixels; `prepare` takes it before it loads anything. */
async function open(url, browser, { prepare, ...options } = {}) {
  const page = await newPage(browser, { viewport: { width: SIDE, height: SIDE + 36 }, ...options });
  prepare?.(page);
  await page.goto(url);
  return page;
}

const isLocal = (page) => page.waitForFunction(() => window.luxel?.source.isLocal);

/** Opens a page, and waits for a picture that it renders by itself. */
async function openLocal(url, browser) {
  const page = await open(`${url}#rendering=local`, browser);
  await isLocal(page);
  await settled(page);
  return page;
}

const luminance = (page) => page.evaluate(() => window.luxel.sample(0.5, 0.5).luminance);
/** Waits until the page tells that the server renders again. */
const isGivenUp = (page) => page.waitForFunction(() => document.getElementById("message").textContent.includes("the server renders"));

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
    const page = await openLocal(url, browser);
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
      const camera = await page.evaluate(async () => (await import("/page/math/lens.js")).toJson(window.luxel.lens(64, 64)));
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

  async "edits reach the page as what they change, and leave it as they came"() {
    for (const { url, model } of [await small(), await harmonics()]) {
      const { browser } = await small();
      /** Queries by which the page asked for splats. @type {string[]} */ const asked = [];
      const page = await open(`${url}#rendering=local`, browser, { prepare: (page) => page.on("request", (request) => request.url().includes("/api/splats") && asked.push(new URL(request.url()).search)) });
      await isLocal(page);
      await settled(page);
      const scale = await page.evaluate(() => window.luxel.scene.radiance_scale);
      const plain = await picture(page, "local");
      const whole = await page.evaluate(() => window.luxel.source.local.bytes);
      for (const edit of ["where L > p50 ~1; gain 3", "delete L < p40", "where L < p50; stops 2; delete box(-0.5,-0.5,-0.5,0.5,0.5,0.5)", "where L > p20; power 0.7"]) {
        const [edited, expected] = [await picture(page, "local", edit), await picture(page, "server", edit)];
        const [db, change] = [psnr(edited.rgb, expected.rgb, scale), psnr(plain.rgb, expected.rgb, scale)];
        assert.ok(db >= 80 && change < 60, `${model}, ${edit}: ${db} dB, against the plain scene ${change}`);
        expected.alpha.forEach((value, i) => near(edited.alpha[i], value, 2e-3, `${edit}: coverage of pixel ${i}`));
        const bytes = await page.evaluate(() => window.luxel.source.local.changeBytes);
        console.log(`   ${model}, ${edit}: ${db.toFixed(1)} dB, ${bytes} of ${whole} bytes`);
        if (model === "lcd" || edit.startsWith("delete")) assert.ok(bytes < 0.15 * whole, `${bytes} of ${whole} bytes`);
      }
      // Without edits every pixel is what it was, and nothing more is downloaded.
      const count = asked.length;
      assert.deepEqual(await picture(page, "local"), plain);
      assert.equal(asked.length, count);
      assert.equal(asked.filter((query) => query === "").length, 1, "the scene came once");
      assert.deepEqual(page.failures, []);
      await page.close();
    }
  },

  async "a GPU that is really lost goes back to the server, and can be had again"() {
    const { url, browser } = await small();
    const page = await openLocal(url, browser);
    const before = await luminance(page);
    await page.evaluate(() => window.luxel.source.local.gpu.device.destroy());
    await isGivenUp(page);
    assert.equal(await page.evaluate(() => window.luxel.source.isLocal), false);
    // The next picture is the server's.
    await page.evaluate(() => window.luxel.controls.rotate(3, 0));
    await settled(page);
    await page.waitForFunction(() => document.getElementById("rendering-text").textContent.startsWith("By the server: the browser's GPU was lost"));
    await page.evaluate(() => window.luxel.controls.rotate(-3, 0));
    await settled(page);
    near(await luminance(page), before, 5e-3 * before, "the server's picture");
    await page.evaluate(() => window.luxel.set({ rendering: "server" }));
    await page.waitForFunction(() => window.luxel.source.rendering === "server");
    await page.evaluate(() => window.luxel.set({ rendering: "local" }));
    await isLocal(page);
    await settled(page);
    near(await luminance(page), before, 5e-3 * before, "the page's picture");
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a lost GPU goes back to the server, in words"() {
    const { url, browser } = await small();
    const page = await openLocal(url, browser);
    await page.evaluate(() => window.luxel.source.lose("the browser's GPU was lost (a test)"));
    await isGivenUp(page);
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
    for (const id of ["edit-section", "rendering-section", "save-hdr"]) assert.equal(await alone.evaluate((id) => getComputedStyle(document.getElementById(id)).display, id), "none", id);
    await alone.waitForFunction(() => location.hash.includes("eye="));
    assert.deepEqual(alone.failures, []);
    // It saves OpenEXR by itself: what it shows, and what the server saves of the same view.
    const [saved] = await Promise.all([alone.waitForEvent("download"), alone.evaluate(() => document.getElementById("save-exr").click())]);
    const exr = readFileSync(await saved.path());
    writeFileSync(path.join(folder, "view.exr"), exr);
    const view = exrOf(exr);
    assert.deepEqual([view.width, view.height, view.channels.map(({ name }) => name).join("")], [SIDE, SIDE, "ABGRZ"]);
    assert.equal(view.attributes.compression.content[0], 3);
    for (let i = 0; i < SIDE * SIDE; i++) {
      ["R", "G", "B"].forEach((name, c) => near(view.planes[name][i], found.rgb[3 * i + c], 1e-6 * found.rgb[3 * i + c], `${name} of pixel ${i}`));
      near(view.planes.A[i], found.alpha[i], 1e-6, `A of pixel ${i}`);
      near(view.planes.Z[i], found.depth[i] ?? 1e10, 1e-6 * (found.depth[i] ?? 1e10), `Z of pixel ${i}`);
    }
    const camera = await alone.evaluate(async () => (await import("luxel/math/lens.js")).toJson(window.luxel.lens(64, 64)));
    const served2 = exrOf(Buffer.from(await (await fetch(`${url}api/frame.exr?camera=${encodeURIComponent(camera)}&width=${SIDE}&height=${SIDE}&channels=rgb,alpha,depth`)).arrayBuffer()));
    assert.deepEqual([...view.attributes.chromaticities.content], [...served2.attributes.chromaticities.content]);
    const rgb = (file) => Array.from({ length: 3 * SIDE * SIDE }, (_, i) => file.planes["RGB"[i % 3]][Math.floor(i / 3)]);
    assert.ok(psnr(rgb(view), rgb(served2), scale) >= 80, "OpenEXR of the page and of the server");
    // Another program's reader takes it.
    const info = JSON.parse(execFileSync(luxel, ["info", path.join(folder, "view.exr"), "--json"], { encoding: "utf8" }));
    assert.ok(JSON.stringify(info).includes(`"width":${SIDE}`), JSON.stringify(info));
    await alone.setViewportSize({ width: 640, height: 400 });
    await shot(alone, "exported");
    await alone.close();
    // Without WebGPU it says what is missing, and still has its facts.
    const without = await open(pathToFileURL(page).href, plain);
    await without.waitForFunction(() => /No picture: .*(WebGPU|GPU)/.test(document.getElementById("message").textContent));
    assert.ok((await without.locator("#facts").textContent()).includes(`${SPLATS} splats`));
    const message = await without.locator("#message").textContent();
    assert.match(message, /Chrome and Edge 113|hardware acceleration/);
    assert.match(message, /A picture that was made with this file is shown instead/);
    await without.waitForFunction(() => !document.getElementById("poster").hidden && document.getElementById("poster").naturalWidth === 640);
    await without.setViewportSize({ width: 640, height: 400 });
    await shot(without, "exported-without-webgpu");
    await without.close();
  },

  async "a screen of high dynamic range gets light above white"() {
    const { url } = await small();
    const wide = await chromium.launch({ executablePath, args: [...FLAGS, "--force-color-profile=hdr10"] });
    const page = await open(`${url}#rendering=server&curve=none`, wide);
    await settled(page);
    const high = await page.evaluate(() => matchMedia("(dynamic-range: high)").matches);
    assert.ok(high, "the screen has no high dynamic range");
    await page.waitForFunction(() => !document.getElementById("hdr").hidden);
    // Exposed so that the brightest pixel is 32 times white.
    await page.evaluate(() => {
      const { shown, scene } = window.luxel;
      let peak = 0;
      for (let i = 0; i < 64 * 64; i++) peak = Math.max(peak, ...window.luxel.sample(((i % 64) + 0.5) / 64, (Math.floor(i / 64) + 0.5) / 64).radiance);
      window.luxel.set({ exposure: Math.log2((32 * scene.radiance_scale) / peak), headroom: 3 });
      return shown.full;
    });
    await settled(page);
    const codes = (change) =>
      page.evaluate(async (change) => {
        window.luxel.set(change);
        const part = window.luxel.parts.find((part) => part.canvas?.id === "hdr");
        const { canvas, context, device } = part;
        await new Promise(requestAnimationFrame);
        await new Promise(requestAnimationFrame);
        const row = Math.ceil((8 * canvas.width) / 256) * 256;
        const back = device.createBuffer({ size: row * canvas.height, usage: 1 | 8 });
        part.render();
        const encoder = device.createCommandEncoder();
        encoder.copyTextureToBuffer({ texture: context.getCurrentTexture() }, { buffer: back, bytesPerRow: row }, [canvas.width, canvas.height]);
        device.queue.submit([encoder.finish()]);
        await back.mapAsync(1);
        const halves = new Uint16Array(back.getMappedRange().slice(0));
        const half = (bits) => {
          const exponent = (bits >> 10) & 31;
          return exponent === 0 ? (bits & 1023) * 2 ** -24 : (1 + (bits & 1023) / 1024) * 2 ** (exponent - 15);
        };
        const found = [];
        for (let y = 0; y < canvas.height; y++) for (let x = 0; x < canvas.width; x++) found.push([0, 1, 2].map((c) => half(halves[(y * row) / 2 + 4 * x + c])));
        return { mode: context.getConfiguration().toneMapping.mode, size: [canvas.width, canvas.height], found };
      }, change);
    const radiance = await page.evaluate(() => {
      const { scene, state } = window.luxel;
      const gain = 2 ** state.exposure / scene.radiance_scale;
      const light = [];
      for (let i = 0; i < 64 * 64; i++) {
        const v = window.luxel.sample(((i % 64) + 0.5) / 64, (Math.floor(i / 64) + 0.5) / 64).radiance;
        light.push(scene.rec709_from_scene.map((row) => Math.max(0, row.reduce((sum, weight, c) => sum + weight * v[c], 0) * gain)));
      }
      return light;
    });
    const decode = (code) => (code <= 0.04045 ? code / 12.92 : ((code + 0.055) / 1.055) ** 2.4);
    const linear = await codes({ curve: "none" });
    assert.deepEqual([linear.mode, linear.size], ["extended", [64, 64]]);
    linear.found.forEach((code, i) => code.forEach((value, c) => near(decode(value), Math.min(8, radiance[i][c]), 4e-3 * Math.min(8, radiance[i][c]) + 1e-4, `pixel ${i}`)));
    assert.ok(linear.found.filter((code) => Math.max(...code) > 1.2).length > 10, "little above white");
    // With a curve nothing changes up to white, and all stays within the headroom.
    const curved = await codes({ curve: "agx" });
    const flat = await codes({ headroom: 1e-9 });
    let above = 0;
    curved.found.forEach((code, i) => {
      const bright = Math.max(...radiance[i]);
      if (bright < 0.999) code.forEach((value, c) => near(value, flat.found[i][c], 1e-3, `pixel ${i} below white`));
      if (bright > 2) above += code.every((value, c) => value >= flat.found[i][c]) ? 1 : -1e9;
      assert.ok(Math.max(...code.map(decode)) <= 8.01);
    });
    assert.ok(above > 10);
    // The compositor gets it: the picture on the screen is another one than without.
    await codes({ curve: "none", headroom: 3 });
    const box = { clip: { x: 0, y: 36, width: 64, height: 64 } };
    const extended = await page.screenshot(box);
    await page.evaluate(() => window.luxel.set({ hdr: false }));
    await page.waitForFunction(() => document.getElementById("hdr").hidden);
    let isOther = false;
    for (let i = 0; i < 50 && !isOther; i++) {
      await page.waitForTimeout(100);
      isOther = !extended.equals(await page.screenshot(box));
    }
    assert.ok(isOther, "the screen shows the same with and without");
    // What ends at white anyway is drawn below, where nothing is brighter than the white of paper.
    for (const layer of ["stops", "depth", "alpha", "normals"]) {
      await page.evaluate((layer) => window.luxel.set({ hdr: true, layer }), layer);
      await page.waitForFunction(() => document.getElementById("hdr").hidden);
      await settled(page);
      await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
      const plain = await page.evaluate(() => {
        window.luxel.draw(performance.now());
        const { canvas } = window.luxel;
        const pixels = new Uint8Array(4 * canvas.width * canvas.height);
        window.luxel.display.gl.readPixels(0, 0, canvas.width, canvas.height, window.luxel.display.gl.RGBA, window.luxel.display.gl.UNSIGNED_BYTE, pixels);
        return { space: window.luxel.display.gl.drawingBufferColorSpace, brightest: Math.max(...pixels) };
      });
      assert.ok(plain.space === "srgb" && plain.brightest > 0, layer);
    }
    assert.deepEqual(page.failures, []);
    await page.setViewportSize({ width: 1280, height: 720 });
    await page.evaluate(() => window.luxel.set({ layer: "radiance" }));
    await settled(page);
    await shot(page, "hdr");
    await wide.close();
  },
};
