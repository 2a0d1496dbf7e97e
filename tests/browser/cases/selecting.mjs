// Selections made in the picture: lasso, hue, handles, floor and origin; files dropped on the page.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { at, camera, luxel, near, open, run, scene, set, settled, shot, url } from "../harness.mjs";
import { pixelsOf } from "../png.mjs";

const folder = path.join(run, "edits");
const stamp = `selecting-${process.pid}`;
const work = mkdtempSync(path.join(tmpdir(), "luxel-selecting-"));
process.on("exit", () => {
  rmSync(work, { recursive: true, force: true });
  for (const extension of ["ply", "edits"]) rmSync(path.join(folder, `${stamp}.${extension}`), { force: true });
});

const text = (page) => page.evaluate(() => window.luxel.state.edit);
const where = (page) => page.evaluate(() => window.edits.entries[window.edits.current]?.where);
const numbers = async (page, name) => (await where(page)).match(new RegExp(`${name}\\(([^)]*)\\)`))[1].split(",").map(Number);
const sampled = (page, places) => page.evaluate((places) => places.map(([u, v]) => window.luxel.sample(u, v)), places);
const facts = async (selection, edit = "") => (await fetch(`${url}api/edit/selection?${new URLSearchParams({ edit, where: selection })}`)).json();
/** Waits until the panel counts this selection. */
const counted = (page, { count }) => page.waitForFunction((text) => document.getElementById("selection-facts").textContent.startsWith(text), `${count.toLocaleString("en")} of`);

/** Places of points on the screen, from the corner of the picture. */
const projected = (page, points) =>
  page.evaluate(async (points) => {
    const { project } = await import("/page/math/lens.js");
    const lens = window.luxel.lens(window.luxel.box.width, window.luxel.box.height);
    return points.map((point) => project(lens, point));
  }, points);

/** Drags through places of the picture, pixels from its corner. */
async function drag(page, places, key = null) {
  const { x, y } = await page.locator("#picture").boundingBox();
  if (key) await page.keyboard.down(key);
  await page.mouse.move(x + places[0][0], y + places[0][1]);
  await page.mouse.down();
  for (const [px, py] of places.slice(1)) await page.mouse.move(x + px, y + py, { steps: 4 });
  await page.mouse.up();
  if (key) await page.keyboard.up(key);
}

/** The centre of a face of a box, low or high on an axis. */
const faceOf = (box, axis, side) => [0, 1, 2].map((k) => (k === axis ? box[k + 3 * side] : (box[k] + box[k + 3]) / 2));

/** A point of a file's splats, whose positions are the first three floats. */
function positionsOf(ply) {
  const end = ply.indexOf("end_header\n") + "end_header\n".length;
  const head = ply.toString("latin1", 0, end);
  const stride = 4 * head.match(/^property float /gm).length;
  const frame = JSON.parse(head.match(/^comment luxel local_frame (.*)$/m)?.[1] ?? '{"origin":[0,0,0],"unit":1}');
  return (i) => [0, 1, 2].map((c) => ply.readFloatLE(end + i * stride + 4 * c) * frame.unit + frame.origin[c]);
}

/** Solves for the shares of four points in a fifth. */
function shares(points, target) {
  const rows = [0, 1, 2].map((c) => [...points.map((point) => point[c]), target[c]]).concat([[1, 1, 1, 1, 1]]);
  for (let i = 0; i < 4; i++) {
    const best = rows.slice(i).reduce((most, row, k) => (Math.abs(row[i]) > Math.abs(rows[most][i]) ? i + k : most), i);
    [rows[i], rows[best]] = [rows[best], rows[i]];
    for (let k = 0; k < 4; k++) if (k !== i) rows[k] = rows[k].map((value, c) => value - (rows[k][i] / rows[i][i]) * rows[i][c]);
  }
  return rows.map((row, i) => row[4] / row[i]);
}

/** Drops a file on the page. */
const drop = (page, name, content) =>
  page.evaluate(([name, content]) => {
    const data = new DataTransfer();
    data.items.add(new File([content], name));
    for (const kind of ["dragover", "drop"]) document.getElementById("stage").dispatchEvent(new DragEvent(kind, { dataTransfer: data, bubbles: true, cancelable: true }));
  }, [name, content]);

export default {
  async "a lasso selects what is inside it, and with shift takes a part away"() {
    const page = await open(at);
    const { width, height } = await page.evaluate(() => window.luxel.box);
    const places = [[0.5, 0.55], [0.15, 0.2], [0.88, 0.85]];
    const before = await sampled(page, places);
    await page.locator("#edit-add").click();
    await page.locator("#pick-lasso").click();
    // A square, drawn without its last side.
    const corners = [[0.35, 0.4], [0.65, 0.4], [0.65, 0.7], [0.35, 0.7]].map(([u, v]) => [u * width, v * height]);
    await drag(page, corners);
    await page.waitForFunction(() => window.luxel.state.edit.includes("mask("));
    await settled(page);
    await shot(page, "edit-lasso");
    const maskOf = async () => {
      const name = (await where(page)).match(/(mask-\d+)\.png/)[1];
      const mask = pixelsOf(readFileSync(path.join(folder, `${name}.png`)));
      assert.deepEqual([mask.width, mask.height], [width, height]);
      return (u, v) => mask.all(Math.floor(u * width), Math.floor(v * height)).at(-1);
    };
    let mask = await maskOf();
    for (const [u, v] of [[0.36, 0.42], [0.5, 0.55], [0.64, 0.68], [0.64, 0.42], [0.36, 0.68]]) assert.equal(mask(u, v), 255, `inside, ${u} ${v}`);
    for (const [u, v] of [[0.34, 0.5], [0.66, 0.5], [0.5, 0.38], [0.5, 0.72], [0.02, 0.02]]) assert.equal(mask(u, v), 0, `outside, ${u} ${v}`);
    // What is inside has half of its light, what is far from it all.
    const after = await sampled(page, places);
    near(after[0].luminance / before[0].luminance, 0.5, 0.1, "inside");
    for (const i of [1, 2]) near(after[i].luminance / before[i].luminance, 1, 0.02, "outside");
    const whole = await facts(await where(page));
    await counted(page, whole);
    assert.ok(whole.count > 0 && whole.count < scene.splats / 2, JSON.stringify(whole));
    const first = await where(page);
    await drag(page, [[0.5, 0.3], [0.75, 0.3], [0.75, 0.8], [0.5, 0.8]].map(([u, v]) => [u * width, v * height]), "Shift");
    await page.waitForFunction((first) => window.edits.entries[window.edits.current].where !== first, first);
    mask = await maskOf();
    assert.deepEqual([mask(0.4, 0.55), mask(0.6, 0.55)], [255, 0]);
    const half = await facts(await where(page));
    await counted(page, half);
    assert.ok(half.count > 0 && half.count < whole.count, `${half.count} of ${whole.count}`);
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a click on a hue selects that hue"() {
    const page = await open(at);
    // The most colourful of some lit places whose neighbours have their hue: a click is a whole number of the window's pixels.
    const [u, v] = await page.evaluate(() => {
      const { scene, shown } = window.luxel;
      const { width, height } = shown.frame.head;
      const lightAt = (u, v) => scene.rec709_from_scene.map((row) => row.reduce((sum, weight, c) => sum + weight * window.luxel.sample(u, v).radiance[c], 0));
      const hueOf = ([r, g, b]) => (Math.atan2(Math.sqrt(3) * (g - b), 2 * r - g - b) * 180) / Math.PI;
      let best = { chroma: 0, place: [0.5, 0.5] };
      for (let y = 2; y < 39; y++) for (let x = 2; x < 39; x++) {
        const place = [(x + 0.5) / 41, (y + 0.5) / 41];
        const light = lightAt(...place);
        const chroma = (Math.max(...light) - Math.min(...light)) / (Math.max(...light) + 0.05 * scene.radiance_scale);
        const beside = [[-1, 0], [1, 0], [0, -1], [0, 1]].map(([dx, dy]) => hueOf(lightAt(place[0] + dx / width, place[1] + dy / height)));
        const isEven = beside.every((hue) => Math.abs((((hue - hueOf(light)) % 360) + 540) % 360 - 180) < 0.5);
        if (isEven && chroma > best.chroma) best = { chroma, place };
      }
      return best.place;
    });
    const [before] = await sampled(page, [[u, v]]);
    // A new entry takes a stop from everything until it selects a hue.
    await page.locator("#edit-add").click();
    await page.locator("#pick-hue").click();
    const { x, y, width, height } = await page.locator("#picture").boundingBox();
    await page.mouse.click(x + u * width, y + v * height);
    await page.waitForFunction(() => window.edits.entries[window.edits.current].where !== "all");
    // The hue of the hexagon, of what the server says is there.
    const lens = await page.evaluate(async () => (await import("/page/math/lens.js")).toJson(window.luxel.shown.lens));
    const size = await page.evaluate(() => window.luxel.shown.frame.head);
    const probe = await (await fetch(`${url}api/probe?${new URLSearchParams({ camera: lens, width: size.width, height: size.height, x: before.x, y: before.y })}`)).json();
    const [r, g, b] = scene.rec709_from_scene.map((row) => Math.max(0, row.reduce((sum, weight, c) => sum + weight * probe.radiance[c], 0)));
    const hue = (Math.atan2(Math.sqrt(3) * (g - b), 2 * r - g - b) * 180) / Math.PI;
    const found = (await where(page)).match(/^hue in (\d+)\.\.(\d+) ~20$/);
    assert.ok(found, await where(page));
    const [low, high] = found.slice(1).map(Number);
    assert.equal((high - low + 360) % 360, 40);
    // The angle of the circle differs from that of the hexagon by at most 1.2 degrees.
    const away = (((low + 20 - hue) % 360) + 540) % 360 - 180;
    near(away, 0, 2, "hue");
    await page.waitForFunction(() => window.luxel.state.edit.includes("hue"));
    await settled(page);
    const [after] = await sampled(page, [[u, v]]);
    assert.ok(after.luminance < 0.75 * before.luminance, `${after.luminance} of ${before.luminance}`);
    const selected = await facts(await where(page));
    await counted(page, selected);
    const report = JSON.parse(execFileSync(luxel, ["edit", run, "--where", await where(page), "--stops=-1", "--dry-run", "--json", "--device", "cpu", "--quiet"], { encoding: "utf8" }));
    assert.ok(JSON.stringify(report).includes(`${selected.count}`), JSON.stringify(report));
    assert.ok(selected.count > 0 && selected.count < scene.splats);
    await shot(page, "edit-hue");
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "a face of a box and the radius of a sphere follow their handles, and the picture with them"() {
    const page = await open(at);
    const grid = Array.from({ length: 1600 }, (_, i) => [((i % 40) + 0.5) / 40, (Math.floor(i / 40) + 0.5) / 40]);
    const light = async () => (await sampled(page, grid)).reduce((sum, { luminance }) => sum + luminance, 0);
    const plain = await light();
    await page.locator("#edit-add").click();
    await page.locator("#pick-box").click();
    const [pivot, size] = await page.evaluate(() => [window.luxel.state.pivot, window.luxel.controls.size]);
    // As the button makes it, but larger, so that even a coarse scene has splats in it.
    const offered = await numbers(page, "box");
    pivot.forEach((value, k) => [0, 3].forEach((side) => near(offered[k + side], value + (side ? 0.1 : -0.1) * size, 2e-3 * size, `number ${k + side} of the box`)));
    await page.locator("#edit").fill(`where box(${[...pivot.map((v) => v - size / 4), ...pivot.map((v) => v + size / 4)].map((v) => v.toPrecision(4)).join(",")}) ~${(size / 40).toPrecision(2)}; stops -2`);
    await page.waitForFunction(() => window.luxel.state.edit.includes("stops -2"));
    await settled(page);
    const boxed = await light();
    assert.ok(boxed < 0.999 * plain, `${boxed} of ${plain}`);
    const before = await numbers(page, "box");
    const first = await facts(await where(page));
    await counted(page, first);
    // The face that is farthest from the other handles on the screen.
    const faces = [0, 1, 2].flatMap((axis) => [0, 1].map((side) => ({ axis, side })));
    const centers = await projected(page, [...faces.map(({ axis, side }) => faceOf(before, axis, side)), [0, 1, 2].map((k) => (before[k] + before[k + 3]) / 2)]);
    const clear = centers.map((a, i) => Math.min(...centers.filter((_, k) => k !== i).map((b) => Math.hypot(a.x - b.x, a.y - b.y))));
    const best = faces.reduce((most, _, i) => (clear[i] > clear[most] ? i : most), 0);
    assert.ok(clear[best] > 25, `handles are ${clear[best]} pixels apart`);
    const { axis, side } = faces[best];
    const [start, middleOf] = [centers[best], centers.at(-1)];
    const out = [start.x - middleOf.x, start.y - middleOf.y].map((d) => d / Math.hypot(start.x - middleOf.x, start.y - middleOf.y));
    await shot(page, "edit-box");
    await drag(page, [[start.x, start.y], [start.x + 24 * out[0], start.y + 24 * out[1]]]);
    const larger = await numbers(page, "box");
    // One number changes, outwards, and the handle stays under the pointer.
    before.forEach((value, i) => (i === axis + 3 * side ? assert.ok((larger[i] - value) * (side ? 1 : -1) > 0) : assert.equal(larger[i], value)));
    const [moved] = await projected(page, [faceOf(larger, axis, side)]);
    near(Math.hypot(moved.x - start.x - 24 * out[0], moved.y - start.y - 24 * out[1]), 0, 5, "handle of the face");
    const second = await facts(await where(page));
    await counted(page, second);
    assert.ok(second.count > first.count && first.count > 0, `${second.count} after ${first.count}`);
    await settled(page);
    assert.ok((await light()) <= boxed, "the picture does not follow");
    // Dragged beyond the opposite face it stops there, and nothing is left of the box.
    await drag(page, [[moved.x, moved.y], [moved.x - 600 * out[0], moved.y - 600 * out[1]]]);
    await settled(page);
    const flat = await numbers(page, "box");
    near(flat[axis], flat[axis + 3], 1e-9, "a flat box");
    // Each drag is one step, however long it takes.
    await page.getByRole("button", { name: "Undo" }).click();
    await page.getByRole("button", { name: "Undo" }).click();
    assert.deepEqual(await numbers(page, "box"), before);

    await page.getByRole("button", { name: "Removes test 1" }).click();
    await page.locator("#pick-sphere").click();
    const ball = await numbers(page, "sphere");
    near(ball[3], 0.1 * size, 2e-3 * size, "radius of a new sphere");
    await page.locator("#edit").fill(`where sphere(${[...ball.slice(0, 3), (size / 4).toPrecision(4)].join(",")}) ~${(size / 40).toPrecision(2)}; stops -2`);
    await page.waitForFunction((radius) => window.edits.entries[window.edits.current].where.includes(radius), (size / 4).toPrecision(4));
    await settled(page);
    const inBall = await light();
    const sphere = await numbers(page, "sphere");
    const handle = [1, -1].flatMap((sign) => [0, 1, 2].map((k) => sphere.slice(0, 3).map((value, c) => value + (c === k ? sign * sphere[3] : 0))));
    const [center, ...sides] = await projected(page, [sphere.slice(0, 3), ...handle]);
    const away = sides.map(({ x, y }) => Math.hypot(x - center.x, y - center.y));
    const widest = sides[away.indexOf(Math.max(...away))];
    const factor = 1 + 30 / Math.max(...away);
    await drag(page, [[widest.x, widest.y], [center.x + factor * (widest.x - center.x), center.y + factor * (widest.y - center.y)]]);
    const grown = await numbers(page, "sphere");
    assert.deepEqual(grown.slice(0, 3), sphere.slice(0, 3));
    near(grown[3] / sphere[3], factor, 0.3 * (factor - 1), "radius");
    await settled(page);
    const [after] = await sampled(page, [[0.5, 0.5]]);
    const lens = await page.evaluate(async () => (await import("/page/math/lens.js")).toJson(window.luxel.shown.lens));
    const { width, height } = await page.evaluate(() => window.luxel.shown.frame.head);
    const probe = await (await fetch(`${url}api/probe?${new URLSearchParams({ camera: lens, width, height, x: after.x, y: after.y, edit: await text(page) })}`)).json();
    near(after.luminance, probe.luminance, 2e-3 * probe.luminance, "the picture under the sphere");
    assert.ok((await light()) <= inBall && inBall < plain, "the picture does not follow");
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "three points of the floor and an origin align the scene that is saved"() {
    const page = await open(`${at}&compare=wipe`);
    await page.locator("#edit-axes").click();
    await page.locator("#pick-floor").click();
    const { x, y, width, height } = await page.locator("#picture").boundingBox();
    const pixels = [[0.3, 0.8], [0.7, 0.78], [0.42, 0.66]].map(([u, v]) => [Math.floor(u * camera.w), Math.floor(v * camera.h)]);
    const points = [];
    for (const [px, py] of pixels) points.push((await (await fetch(`${url}api/probe?view=${encodeURIComponent(camera.name)}&x=${px}&y=${py}`)).json()).position);
    assert.ok(points.every(Boolean), "nothing at a place of the floor");
    for (const [i, [px, py]] of pixels.entries()) {
      await page.mouse.click(x + ((px + 0.5) / camera.w) * width, y + ((py + 0.5) / camera.h) * height);
      if (i < 2) await page.waitForFunction((count) => window.luxel.parts.some((part) => part.points?.length === count), i + 1);
    }
    await page.waitForFunction(() => window.luxel.state.edit.includes("origin"));
    const [, up, origin] = (await text(page)).match(/^up ([^;]*); origin (.*)$/).slice(0).map((part) => part.split(",").map(Number));
    const [a, b, c] = points;
    const [e, f] = [b.map((value, k) => value - a[k]), c.map((value, k) => value - a[k])];
    const normal = [0, 1, 2].map((k) => e[(k + 1) % 3] * f[(k + 2) % 3] - e[(k + 2) % 3] * f[(k + 1) % 3]);
    const sign = normal.reduce((sum, value, k) => sum + value * (camera.transform_matrix[k][3] - a[k]), 0) < 0 ? -1 : 1;
    up.forEach((value, k) => near(value, (sign * normal[k]) / Math.hypot(...normal), 1e-3, `up ${k}`));
    origin.forEach((value, k) => near(value, a[k], 1e-3 * (1 + Math.abs(a[k])), `origin ${k}`));
    await shot(page, "edit-floor");
    // Another origin takes its place.
    const first = await text(page);
    // A click finds a place once the picture with the edit, and its depth, is there.
    await settled(page);
    await page.locator("#pick-origin").click();
    await page.mouse.click(x + ((pixels[1][0] + 0.5) / camera.w) * width, y + ((pixels[1][1] + 0.5) / camera.h) * height);
    await page.waitForFunction((before) => window.luxel.state.edit !== before, first);
    await page.locator("#edit-name").fill(stamp);
    await page.locator("#save-scene").click();
    await page.waitForFunction(() => document.getElementById("edit-saved").textContent.includes(".ply"));
    // In the saved scene the floor is level, -Y is up, and the second point is the origin.
    const clouds = path.join(run, "point_cloud");
    const newest = readdirSync(clouds).sort((p, q) => Number(q.split("_").at(-1)) - Number(p.split("_").at(-1)))[0];
    const [old, now] = [path.join(clouds, newest, "point_cloud.ply"), path.join(folder, `${stamp}.ply`)].map((file) => positionsOf(readFileSync(file)));
    const chosen = [];
    for (let i = 0; i < scene.splats && chosen.length < 4; i += 97) if (chosen.every((k) => Math.hypot(...old(k).map((value, axis) => value - old(i)[axis])) > 0.2 * Math.hypot(...scene.inner_bounds[1].map((value, axis) => value - scene.inner_bounds[0][axis])))) chosen.push(i);
    const size = Math.hypot(...e);
    const placed = points.map((point) => {
      const parts = shares(chosen.map(old), point);
      return [0, 1, 2].map((k) => parts.reduce((sum, share, i) => sum + share * now(chosen[i])[k], 0));
    });
    placed[1].forEach((value, k) => near(value, 0, 2e-3 * size, `origin of the saved scene, ${k}`));
    placed.forEach((point, i) => near(point[1], 0, 2e-3 * size, `height of point ${i}`));
    near(Math.hypot(...placed[0]), size, 2e-3 * size, "a length");
    const lifted = shares(chosen.map(old), a.map((value, k) => value + size * up[k])).reduce((sum, share, i) => sum + share * now(chosen[i])[1], 0);
    near(lifted, -size, 5e-3 * size, "above the floor");
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "files that are dropped on the page are opened: edits and camera paths"() {
    const page = await open(at);
    await page.locator("#edit-add").click();
    await page.locator("#pick-brush").click();
    const { width, height } = await page.evaluate(() => window.luxel.box);
    await drag(page, [[0.4 * width, 0.5 * height], [0.6 * width, 0.5 * height]]);
    await page.waitForFunction(() => window.luxel.state.edit.includes("mask("));
    const painted = await text(page);
    await page.locator("#edit-name").fill(stamp);
    rmSync(path.join(folder, `${stamp}.edits`), { force: true });
    await page.locator("#save-edits").click();
    await page.waitForFunction(() => document.getElementById("edit-saved").textContent.includes(".edits"));
    await page.keyboard.press("Escape");
    await page.locator("#edit-clear").click();
    assert.equal(await text(page), "");
    // Masks of a file are beside it, in the folder of edits.
    await drop(page, `${stamp}.edits`, readFileSync(path.join(folder, `${stamp}.edits`), "utf8"));
    await page.waitForFunction(() => window.luxel.state.edit.includes("mask("));
    assert.equal(await text(page), painted);
    await settled(page);
    await drop(page, "fine.edits", "where L > 1 ~1;\nstops -2;\n");
    await page.waitForFunction(() => window.luxel.state.edit === "where L > 1 ~1; stops -2");
    assert.equal(await page.locator("#edit-name").inputValue(), "fine");
    assert.equal(await page.locator(".edit-card").count(), 1);
    await drop(page, "bad.edits", "shine 3");
    await page.waitForFunction(() => document.getElementById("edit-saved").textContent.startsWith("bad.edits:"));
    assert.equal(await text(page), "where L > 1 ~1; stops -2");
    const frame = { file_path: "a", transform_matrix: camera.transform_matrix, fl_x: camera.fl_x, fl_y: camera.fl_y, cx: camera.cx, cy: camera.cy, w: camera.w, h: camera.h };
    await drop(page, "shot.json", JSON.stringify({ frames: [frame, frame, frame] }));
    await page.waitForFunction(() => window.luxel.path.path.keyframes.length === 3 && window.luxel.path.frames.length > 0);
    await drop(page, "notes.txt", "nothing");
    await page.waitForFunction(() => document.getElementById("message").textContent.includes("notes.txt"));
    page.failures = page.failures.filter((failure) => !failure.includes("422") && !failure.includes("400"));
    assert.deepEqual(page.failures, []);
    await page.close();
  },

  async "luxel render and luxel edit take the stack that the page saved, and make what it shows"() {
    const page = await open(`${at}&compare=wipe&edit=${encodeURIComponent(`where L > p60 ~2 and not hue in 180..260 ~20; stops -1.5; where box(${scene.inner_bounds.flat().map((v) => v.toPrecision(5)).join(",")}) ~0.1; power 0.8; delete L < p2`)}`);
    for (const extension of ["ply", "edits"]) rmSync(path.join(folder, `${stamp}.${extension}`), { force: true });
    await page.locator("#edit-name").fill(stamp);
    await page.locator("#save-scene").click();
    await page.waitForFunction(() => document.getElementById("edit-saved").textContent.includes(".edits"));
    const file = path.join(folder, `${stamp}.edits`);
    execFileSync(luxel, ["edit", run, "--edits", file, "-o", path.join(work, "edited.ply"), "--overwrite", "--quiet"]);
    assert.ok(readFileSync(path.join(work, "edited.ply")).equals(readFileSync(path.join(folder, `${stamp}.ply`))), "luxel edit --edits");
    execFileSync(luxel, ["render", run, "--split", camera.split, "--edits", file, "--device", "cpu", "-o", path.join(work, "frames"), "--overwrite", "--quiet"]);
    const rendered = readdirSync(path.join(work, "frames"), { recursive: true }).filter((name) => name.endsWith(`${camera.name.split("/").at(-1)}.exr`));
    assert.equal(rendered.length, 1);
    const query = new URLSearchParams({ view: camera.name, edit: await text(page), channels: "rgb" });
    const shown = Buffer.from(await (await fetch(`${url}api/frame.exr?${query}`)).arrayBuffer());
    // Frames of files state what made them; the pixels are the same.
    writeFileSync(path.join(work, "shown.exr"), shown);
    const compared = execFileSync(luxel, ["compare", path.join(work, "frames", rendered[0]), path.join(work, "shown.exr"), "--json", "--quiet"], { encoding: "utf8" });
    assert.equal(JSON.parse(compared).mean.l1_scene, 0, "luxel render --edits");
    // The page shows the same edits.
    for (const [x, y] of [[20, 30], [Math.floor(camera.w / 2), Math.floor(camera.h / 2)]]) {
      const probe = await (await fetch(`${url}api/probe?${new URLSearchParams({ view: camera.name, x, y, edit: await text(page) })}`)).json();
      const [sample] = await sampled(page, [[(x + 0.5) / camera.w, (y + 0.5) / camera.h]]);
      near(sample.luminance, probe.luminance, 2e-3 * probe.luminance + 1e-6, `pixel ${x}, ${y}`);
    }
    await set(page, { edit: "" });
    assert.deepEqual(page.failures, []);
    await page.close();
  },
};
