// What comes late, or twice: clicks before the depth of a picture, messages one after the other, numbers
// of pictures that are not whole, the clock of the page.

import assert from "node:assert/strict";
import { at, near, open, run, serve, set, settled, shot } from "../harness.mjs";

/** Holds back coverage and depth, which follow a full picture; returns what lets them through. */
async function withoutDepth(page) {
  let release = () => undefined;
  const released = new Promise((resolve) => (release = resolve));
  const isDepth = (url) => url.pathname === "/api/frame" && url.searchParams.get("channels") === "alpha,depth";
  await page.route(isDepth, async (route) => {
    await released;
    // A request that was given up meanwhile has nobody to answer.
    await route.continue().catch(() => undefined);
  });
  await page.evaluate(() => window.luxel.controls.rotate(6, 2));
  await page.waitForFunction(() => {
    const { shown, stream } = window.luxel;
    return shown.full && !shown.frame.depth && stream.fullKey === window.luxel.want().key;
  });
  return async () => {
    release();
    await page.unroute(isDepth);
    await settled(page);
  };
}

export default {
  async "a word stands where the first picture will be"() {
    let word = Promise.resolve("");
    const prepare = (page) => {
      let release = () => undefined;
      const released = new Promise((resolve) => (release = resolve));
      const isFrame = ({ pathname }) => pathname === "/api/frame";
      void page.route(isFrame, async (route) => {
        await released;
        await route.continue().catch(() => undefined);
      });
      const waiting = page.locator("#waiting");
      word = waiting.waitFor({ state: "visible" }).then(() => waiting.textContent()).finally(() => release());
    };
    const page = await open(at, { prepare });
    assert.match(await word, /first picture/);
    assert.ok(await page.locator("#waiting").isHidden());
    await page.close();
  },

  async "clicks before the depth of a picture is there wait for it"() {
    const page = await open(at);
    const { x, y, width, height } = await page.locator("#picture").boundingBox();
    const click = (u, v) => page.mouse.click(x + u * width, y + v * height);
    const pins = () => page.evaluate(() => window.luxel.probes.pins);
    let release = await withoutDepth(page);
    await click(0.4, 0.6);
    assert.deepEqual([(await pins()).length, await page.evaluate(() => window.luxel.clicks.waiting.length)], [0, 1]);
    await release();
    await page.waitForFunction(() => window.luxel.probes.pins.length === 1);
    const [pin] = await pins();
    const sample = await page.evaluate(({ x, y }) => window.luxel.sample(...window.centre(x, y)), pin);
    assert.ok(pin.position && sample.position, "nothing was clicked");
    pin.position.forEach((value, c) => near(value, sample.position[c], 1e-6 * sample.depth, `position ${c}`));

    // The second of two clicks sets the pivot, and the first leaves no pin.
    release = await withoutDepth(page);
    const before = await page.evaluate(() => window.luxel.state.pivot);
    await page.mouse.dblclick(x + 0.6 * width, y + 0.7 * height);
    await release();
    await page.waitForFunction((before) => window.luxel.state.pivot.some((value, c) => value !== before[c]), before);
    assert.equal((await pins()).length, 1);
    await settled(page);

    // Tools wait as well: three points of the floor, here of the desk, which all views see.
    release = await withoutDepth(page);
    const desk = [[0.25, 0.6], [0.62, 0.52], [0.42, 0.42]];
    await page.locator("#edit-axes").click();
    await page.locator("#pick-floor").click();
    for (const [u, v] of desk) await click(u, v);
    assert.equal(await page.evaluate(() => window.luxel.state.edit), "");
    await release();
    const depths = await page.evaluate((desk) => desk.map(([u, v]) => window.luxel.sample(u, v).depth), desk);
    assert.ok(depths.every(Boolean), `nothing was clicked: depths ${depths}`);
    await page.waitForFunction(() => /^up .*; origin /.test(window.luxel.state.edit));
    await page.locator("#edit-clear").click();
    await settled(page);

    // A click into a picture that another takes the place of is told.
    release = await withoutDepth(page);
    await click(0.5, 0.5);
    await page.evaluate(() => window.luxel.controls.rotate(6, 0));
    await release();
    await page.waitForFunction(() => document.getElementById("message").textContent.includes("click again"));
    assert.equal((await pins()).length, 1);
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a picture that is wanted again, after another for a moment, comes whole and with its depth"() {
    const page = await open(at);
    const change = (edit) => page.evaluate((edit) => window.luxel.set({ edit }), edit);
    const depth = () => page.evaluate(() => Boolean(window.luxel.shown.frame.depth));
    // Given up between the picture and its depth.
    let release = await withoutDepth(page);
    await change("gain 0.5");
    await page.evaluate(() => new Promise(requestAnimationFrame));
    await change("");
    await release();
    assert.ok(await depth());
    // Given up while small pictures of the other were shown.
    for (let i = 0; i < 3; i++) {
      const seen = await page.evaluate(async () => {
        const { luxel } = window;
        luxel.set({ edit: "gain 0.5" });
        for (let k = 0; k < 200 && luxel.shown.full; k++) await new Promise(requestAnimationFrame);
        luxel.set({ edit: "" });
        return luxel.shown.full;
      });
      await settled(page);
      assert.ok(await depth(), `small before: ${!seen}`);
    }
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a message stays until what it is about is right again"() {
    const page = await open(at);
    const shown = () => page.evaluate(() => [document.getElementById("message").textContent, document.getElementById("message").hidden]);
    const say = (...steps) => page.evaluate((steps) => steps.forEach(([about, text]) => window.luxel.messages.set(about, text)), steps);
    await say(["picture", "no picture"], ["notice", "saved"]);
    assert.deepEqual(await shown(), ["saved", false]);
    await say(["connection", "lost"], ["notice", ""]);
    assert.deepEqual(await shown(), ["lost", false]);
    await say(["connection", ""]);
    assert.deepEqual(await shown(), ["no picture", false]);
    await say(["picture", ""]);
    assert.deepEqual(await shown(), ["", true]);
    // What the server refuses is shown until the text is right, and through notices.
    await page.locator("#edit").fill("shine");
    await page.waitForFunction(() => document.getElementById("message").textContent.includes("expected one of"));
    await page.evaluate(() => window.luxel.messages.notice("another matter"));
    await page.evaluate(() => window.luxel.messages.set("notice", ""));
    assert.match((await shown())[0], /expected one of/);
    await page.locator("#edit-clear").click();
    await page.waitForFunction(() => document.getElementById("message").hidden);
    await page.close();
  },

  async "numbers of errors are of whole pictures alone"() {
    const second = serve("127.0.0.1:0", run, "--with", run);
    try {
      const page = await open(`${at}&compare=difference`, { at: await second.url });
      const errors = () => page.evaluate(() => window.luxel.comparison.errorText());
      await page.waitForFunction(() => document.getElementById("error-text").textContent.startsWith("mean"));
      assert.match(await errors(), /^mean 0(\.0+)? stops/);
      // While the camera moves, and until both pictures are there, there is none.
      const seen = await page.evaluate(async () => {
        const { luxel } = window;
        const seen = [];
        for (let i = 0; i < 400 && seen.length < 3; i++) {
          luxel.controls.rotate(2, 0);
          await new Promise(requestAnimationFrame);
          if (!luxel.shown.full) seen.push(luxel.comparison.errorText());
        }
        return seen;
      });
      assert.deepEqual(seen, ["", "", ""]);
      await page.waitForFunction(() => window.luxel.comparison.isWhole() && document.getElementById("error-text").textContent.startsWith("mean 0"));
      assert.deepEqual(page.failures, []);
      await page.close();
    } finally {
      second.child.kill();
    }
  },

  async "the page has one clock, and its hint leaves the readout free"() {
    const page = await open(at);
    const { x, y, width, height } = await page.locator("#picture").boundingBox();
    await page.mouse.move(x + width / 2, y + height / 2);
    await page.locator("#readout").waitFor({ state: "visible" });
    const [hint, readout] = [await page.locator("#hint").boundingBox(), await page.locator("#readout").boundingBox()];
    assert.ok(hint.y + hint.height <= readout.y, `${JSON.stringify(hint)} over ${JSON.stringify(readout)}`);
    await shot(page, "hint");
    const beats = await page.evaluate(async () => {
      const { pace } = window.luxel;
      const { beat } = pace;
      let count = 0;
      pace.beat = (...times) => {
        count++;
        return beat(...times);
      };
      const refresh = () => new Promise(requestAnimationFrame);
      await refresh();
      count = 0;
      for (let i = 0; i < 20; i++) {
        for (let k = 0; k < 5; k++) pace.wake();
        await refresh();
      }
      pace.beat = beat;
      return count;
    });
    assert.ok(beats <= 21, `${beats} beats in 20 refreshes`);
    await set(page, {});
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a histogram in a section that was folded is drawn once the section opens"() {
    const page = await open(`${at}&edit=${encodeURIComponent("where L > 1 ~1; stops -1")}`);
    const heading = page.locator("#edit-section h2 button");
    await heading.click();
    await page.reload();
    await settled(page);
    assert.equal(await heading.getAttribute("aria-expanded"), "false");
    await heading.click();
    await page.waitForFunction(() => document.getElementById("splat-middle").textContent.includes("p50"));
    assert.deepEqual(page.failures, []);
    await page.close();
  },
};
