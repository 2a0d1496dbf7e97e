/** Starts the viewer: its core, and the parts that make it up. */

import { Comparison } from "./comparison.js";
import { Edits, SavedEdits } from "./edits.js";
import { Embedded, isAlone } from "./embedded.js";
import { EnvironmentPanel } from "./environment.js";
import { Exposure } from "./exposure.js";
import { foldSections } from "./folding.js";
import { Handles } from "./handles.js";
import { HdrScreen } from "./hdr.js";
import { byId, ControlPanel } from "./panel.js";
import { PathPanel } from "./path.js";
import { Picking } from "./picking.js";
import { Probes } from "./probes.js";
import { Radiometry } from "./radiometry.js";
import { RenderingPanel } from "./rendering.js";
import { Saving } from "./saving.js";
import { Selected } from "./selected.js";
import { Server } from "./server.js";
import { Shading } from "./shading.js";
import { Sources } from "./sources.js";
import { Strip } from "./strip.js";
import { TrainingPanel } from "./training.js";
import { Viewer } from "./viewer.js";

try {
  const sources = isAlone() ? null : new Sources(new Server());
  const viewer = new Viewer(sources ?? new Embedded());
  viewer.parts.push(new ControlPanel(viewer), new Strip(viewer), viewer.comparison = new Comparison(viewer), viewer.exposure = new Exposure(viewer));
  const edits = new Edits(viewer);
  // Tools take clicks before probes do.
  if (sources) viewer.parts.push(edits, new Picking(viewer, edits), new Handles(viewer, edits), new Selected(viewer, edits), new SavedEdits(viewer, edits));
  viewer.parts.push(viewer.probes = new Probes(viewer), viewer.training = new TrainingPanel(viewer));
  viewer.parts.push(new HdrScreen(viewer));
  viewer.parts.push(viewer.radiometry = new Radiometry(viewer), new Shading(viewer));
  foldSections(byId("panel"));
  viewer.saving = new Saving(viewer);
  if (sources) {
    viewer.parts.push(new RenderingPanel(viewer, sources), viewer.path = new PathPanel(viewer));
    // Before the pins, which use clicks, too.
    viewer.parts.unshift(viewer.environment = new EnvironmentPanel(viewer));
  }
  // For scripts in the console of the browser, and tests.
  Object.assign(window, { luxel: viewer, edits });
  void viewer.start();
} catch (error) {
  const message = byId("message");
  message.hidden = false;
  message.textContent = /** @type {Error} */ (error).message;
}
