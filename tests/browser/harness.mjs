// What the browser tests share: a server of the program, a Chromium, and pages of the viewer in it.

import { execFileSync, spawn } from "node:child_process";
import { createRequire } from "node:module";
import { mkdirSync, readFileSync } from "node:fs";
import path from "node:path";
import assert from "node:assert/strict";

const require = createRequire(path.join(process.env.NODE_PATH ?? process.cwd(), "x.js"));
const { chromium } = require("playwright-core");
export const [luxel, run, pictures] = process.argv.slice(2);
if (pictures) mkdirSync(pictures, { recursive: true });

/** How long a page may take to reach a state: much longer than on an idle machine. */
const PATIENCE_MS = 90_000;

// Each server of a test is ended with this process.
process.setMaxListeners(100);

/** Starts a viewer; resolves with its address. */
export function serve(listen = "127.0.0.1:0", path = run, ...options) {
  const child = spawn(luxel, ["view", path, ...options, "--listen", listen, "--no-browser", "--quiet"], { stdio: ["ignore", "pipe", "inherit"] });
  const url = new Promise((resolve, reject) => {
    let text = "";
    child.stdout.on("data", (data) => {
      text += data;
      const line = text.match(/http:\S+/);
      if (line) resolve(line[0]);
    });
    child.on("exit", (code) => reject(new Error(`luxel view ended with ${code}`)));
  });
  // Not left behind by tests that end early.
  process.on("exit", () => child.kill());
  return { child, url };
}

export const executablePath = process.env.CHROMIUM ?? execFileSync("sh", ["-c", "command -v chromium || command -v chromium-browser || command -v google-chrome"], { encoding: "utf8" }).trim();
export const browser = await chromium.launch({ executablePath, args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
export const server = serve();
export const url = await server.url;
export const scene = await (await fetch(`${url}api/scene`)).json();

/** A page that waits patiently, keeps its failures, and has the files of PAGE. */
export async function newPage(browser, options) {
  const page = await browser.newPage(options);
  page.failures = [];
  page.setDefaultTimeout(PATIENCE_MS);
  page.on("pageerror", (error) => page.failures.push(String(error)));
  page.on("console", (message) => message.type() === "error" && page.failures.push(message.text()));
  if (process.env.PAGE) await page.route("**/page/**", (route) => route.fulfill({ path: path.join(process.env.PAGE, new URL(route.request().url()).pathname.replace("/page/", "")) }));
  return page;
}

/** Opens the page, and waits for a full picture. */
export async function open(hash = "", options = {}) {
  const { prepare, ...rest } = options;
  const page = await newPage(browser, { viewport: { width: 1280, height: 720 }, ...rest });
  prepare?.(page);
  // The place of the middle of a pixel.
  await page.addInitScript(() => {
    window.centre = (x, y) => {
      const { width, height } = window.luxel.shown.frame.head;
      return [((x % width) + 0.5) / width, ((y % height) + 0.5) / height];
    };
  });
  if (process.env.PAGE) {
    const text = readFileSync(path.join(process.env.PAGE, "index.html"), "utf8").replaceAll("{{title}}", scene.name);
    await page.route((address) => address.pathname === "/", (route) => route.fulfill({ contentType: "text/html", body: text }));
  }
  await page.goto((options.at ?? url) + hash);
  await settled(page);
  return page;
}

/** Waits until the full picture of what is wanted is shown and drawn. */
export async function settled(page) {
  await page.waitForFunction(() => window.luxel?.shown?.full && window.luxel.stream.restedKey === window.luxel.want().key, null, { timeout: PATIENCE_MS });
  await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
}

/** Colours of places of the picture (0 to 1) as they are on the canvas. */
export const colors = (page, places) =>
  page.evaluate((places) => {
    const { canvas, display } = window.luxel;
    const gl = display.gl;
    // What was drawn before is gone once it is on the screen.
    window.luxel.draw(performance.now());
    return places.map(([u, v]) => {
      const pixel = new Uint8Array(4);
      gl.readPixels(Math.floor(u * canvas.width), canvas.height - 1 - Math.floor(v * canvas.height), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      return [...pixel.slice(0, 3)];
    });
  }, places);

export const shot = async (page, name) => pictures && page.screenshot({ path: path.join(pictures, `${name}.png`), timeout: 60000 });
export const set = async (page, change) => {
  await page.evaluate((change) => window.luxel.set(change), change);
  await settled(page);
};
export const decode = (code) => (code / 255 <= 0.04045 ? code / 255 / 12.92 : ((code / 255 + 0.055) / 1.055) ** 2.4);
export const near = (found, expected, tolerance, what) => assert.ok(Math.abs(found - expected) <= tolerance, `${what}: ${found}, expected ${expected} within ${tolerance}`);

export const camera = scene.cameras.find((view) => view.split === "test") ?? scene.cameras[0];
export const at = `#view=${encodeURIComponent(camera.name)}`;

