/** Starts the viewer: its core, and the parts that make it up. */

import { AperturePanel } from "./camera/aperture.js";
import { Optics } from "./camera/optics.js";
import { Strip } from "./camera/strip.js";
import { Exposure } from "./display/exposure.js";
import { HdrScreen } from "./display/hdr.js";
import { OcioCurve } from "./display/ocio.js";
import { byId } from "./dom/elements.js";
import { openDropped } from "./dom/files.js";
import { foldSections } from "./dom/folding.js";
import { Edits, SavedEdits } from "./edit/edits.js";
import { Handles } from "./edit/handles.js";
import { Lights } from "./edit/lights.js";
import { Picking } from "./edit/picking.js";
import { Selected } from "./edit/selected.js";
import { Comparison } from "./measure/comparison.js";
import { EnvironmentPanel } from "./measure/environment.js";
import { Probes } from "./measure/probes.js";
import { Radiometry } from "./measure/radiometry.js";
import { Placed } from "./object/placed.js";
import { Proxy } from "./object/proxy.js";
import { PathPanel } from "./path/path.js";
import { Embedded, isAlone } from "./scene/embedded.js";
import { Poster, showPoster } from "./scene/poster.js";
import { RenderingPanel } from "./scene/rendering.js";
import { Server } from "./scene/server.js";
import { Shading } from "./scene/shading.js";
import { Sources } from "./scene/sources.js";
import { TrainingPanel } from "./training/training.js";
import { ControlPanel } from "./viewer/panel.js";
import { Saving } from "./viewer/saving.js";
import { Viewer } from "./viewer/viewer.js";

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
