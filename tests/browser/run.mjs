// Drives the viewer in a real Chromium, and checks that what it shows is what the scene holds.
//
//     node tests/browser/run.mjs LUXEL RUN [SCREENSHOTS]
//
// LUXEL is the program, RUN a run folder of it. playwright-core is found through NODE_PATH, Chromium
// through CHROMIUM or PATH. scripts/browser-tests prepares all of them. Each file of cases/ exports
// its tests by name. A test that fails is run once more, since a busy machine can be too slow for it;
// the first failure is printed in any case, and the last line counts such tests. For work on the page: ONLY is a part of the name of the tests to run, PAGE a
// folder whose files take the place of the program's.

import { readdirSync } from "node:fs";
import { browser, server, shot } from "./harness.mjs";

const only = process.env.ONLY ?? "";
const files = readdirSync(new URL("cases/", import.meta.url)).filter((name) => name.endsWith(".mjs")).sort();
const tests = Object.assign({}, ...(await Promise.all(files.map((name) => import(`./cases/${name}`)))).map((file) => file.default));

/** Runs a test; returns whether it passed. */
async function passes(name, test) {
  const start = performance.now();
  try {
    await test();
    console.log(`ok ${name} (${((performance.now() - start) / 1000).toFixed(1)} s)`);
    return true;
  } catch (error) {
    console.log(`FAILED ${name}\n${error.stack}`);
    for (const context of browser.contexts()) for (const page of context.pages()) {
      console.log(page.failures);
      await shot(page, "failed").catch(() => undefined);
      await page.close();
    }
    return false;
  }
}

let [failed, passed, again] = [0, 0, 0];
for (const [name, test] of Object.entries(tests)) {
  if (!name.includes(only)) continue;
  if (await passes(name, test)) passed++;
  else if (await passes(name, test)) again++;
  else failed++;
}
await browser.close();
server.child.kill();
const counts = [failed && `${failed} failed`, again && `${again} passed only at the second try`, `${passed} passed`];
console.log(counts.filter(Boolean).join(", "));
process.exit(failed ? 1 : 0);
