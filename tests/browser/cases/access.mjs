// The page for everybody: contrast of text, the order of the keyboard's focus, many cameras.

import assert from "node:assert/strict";
import { cpSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { at, open, run, scene, serve, settled, shot } from "../harness.mjs";

/** Least contrast of text of this size, WCAG 2.1 level AA. */
const AA = 4.5;

export default {
  async "text has the contrast of WCAG AA on its ground, even where that lies over a white picture"() {
    const page = await open(`${at}&compare=wipe&layer=stops`);
    await page.locator("#edit-add").click();
    await page.evaluate(() => window.luxel.probes.pinAt(0.5, 0.5));
    await page.evaluate(() => window.luxel.messages.notice("what a message looks like"));
    await page.locator("#path-add").click();
    for (const folded of await page.locator(".folded h2 button").all()) await folded.click();
    const box = await page.locator("#picture").boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await settled(page);
    const look = (open) =>
      page.evaluate((open) => {
        if (open) document.getElementById("help").showModal();
        const parse = (text) => {
          const [r, g, b, a = 1] = text.match(/[\d.]+/g).map(Number);
          return [r, g, b, a];
        };
        const over = ([r, g, b, a], below) => [r, g, b].map((c, i) => c * a + below[i] * (1 - a));
        // Grounds from the innermost outwards; below all others may be a white picture.
        const ground = (element) => {
          const layers = [];
          for (let at = element; at; at = at.parentElement) {
            const color = parse(getComputedStyle(at).backgroundColor);
            if (at.id === "stage" || at.id === "strip") break;
            layers.unshift(color);
            if (color[3] === 1) break;
          }
          return layers.reduce((below, layer) => over(layer, below), [255, 255, 255]);
        };
        const light = (rgb) => {
          const [r, g, b] = rgb.map((c) => (c / 255 <= 0.04045 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4));
          return 0.2126 * r + 0.7152 * g + 0.0722 * b;
        };
        const found = [];
        const walker = document.createTreeWalker(open ? document.getElementById("help") : document.body, NodeFilter.SHOW_TEXT);
        while (walker.nextNode()) {
          const element = walker.currentNode.parentElement;
          const text = walker.currentNode.textContent.trim();
          if (!text || !element.checkVisibility() || element.closest("script, style, option, noscript, :disabled")) continue;
          const style = getComputedStyle(element);
          const below = ground(element);
          const [a, b] = [light(over(parse(style.color), below)), light(below)];
          found.push({ text: text.slice(0, 40), contrast: (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05) });
        }
        return found;
      }, open);
    for (const isOpen of [false, true]) {
      const found = await look(isOpen);
      assert.ok(found.length > 40, `${found.length} texts`);
      assert.deepEqual(found.filter(({ contrast }) => contrast < AA), []);
    }
    await page.close();
  },

  async "the focus goes through all controls in the order of the page, is seen, and is caught nowhere"() {
    // Nothing is clicked before: the focus would begin there.
    const page = await open(`${at}&edit=${encodeURIComponent("where L > 1 ~1; stops -1")}`);
    const expected = await page.evaluate(() => {
      const all = [...document.querySelectorAll("a[href], button, input, select, textarea, [tabindex]")];
      const usable = all.filter((element) => element.tabIndex >= 0 && !element.disabled && element.checkVisibility({ visibilityProperty: true }));
      usable.forEach((element, i) => (element.dataset.order = String(i)));
      return { count: usable.length, positive: all.filter((element) => element.tabIndex > 0).length };
    });
    assert.equal(expected.positive, 0);
    const order = [];
    const unseen = [];
    // A page that was never clicked has no place from which the first step goes.
    await page.evaluate(() => document.querySelector('[data-order="0"]').focus());
    for (let i = 0; i <= expected.count + 5; i++) {
      if (i) await page.keyboard.press("Tab");
      const now = await page.evaluate(() => {
        const element = document.activeElement;
        if (!element || element === document.body) return null;
        const { outlineStyle, outlineWidth } = getComputedStyle(element);
        const { top, bottom } = element.getBoundingClientRect();
        return { order: element.dataset.order, name: element.id || element.textContent.trim(), isSeen: outlineStyle !== "none" && parseFloat(outlineWidth) >= 1 && bottom > 0 && top < innerHeight };
      });
      if (!now) break;
      assert.ok(now.order !== undefined, `${now.name} was not expected`);
      if (order.at(-1) === Number(now.order)) continue;
      order.push(Number(now.order));
      if (i && !now.isSeen) unseen.push(now.name);
    }
    assert.deepEqual(unseen, []);
    assert.deepEqual(order, Array.from({ length: expected.count }, (_, i) => i));
    // Help takes the focus, and gives it back.
    await page.locator("#open-help").focus();
    await page.keyboard.press("Enter");
    assert.ok(await page.evaluate(() => document.getElementById("help").contains(document.activeElement)));
    await page.keyboard.press("Escape");
    assert.equal(await page.evaluate(() => document.activeElement.id), "open-help");
    await page.close();
  },

  async "of 300 cameras only the pictures that are near are loaded"() {
    const folder = mkdtempSync(path.join(tmpdir(), "luxel-many-"));
    cpSync(path.join(run, "dataset"), folder, { recursive: true });
    // The same photographs over and over, as other views.
    const whole = JSON.parse(readFileSync(path.join(folder, "transforms.json"), "utf8"));
    const frames = Array.from({ length: 300 }, (_, i) => ({ ...whole.frames[i % whole.frames.length], number: i }));
    const digits = (i) => String(i).padStart(3, "0");
    for (const [i, frame] of frames.entries()) {
      const extension = path.extname(frame.file_path);
      const copy = path.join("views", `${digits(i)}${extension}`);
      cpSync(path.join(folder, frame.file_path), path.join(folder, copy));
      Object.assign(frame, { file_path: copy });
      delete frame.number;
    }
    for (const name of ["transforms_train.json", "transforms_test.json", "split.json"]) rmSync(path.join(folder, name), { force: true });
    writeFileSync(path.join(folder, "transforms.json"), JSON.stringify({ ...whole, frames }));
    const many = serve("127.0.0.1:0", run, "--data", folder);
    try {
      const address = await many.url;
      const facts = await (await fetch(`${address}api/scene`)).json();
      assert.equal(facts.cameras.length, 300);
      const asked = new Set();
      const page = await open("", { at: address, prepare: (page) => page.on("request", (request) => request.url().includes("/api/thumbnail") && asked.add(request.url())) });
      assert.equal(await page.locator("#strip button").count(), 300);
      await page.waitForFunction(() => document.querySelector("#strip img").complete && document.querySelector("#strip img").naturalWidth > 0);
      assert.ok(asked.size > 3 && asked.size < 100, `${asked.size} thumbnails were asked for`);
      // The last camera is scrolled to, and its picture comes.
      await page.evaluate(() => window.luxel.standAtNext(-1));
      await page.waitForFunction(() => {
        const image = [...document.querySelectorAll("#strip img")].at(-1);
        const { left, right } = image.getBoundingClientRect();
        return image.naturalWidth > 0 && left >= 0 && right <= innerWidth + 1;
      });
      await settled(page);
      await shot(page, "many-cameras");
      assert.ok(asked.size < 200, `${asked.size} thumbnails were asked for`);
      assert.deepEqual(page.failures, []);
      await page.close();
    } finally {
      many.child.kill();
      rmSync(folder, { recursive: true, force: true });
    }
  },
};
