// The page for everybody: contrast of text.

import assert from "node:assert/strict";
import { at, open, settled } from "../harness.mjs";

/** Least contrast of text of this size, WCAG 2.1 level AA. */
const AA = 4.5;

export default {
  async "text has the contrast of WCAG AA on its ground, even where that lies over a white picture"() {
    const page = await open(`${at}&compare=wipe&layer=stops`);
    await page.locator("#edit-add").click();
    await page.evaluate(() => window.luxel.probes.pinAt(0.5, 0.5));
    await page.evaluate(() => window.luxel.complain("what a message looks like"));
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
};
