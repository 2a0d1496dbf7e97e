// Training, live: the page follows the scene as it grows, and steers the training.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { existsSync, mkdtempSync, readdirSync, rmSync } from "node:fs";
import os from "node:os";
import path from "node:path";
import { browser, luxel, newPage, run, shot } from "../harness.mjs";

/** Starts a training with a viewer; resolves with its address once it serves. */
function train(output) {
  const options = ["train", path.join(run, "dataset"), "-o", output, "--iterations", "100000", "--device", "cpu", "--view", "127.0.0.1:0"];
  const child = spawn(luxel, options, { stdio: ["ignore", "ignore", "pipe"] });
  let text = "";
  const url = new Promise((resolve, reject) => {
    child.stderr.on("data", (data) => {
      text += data;
      const line = text.match(/http:\S+/);
      if (line) resolve(line[0]);
    });
    child.on("exit", (code) => reject(new Error(`luxel train ended with ${code}: ${text}`)));
  });
  // Handled where the address is waited for.
  url.catch(() => undefined);
  return { child, url, ended: new Promise((resolve) => child.on("exit", resolve)) };
}

export default {
  async "a training is followed and steered"() {
    const folder = mkdtempSync(path.join(os.tmpdir(), "luxel-live-"));
    const output = path.join(folder, "run");
    const { child, url, ended } = train(output);
    try {
      const page = await newPage(browser, { viewport: { width: 1280, height: 720 } });
      await page.goto(await url);
      await page.waitForFunction(() => window.luxel?.shown?.full);
      const seen = () => page.evaluate(() => ({ version: window.luxel.shown.frame.head.version, text: document.getElementById("training-text").textContent }));
      const first = await seen();
      // The picture follows, and the plots have lines.
      await page.waitForFunction((version) => window.luxel.shown.frame.head.version > version, first.version);
      await page.waitForFunction(() => window.luxel.training.history.length >= 2);
      const plots = await page.locator("#plots").innerText();
      assert.ok(await page.locator("#plots canvas, #plots svg").count(), plots);
      assert.match((await seen()).text, /step [\d,]+ of 100,000 · [\d,]+ splats · training/);
      await shot(page, "training");

      await page.getByRole("button", { name: "Pause", exact: true }).click();
      await page.waitForFunction(() => document.getElementById("training-text").textContent.includes("paused"));
      const paused = (await seen()).text;
      await page.waitForTimeout(700);
      assert.equal((await seen()).text, paused);
      // A paused scene can be looked at.
      await page.evaluate(() => window.luxel.standAtNext(1));
      await page.waitForFunction(() => window.luxel.shown?.full && window.luxel.stream.fullKey === window.luxel.want().key);
      await page.getByRole("button", { name: "Continue", exact: true }).click();
      await page.waitForFunction((text) => document.getElementById("training-text").textContent !== text && document.getElementById("training-text").textContent.includes("training"), paused, { timeout: 90000 });

      const checkpoints = () => (existsSync(path.join(output, "checkpoints")) ? readdirSync(path.join(output, "checkpoints")).length : 0);
      const before = checkpoints();
      await page.locator("#training").getByRole("button", { name: "Save", exact: true }).click();
      await page.waitForFunction(() => document.getElementById("message").textContent.startsWith("A checkpoint is written"));
      for (let i = 0; i < 600 && checkpoints() === before; i++) await page.waitForTimeout(100);
      assert.ok(checkpoints() > before, "no checkpoint was written");
      await page.getByRole("button", { name: "Stop", exact: true }).click();
      assert.equal(typeof (await ended), "number");
      await page.waitForFunction(() => /^(The training has ended|No connection)/.test(document.getElementById("message").textContent));
      assert.deepEqual(page.failures.filter((failure) => !failure.includes("ERR_")), []);
      await page.close();
    } finally {
      child.kill("SIGKILL");
      rmSync(folder, { recursive: true, force: true });
    }
  },
};
