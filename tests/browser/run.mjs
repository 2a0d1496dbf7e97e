// Drives the viewer in a real Chromium, and checks that what it shows is what the scene holds.
//
//     node tests/browser/run.mjs LUXEL RUN [SCREENSHOTS]
//
// LUXEL is the program, RUN a run folder of it. playwright-core is found through NODE_PATH, Chromium
// through CHROMIUM or PATH. scripts/browser-tests prepares all of them. Each file of cases/ exports
// its tests by name. For work on the page: ONLY is a part of the name of the tests to run, PAGE a
// folder whose files take the place of the program's.

import { readdirSync } from "node:fs";
import { browser, server, shot } from "./harness.mjs";

const only = process.env.ONLY ?? "";
const files = readdirSync(new URL("cases/", import.meta.url)).filter((name) => name.endsWith(".mjs")).sort();
const tests = Object.assign({}, ...(await Promise.all(files.map((name) => import(`./cases/${name}`)))).map((file) => file.default));

let [failed, passed] = [0, 0];
for (const [name, test] of Object.entries(tests)) {
  if (!name.includes(only)) continue;
  const start = performance.now();
  try {
    await test();
    passed++;
    console.log(`ok ${name} (${((performance.now() - start) / 1000).toFixed(1)} s)`);
  } catch (error) {
    failed++;
    console.log(`FAILED ${name}\n${error.stack}`);
    for (const context of browser.contexts()) for (const page of context.pages()) {
      console.log(page.failures);
      await shot(page, "failed");
      await page.close();
    }
  }
}
await browser.close();
server.child.kill();
console.log(failed ? `${failed} failed` : `all ${passed} passed`);
process.exit(failed ? 1 : 0);
