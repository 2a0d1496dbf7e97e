// Training, live: the page follows the scene as it grows, and steers the training.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { existsSync, mkdtempSync, readdirSync, rmSync } from "node:fs";
import os from "node:os";
import path from "node:path";
import { browser, luxel, near, newPage, run, scene, settled, shot } from "../harness.mjs";

/** The cameras of the data set. */
const given = scene.cameras;

/** Starts a training with a viewer; resolves with its address once it serves. */
function train(output, ...more) {
  const options = ["train", path.join(run, "dataset"), "-o", output, "--iterations", "100000", "--device", "cpu", "--view", "127.0.0.1:0", ...more];
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

  async "the cameras of a training that refines poses are where it sees its views from"() {
    const folder = mkdtempSync(path.join(os.tmpdir(), "luxel-poses-"));
    const { child, url } = train(path.join(folder, "run"), "--refine-poses", "--pose-from", "1", "--pose-until", "90000");
    try {
      const address = await url;
      const byName = new Map(given.map((camera) => [camera.name, camera]));
      const page = await newPage(browser, { viewport: { width: 1280, height: 720 } });
      await page.goto(address);
      await page.waitForFunction(() => window.luxel?.shown?.full);
      const name = given.find(({ split }) => split === "train").name;
      await page.evaluate((name) => window.luxel.standAt(name), name);
      // The cameras move with the training, and whoever stands at one moves with it.
      await page.waitForFunction(() => window.luxel.version > 20);
      await page.getByRole("button", { name: "Pause", exact: true }).click();
      await page.waitForFunction(() => document.getElementById("training-text").textContent.includes("paused"));
      const poses = (cameras) => JSON.stringify(cameras.map((camera) => camera.transform_matrix));
      const final = poses(await (await fetch(`${address}api/cameras`)).json());
      await page.waitForFunction((final) => JSON.stringify(window.luxel.scene.cameras.map((camera) => camera.transform_matrix)) === final, final);
      await settled(page);
      const [cameras, eye, seen, view] = await page.evaluate(() => {
        const { scene, state, shown } = window.luxel;
        return [scene.cameras, state.eye, shown.lens.eye, state.view];
      });
      assert.equal(view, name);
      const eyeOf = ({ transform_matrix: rows }) => rows.slice(0, 3).map((row) => row[3]);
      const apart = (a, b) => Math.hypot(...eyeOf(a).map((value, c) => value - eyeOf(b)[c]));
      const here = cameras.find((camera) => camera.name === name);
      assert.deepEqual([eye, seen], [eyeOf(here), eyeOf(here)]);
      const size = Math.max(...given.map((camera) => apart(camera, given[0])));
      for (const camera of cameras) {
        const distance = apart(camera, byName.get(camera.name));
        // Of exact poses little is corrected; test views are seen from where they were.
        if (camera.split === "test") near(distance, 0, 1e-9 * size, camera.name);
        else assert.ok(distance > 1e-7 * size && distance < 0.1 * size, `${camera.name}: ${distance} of ${size}`);
      }
      // A picture of the view is one of that camera.
      const ask = async (query) => (await fetch(`${address}api/probe?${new URLSearchParams({ ...query, x: 20, y: 30 })}`)).json();
      const camera = JSON.stringify(here);
      const [ofView, ofCamera] = [await ask({ view: name }), await ask({ camera, width: here.w, height: here.h })];
      near(ofView.luminance, ofCamera.luminance, 1e-4 * ofCamera.luminance, "luminance");
      await shot(page, "training-poses");
      assert.deepEqual(page.failures, []);
      await page.close();
    } finally {
      child.kill("SIGKILL");
      rmSync(folder, { recursive: true, force: true });
    }
  },
};
