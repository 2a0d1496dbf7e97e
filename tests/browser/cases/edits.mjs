// Editing: the stack, selections, overlays, saving. What the page saves is what luxel edit writes.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { at, camera, luxel, near, open, run, scene, settled, shot, url } from "../harness.mjs";

const folder = path.join(run, "edits");
rmSync(folder, { recursive: true, force: true });
const work = mkdtempSync(path.join(tmpdir(), "luxel-edits-"));
const text = (page) => page.evaluate(() => window.luxel.state.edit);
const where = (page) => page.evaluate(() => window.edits.entries[window.edits.current]?.where);
/** Runs the command that the page shows, into another file. */
const runShown = async (page, name) => {
  const shown = await page.locator("#edit-text").innerText();
  const output = path.join(work, name);
  execFileSync("sh", ["-c", `${shown.replace(/^luxel /, `"${luxel}" `).replace(/-o \S+$/, `-o ${output}`)} --quiet`]);
  return readFileSync(output);
};
const save = async (page, name, button = "Save scene") => {
  await page.locator("#edit-name").fill(name);
  await page.getByRole("button", { name: button }).click();
  await page.waitForFunction(() => !["", "saving …"].includes(document.getElementById("edit-saved").textContent));
  return page.locator("#edit-saved").innerText();
};

export default {
  async "edits made by controls are those of luxel edit, with undo and redo"() {
    const page = await open(at);
    await page.locator("#edit-add").click();
    assert.equal(await text(page), "stops -1");
    await page.getByLabel("stops, stops, as a number").fill("-2.5");
    assert.equal(await text(page), "stops -2.5");
    await page.locator("#edit-add").click();
    await page.getByLabel("Add a map").selectOption("compress-above");
    assert.equal(await text(page), "stops -2.5; where all; stops -1; compress-above 1:4");
    await page.locator("#picture").focus();
    await page.keyboard.press("Control+z");
    assert.equal(await text(page), "stops -2.5; where all; stops -1");
    await page.keyboard.press("Control+z");
    await page.keyboard.press("Control+z");
    assert.equal(await text(page), "stops -1");
    await page.keyboard.press("Control+Shift+Z");
    await page.getByRole("button", { name: "Redo" }).click();
    await page.getByRole("button", { name: "Redo" }).click();
    assert.equal(await text(page), "stops -2.5; where all; stops -1; compress-above 1:4");
    await page.getByLabel("Edit 2 is on").uncheck();
    assert.equal(await text(page), "stops -2.5");
    await page.getByLabel("Edit 2 is on").check();
    await page.getByRole("button", { name: "Moves this edit up" }).last().click();
    assert.equal(await text(page), "stops -1; compress-above 1:4; where all; stops -2.5");
    await settled(page);
    await shot(page, "edit-stack");
    const said = await save(page, "controls");
    assert.ok(said.includes("controls.ply"), said);
    assert.deepEqual(readFileSync(path.join(folder, "controls.ply")), await runShown(page, "controls.ply"));
    execFileSync(luxel, ["edit", run, "--edits", path.join(folder, "controls.edits"), "-o", path.join(work, "file.ply"), "--quiet"]);
    assert.deepEqual(readFileSync(path.join(work, "file.ply")), readFileSync(path.join(folder, "controls.ply")));
    assert.ok((await save(page, "controls")).includes("exists already"));
    assert.deepEqual(page.failures.filter((failure) => !failure.includes("409")), []);
    await page.close();
  },

  async "values that were changed stay when more is added to the same edit"() {
    const page = await open(`${at}&edit=${encodeURIComponent("where L > 1 ~1 and L < 9 ~1; stops -1")}`);
    await page.getByLabel("stops, stops, as a number").fill("-2.5");
    await page.getByLabel("Soft edge of test 1").fill("2");
    await page.getByLabel("Soft edge of test 2").fill("3");
    await page.getByLabel("Add a map").selectOption("clamp-max");
    assert.equal(await text(page), "where L > 1 ~2 and L < 9 ~3; stops -2.5; clamp-max 1");
    await page.getByRole("button", { name: "Removes stops" }).click();
    assert.equal(await text(page), "where L > 1 ~2 and L < 9 ~3; clamp-max 1");
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a range is dragged on the histogram of the splats, and shown in orange"() {
    const page = await open(at);
    await page.locator("#edit-add").click();
    await page.waitForFunction(() => document.getElementById("splat-high").textContent);
    const box = await page.locator("#splat-histogram").boundingBox();
    await page.mouse.move(box.x + box.width * 0.6, box.y + 20);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width * 0.8, box.y + 20, { steps: 4 });
    await page.mouse.move(box.x + box.width + 5, box.y + 20, { steps: 4 });
    await page.mouse.up();
    assert.match(await where(page), /^L >= [\d.e+-]+ ~1$/);
    await page.locator("#show-selection").click();
    await page.waitForFunction(() => !document.getElementById("selection").hidden && document.getElementById("selection").complete);
    await page.waitForFunction(() => document.getElementById("selection-facts").textContent.includes("% of the light"));
    const query = new URLSearchParams({ edit: "", where: await where(page) });
    const facts = await (await fetch(`${url}api/edit/selection?${query}`)).json();
    assert.ok((await page.locator("#selection-facts").innerText()).startsWith(`${facts.count.toLocaleString("en")} of`));
    assert.ok(facts.count > 0 && facts.count < scene.splats);
    await shot(page, "edit-overlay");
    // The picture is that of luxel edit --overlay, for a camera of the data set.
    const frame = JSON.stringify({ transform_matrix: camera.transform_matrix, fl_x: camera.fl_x, fl_y: camera.fl_y, cx: camera.cx, cy: camera.cy });
    const png = await fetch(`${url}api/edit/overlay.png?${query}&${new URLSearchParams({ camera: frame, width: camera.w, height: camera.h })}`);
    execFileSync(luxel, ["edit", run, "--where", await where(page), "--dry-run", "--overlay", path.join(work, "overlay.png"), "--view", camera.name, "--device", "cpu", "--quiet"]);
    assert.deepEqual(Buffer.from(await png.arrayBuffer()), readFileSync(path.join(work, "overlay.png")));
    await page.close();
  },

  async "a sphere is moved and made larger by its handles"() {
    const page = await open(at);
    await page.locator("#edit-add").click();
    await page.locator("#pick-sphere").click();
    await settled(page);
    const before = (await where(page)).match(/sphere\(([^)]*)\)/)[1].split(",").map(Number);
    const box = await page.locator("#picture").boundingBox();
    const places = await page.evaluate(async ([x, y, z, r]) => {
      const { project } = await import("/page/math/lens.js");
      const lens = window.luxel.lens(window.luxel.box.width, window.luxel.box.height);
      return [project(lens, [x, y, z]), project(lens, [x + r, y, z])];
    }, before);
    const drag = async (from, dx, dy) => {
      await page.mouse.move(box.x + from.x, box.y + from.y);
      await page.mouse.down();
      await page.mouse.move(box.x + from.x + dx, box.y + from.y + dy, { steps: 6 });
      await page.mouse.up();
    };
    await shot(page, "edit-sphere");
    await drag(places[0], 40, -25);
    const moved = (await where(page)).match(/sphere\(([^)]*)\)/)[1].split(",").map(Number);
    const at2 = await page.evaluate(async ([x, y, z]) => (await import("/page/math/lens.js")).project(window.luxel.lens(window.luxel.box.width, window.luxel.box.height), [x, y, z]), moved);
    near(at2.x, places[0].x + 40, 0.6, "centre across");
    near(at2.y, places[0].y - 25, 0.6, "centre down");
    assert.equal(moved[3], before[3]);
    await page.getByRole("button", { name: "Undo" }).click();
    assert.deepEqual((await where(page)).match(/sphere\(([^)]*)\)/)[1].split(",").map(Number), before);
    await page.close();
  },

  async "what is painted with the brush is selected, and luxel edit reads the mask"() {
    const page = await open(at);
    await page.locator("#edit-add").click();
    await page.locator("#pick-brush").click();
    const box = await page.locator("#picture").boundingBox();
    await page.mouse.move(box.x + box.width * 0.4, box.y + box.height * 0.5);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width * 0.6, box.y + box.height * 0.5, { steps: 8 });
    await page.mouse.up();
    await page.waitForFunction(() => window.luxel.state.edit.includes("mask("));
    await settled(page);
    await shot(page, "edit-brush");
    // Paint is drawn where it is, and nothing is drawn elsewhere.
    const drawn = await page.evaluate(() => {
      const { canvas, context } = window.luxel.overlay;
      return [[0.5, 0.5], [0.2, 0.8]].map(([u, v]) => context.getImageData(Math.floor(u * canvas.width), Math.floor(v * canvas.height), 1, 1).data[3] > 0);
    });
    assert.deepEqual(drawn, [true, false]);
    const query = new URLSearchParams({ edit: "", where: await where(page) });
    const facts = await (await fetch(`${url}api/edit/selection?${query}`)).json();
    assert.ok(facts.count > 0 && facts.count < scene.splats / 2, JSON.stringify(facts));
    const said = await save(page, "painted");
    assert.ok(said.includes("painted.ply"), said);
    assert.deepEqual(readFileSync(path.join(folder, "painted.ply")), await runShown(page, "painted.ply"));
    execFileSync(luxel, ["edit", run, "--edits", path.join(folder, "painted.edits"), "-o", path.join(work, "painted-file.ply"), "--quiet"]);
    assert.deepEqual(readFileSync(path.join(folder, "painted.ply")), readFileSync(path.join(work, "painted-file.ply")));
    const edit = await text(page);
    await page.locator("#edit-clear").click();
    await page.locator("#edit-open").selectOption("painted");
    await page.waitForFunction(() => window.luxel.state.edit.includes("mask("));
    assert.equal((await text(page)).match(/mask-\d+/)[0], edit.match(/mask-\d+/)[0]);
    await page.close();
  },

  async "splats are deleted and the scene is levelled as luxel edit does"() {
    const page = await open(at);
    await page.locator("#edit-crop").click();
    await page.locator("#edit-floaters").click();
    await page.locator("#edit-axes").click();
    await page.locator("#pick-up").click();
    await settled(page);
    const edit = await text(page);
    assert.match(edit, /^delete not box\(.*\); floaters; up [-\d.,e]+$/);
    const said = await save(page, "level");
    assert.ok(said.includes("level.ply"), said);
    assert.deepEqual(readFileSync(path.join(folder, "level.ply")), await runShown(page, "level.ply"));
    assert.ok(existsSync(path.join(folder, "level.edits")));
    await shot(page, "edit-align");
    await page.close();
  },
};
