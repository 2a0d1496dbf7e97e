// Looking: pictures, exposure, false colour, comparison, probes, keys.

import assert from "node:assert/strict";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { at, browser, camera, colors, decode, near, newPage, open, scene, serve, set, settled, shot, url } from "../harness.mjs";

export default {
  async "the page opens with the scene's name, and a picture arrives"() {
    const page = await open();
    assert.equal(await page.title(), scene.name);
    assert.equal(await page.locator("canvas#picture").count(), 1);
    const [color] = await colors(page, [[0.5, 0.5]]);
    assert.ok((await colors(page, [[0.3, 0.3], [0.6, 0.6], [0.5, 0.8]])).some((c) => c.some((v) => v > 5)), `black: ${color}`);
    await shot(page, "home");
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a value under the pointer is that of the render, to half precision"() {
    const page = await open(`${at}&compare=wipe`);
    for (const [x, y] of [[10, 20], [Math.floor(camera.w / 2), Math.floor(camera.h / 2)], [camera.w - 5, 40]]) {
      const probe = await (await fetch(`${url}api/probe?view=${encodeURIComponent(camera.name)}&x=${x}&y=${y}`)).json();
      const sample = await page.evaluate(([u, v]) => window.luxel.sample(u, v), [(x + 0.5) / camera.w, (y + 0.5) / camera.h]);
      assert.deepEqual([sample.x, sample.y], [x, y]);
      probe.radiance.forEach((value, c) => near(sample.radiance[c], value, Math.abs(value) * 2e-3 + 1e-6, `radiance ${c} at ${x}, ${y}`));
      if (probe.depth) near(sample.depth, probe.depth, probe.depth * 1e-5, "depth");
      if (probe.position) probe.position.forEach((value, c) => near(sample.position[c], value, 1e-4 * probe.depth, `position ${c}`));
    }
    const box = await page.locator("#picture").boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    const readout = await page.locator("#readout").innerText();
    for (const word of ["RGB", "luminance", "stops", "depth", "position"]) assert.ok(readout.includes(word), readout);
    await page.close();
  },

  async "colours of a display are shown as they are stored, until a curve is chosen"() {
    const folder = mkdtempSync(path.join(tmpdir(), "luxel-display-"));
    const code = [0.2, 0.5, 0.8];
    const names = ["x", "y", "z", ...[0, 1, 2].map((c) => `f_dc_${c}`), "opacity", ...[0, 1, 2].map((c) => `scale_${c}`), ...[0, 1, 2, 3].map((c) => `rot_${c}`)];
    const rows = [-0.2, 0, 0.2, 0.4].map((z) => [0, 0, z, ...code.map((c) => (c - 0.5) / 0.28209479177387814), 9, 0.5, 0.5, 0.5, 1, 0, 0, 0].join(" "));
    const head = ["ply", "format ascii 1.0", `element vertex ${rows.length}`, ...names.map((name) => `property float ${name}`), "end_header"];
    const file = path.join(folder, "plain.ply");
    writeFileSync(file, [...head, ...rows, ""].join("\n"));
    const display = serve("127.0.0.1:0", file);
    const page = await open("", { at: await display.url });
    assert.equal(await page.evaluate(() => window.luxel.state.curve), "none");
    const [stored] = await colors(page, [[0.5, 0.5]]);
    stored.forEach((found, c) => near(found, 255 * code[c], 3, `channel ${c}`));
    assert.match(await page.locator("#curve-text").innerText(), /shown as they are stored/);
    await page.waitForFunction(() => location.hash.includes("eye=") && !location.hash.includes("curve="));
    await set(page, { curve: "agx" });
    const [mapped] = await colors(page, [[0.5, 0.5]]);
    assert.ok(mapped.some((found, c) => Math.abs(found - stored[c]) > 10), `${mapped} as ${stored}`);
    await page.waitForFunction(() => location.hash.includes("curve=agx"));
    assert.deepEqual(page.failures, []);
    await page.close();
    display.child.kill();
    rmSync(folder, { recursive: true });
  },

  async "three stops more are eight times the light"() {
    const page = await open(`${at}&curve=none`);
    // Places that are dark enough to stay below white.
    const places = await page.evaluate(() => {
      const { scene } = window.luxel;
      const found = [];
      for (let i = 0; i < 4000 && found.length < 5; i++) {
        const [u, v] = window.centre(i * 37, i * 91);
        const sample = window.luxel.sample(u, v);
        const light = sample?.radiance.map((value) => value / scene.radiance_scale) ?? [0];
        if (Math.max(...light) < 0.11 && Math.min(...light) > 0.01) found.push([u, v]);
      }
      return found;
    });
    assert.ok(places.length >= 1, "no place is dark enough");
    const before = await colors(page, places);
    await set(page, { exposure: 3 });
    const after = await colors(page, places);
    before.forEach((color, i) => color.forEach((code, c) => near(decode(after[i][c]), 8 * decode(code), 8 * (decode(code + 1) - decode(code)) + 0.01, `place ${i} channel ${c}`)));
    await page.close();
  },

  async "the legend of false colour is right at five values"() {
    const page = await open(`${at}&layer=stops`);
    const found = await page.evaluate(() => {
      const { scene, state } = window.luxel;
      const byBand = new Map();
      for (let i = 0; i < 20000 && byBand.size < 9; i++) {
        const [u, v] = window.centre(i * 37, i * 91);
        const sample = window.luxel.sample(u, v);
        if (!sample) continue;
        const stops = Math.log2((sample.luminance * 2 ** state.exposure) / scene.radiance_scale / 0.18);
        const band = Math.round(Math.min(8, Math.max(-8, stops)));
        if (Math.abs(stops - band) < 0.3 || Math.abs(stops) > 8.1) byBand.set(band, [u, v]);
      }
      return [...byBand];
    });
    assert.ok(found.length >= 5, `${found.length} bands in the picture`);
    const seen = await colors(page, found.map(([, place]) => place));
    for (const [i, [band]] of found.entries()) {
      const swatch = await page.locator(`#legend [data-stops="${band}"] i`).evaluate((element) => getComputedStyle(element).backgroundColor);
      assert.equal(`rgb(${seen[i].join(", ")})`, swatch, `${band} stops`);
    }
    await shot(page, "false-colour");
    await page.close();
  },

  async "the wipe shows the ground truth on its side"() {
    const page = await open(`${at}&curve=none&compare=wipe&wipe=0.5`);
    await page.waitForFunction(() => window.luxel.comparison.isOn());
    await settled(page);
    const expected = await page.evaluate(() => {
      const { display, scene } = window.luxel;
      const { rgb, head } = display.truth;
      const half = (bits) => {
        const exponent = (bits >> 10) & 31;
        return exponent === 0 ? (bits & 1023) * 2 ** -24 : (1 + (bits & 1023) / 1024) * 2 ** (exponent - 15);
      };
      return [[0.2, 0.3], [0.4, 0.7], [0.1, 0.9]].map(([u, v]) => {
        const i = Math.floor(v * head.height) * head.width + Math.floor(u * head.width);
        return { place: [u, v], light: [0, 1, 2].map((c) => (half(rgb[3 * i + c]) * head.scale) / scene.radiance_scale) };
      });
    });
    const seen = await colors(page, expected.map(({ place }) => place));
    expected.forEach(({ light }, i) => light.forEach((value, c) => near(decode(seen[i][c]), Math.min(1, value), 0.01, `place ${i} channel ${c}`)));
    await shot(page, "wipe");
    for (const compare of ["difference", "flicker"]) {
      await set(page, { compare, curve: "agx" });
      await shot(page, compare);
    }
    await page.close();
  },

  async "keys and the mouse do what the page of help says"() {
    const page = await open();
    const state = () => page.evaluate(() => ({ ...window.luxel.state }));
    await page.locator("#picture").focus();
    await page.keyboard.press("+");
    assert.equal((await state()).exposure, 0.5);
    await page.keyboard.press("0");
    await page.keyboard.press("f");
    assert.equal((await state()).layer, "stops");
    await page.keyboard.press("f");
    await page.keyboard.press("z");
    await page.keyboard.press("t");
    const chosen = await state();
    assert.deepEqual([chosen.exposure, chosen.layer, chosen.zebra, chosen.curve], [0, "radiance", true, "none"]);
    await page.keyboard.press("n");
    assert.equal((await state()).view, scene.cameras[1].name);
    const eye = (await state()).eye;
    await page.keyboard.down("w");
    await page.waitForFunction((eye) => window.luxel.state.eye.some((value, i) => value !== eye[i]), eye);
    await page.keyboard.up("w");
    const moved = await state();
    assert.ok(moved.view === "" && moved.eye.some((v, i) => v !== eye[i]));
    const box = await page.locator("#picture").boundingBox();
    await page.mouse.move(box.x + 300, box.y + 200);
    await page.mouse.down();
    await page.mouse.move(box.x + 400, box.y + 220, { steps: 5 });
    await page.mouse.up();
    assert.ok((await state()).eye.some((v, i) => v !== moved.eye[i]));
    assert.equal(await page.evaluate(() => window.luxel.probes.pins.length), 0);
    await settled(page);
    for (const [x, y] of [[300, 300], [500, 350]]) await page.mouse.click(box.x + x, box.y + y, { delay: 20 });
    await page.waitForFunction(() => document.querySelectorAll("#pins li").length === 2);
    if (await page.evaluate(() => window.luxel.probes.apart() !== null)) {
      await page.getByRole("button", { name: "this is 1 m" }).click();
      await page.waitForFunction(() => document.getElementById("distance").innerText.includes("1.000 m"));
    }
    await shot(page, "probes");
    await page.keyboard.press("?");
    assert.ok(await page.locator("#help").isVisible());
    await shot(page, "help");
    await page.keyboard.press("Escape");
    // The address follows the last change after a while.
    const hash = await page.waitForFunction(() => window.luxel.saveAt === 0 && location.hash.includes("eye=") && location.hash);
    const again = await open(await hash.jsonValue());
    const [a, b] = [await state(), await again.evaluate(() => ({ ...window.luxel.state }))];
    assert.deepEqual([b.curve, b.zebra, b.exposure], [a.curve, a.zebra, a.exposure]);
    a.eye.forEach((v, i) => near(b.eye[i], v, 1e-5 * (1 + Math.abs(v)), "eye"));
    await again.close();
    await page.close();
  },

  async "an edit is shown as luxel render --edit would, and undone"() {
    const page = await open(`${at}&compare=wipe`);
    const middle = () => page.evaluate(() => window.luxel.sample(...window.centre(77, 99)));
    const before = await middle();
    await page.locator("#edit").fill("gain 0.5");
    await page.waitForFunction(() => window.luxel.state.edit === "gain 0.5");
    await settled(page);
    const probe = await (await fetch(`${url}api/probe?view=${encodeURIComponent(camera.name)}&x=${before.x}&y=${before.y}&edit=gain+0.5`)).json();
    const after = await middle();
    near(after.luminance, probe.luminance, 2e-3 * probe.luminance, "edited");
    near(after.luminance, before.luminance / 2, 0.01 * before.luminance, "halved");
    assert.ok((await page.locator("#edit-text").innerText()).startsWith("luxel edit "));
    await shot(page, "edit");
    await page.locator("#edit").fill("shine");
    await page.waitForFunction(() => !document.getElementById("message").hidden);
    await page.locator("#edit-clear").click();
    await settled(page);
    assert.equal((await middle()).luminance, before.luminance);
    assert.ok(await page.locator("#message").isHidden());
    await page.close();
  },

  async "controls have names"() {
    const page = await open();
    const unnamed = await page.evaluate(() =>
      [...document.querySelectorAll("button, input, select, canvas")]
        .filter((element) => !element.closest("[hidden], [aria-hidden]"))
        .filter((element) => !(element.getAttribute("aria-label") || element.textContent?.trim() || element.labels?.length))
        .map((element) => element.outerHTML),
    );
    assert.deepEqual(unnamed, []);
    await page.close();
  },

  async "every mode is shown"() {
    const page = await open(at);
    for (const [name, change] of Object.entries({
      zebra: { zebra: true, exposure: 2 }, depth: { zebra: false, exposure: 0, layer: "depth" }, coverage: { layer: "alpha" }, cameras: { layer: "radiance", showCameras: true },
    })) {
      await set(page, change);
      await shot(page, name);
    }
    await page.evaluate(() => window.luxel.controls.dolly(2.2));
    await settled(page);
    await shot(page, "cameras");
    assert.deepEqual(page.failures, []);
    await page.close();
    const phone = await open("", { viewport: { width: 390, height: 780 }, hasTouch: true, isMobile: true });
    await shot(phone, "phone");
    await phone.close();
  },

  async "the page finds the server again after it was killed"() {
    const second = serve();
    const address = await second.url;
    const page = await newPage(browser);
    await page.goto(address);
    await settled(page);
    second.child.kill("SIGKILL");
    await page.waitForFunction(() => !document.getElementById("message").hidden);
    const third = serve(new URL(address).host);
    await third.url;
    await page.waitForFunction(() => document.getElementById("message").hidden);
    await page.evaluate(() => window.luxel.standAtNext(1));
    await settled(page);
    third.child.kill();
    await page.close();
  },

  // Not a check: times depend on the machine. Printed for the notebook.
  async "movement, measured"() {
    const page = await open();
    const result = await page.evaluate(async () => {
      const { luxel } = window;
      const start = performance.now();
      const [frames, sizes, latencies] = [luxel.stream.frames, [], []];
      while (performance.now() - start < 5000) {
        luxel.controls.rotate(3, Math.sin(performance.now() / 400));
        await new Promise(requestAnimationFrame);
        sizes.push(luxel.shown.frame.head.height);
        latencies.push(luxel.stream.latency);
      }
      const seconds = (performance.now() - start) / 1000;
      const rate = (luxel.stream.frames - frames) / seconds;
      const rest = performance.now();
      while (!(luxel.shown.full && luxel.stream.fullKey === luxel.want().key)) await new Promise(requestAnimationFrame);
      const median = (values) => values.sort((a, b) => a - b)[Math.floor(values.length / 2)];
      return { rate, height: median(sizes), latency: median(latencies), stillAfter: performance.now() - rest, still: luxel.shown.frame.head, engine: luxel.shown.frame.head.seconds * 1000 };
    });
    console.log(`   moving: ${result.rate.toFixed(1)} pictures a second, ${result.height} rows, ${result.latency.toFixed(0)} ms from asking to seeing`);
    console.log(`   still: ${result.still.width}x${result.still.height} seen ${result.stillAfter.toFixed(0)} ms after rest, engine ${result.engine.toFixed(0)} ms`);
    await page.close();
  },
};
