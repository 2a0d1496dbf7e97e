/** Starts the viewer: its core, and the parts that make it up. */

import { AperturePanel } from "./aperture.js";
import { Comparison } from "./comparison.js";
import { openDropped } from "./dropping.js";
import { Edits, SavedEdits } from "./edits.js";
import { Embedded, isAlone } from "./embedded.js";
import { EnvironmentPanel } from "./environment.js";
import { Exposure } from "./exposure.js";
import { foldSections } from "./folding.js";
import { Handles } from "./handles.js";
import { HdrScreen } from "./hdr.js";
import { Lights } from "./lights.js";
import { byId, ControlPanel } from "./panel.js";
import { Placed } from "./object/placed.js";
import { Proxy } from "./object/proxy.js";
import { OcioCurve } from "./ocio.js";
import { Optics } from "./optics.js";
import { PathPanel } from "./path.js";
import { Picking } from "./picking.js";
import { Poster, showPoster } from "./poster.js";
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
  const alone = sources ? null : new Embedded();
  const viewer = new Viewer(sources ?? /** @type {Embedded} */ (alone));
  viewer.parts.push(new ControlPanel(viewer), new Optics(viewer), new Strip(viewer), viewer.comparison = new Comparison(viewer), viewer.exposure = new Exposure(viewer));
  const edits = new Edits(viewer);
  // Tools take clicks before probes do.
  const saved = new SavedEdits(viewer, edits);
  if (sources) viewer.parts.push(edits, new Lights(edits), new Picking(viewer, edits), new Handles(viewer, edits), new Selected(viewer, edits), saved);
  viewer.parts.push(viewer.probes = new Probes(viewer), viewer.training = new TrainingPanel(viewer));
  viewer.parts.push(new HdrScreen(viewer));
  viewer.parts.push(viewer.radiometry = new Radiometry(viewer), new Shading(viewer));
  if (alone) viewer.parts.push(new Poster(viewer, alone));
  foldSections(byId("panel"), () => viewer.changed());
  viewer.saving = new Saving(viewer);
  if (sources) {
    const path = new PathPanel(viewer);
    viewer.parts.push(new RenderingPanel(viewer, sources), viewer.path = path);
    const placed = (viewer.placed = new Placed(viewer));
    openDropped(viewer, { json: (file) => path.open(file), edits: (file) => saved.read(file), glb: (file) => placed.open(file) });
    // Before the pins, which use clicks, too.
    viewer.parts.unshift(viewer.environment = new EnvironmentPanel(viewer), placed, new OcioCurve(viewer));
    viewer.parts.push((viewer.controls.proxy = new Proxy(viewer)));
    // Before the object, which it adds samples behind.
    viewer.parts.unshift((viewer.aperture = new AperturePanel(viewer)));
  }
  // For scripts in the console of the browser, and tests.
  Object.assign(window, { luxel: viewer, edits });
  void viewer.start();
} catch (error) {
  const message = byId("message");
  message.hidden = false;
  message.textContent = /** @type {Error} */ (error).message;
  if (isAlone()) showPoster(new Embedded().facts.poster);
}
