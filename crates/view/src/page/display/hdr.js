/**
 * Light above white on a screen of high dynamic range: a second canvas, by WebGPU, over the picture.
 * It shows radiance; false colour, depth, coverage and differences stay on the canvas below, whose
 * colours end at white anyway.
 */

import { byId } from "../dom/elements.js";
import { openGpu, USAGE } from "../gpu/device.js";
import { signed } from "../picture/pixels.js";
import { zebraStops } from "../picture/units.js";
import { CURVES } from "./choices.js";
import { HDR } from "./hdr-shader.js";

/** @typedef {import("../viewer/part.js").Part} Part */
/** @typedef {import("../scene/scene.js").Frame} Frame */
/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */
/** What a screen tells of its headroom, where a browser has it. @typedef {Screen & { highDynamicRangeHeadroom?: number }} HdrScreenFacts */

/** Headroom where the screen does not tell, stops: four times white. */
const USUAL_STOPS = 2;
/** Bytes of the uniform, see `Look` in hdr-shader.js. */
const LOOK_BYTES = 144;
/** Use of a canvas that may be copied from. */
const TEXTURE_USAGE = { COPY_SRC: 1, RENDER_ATTACHMENT: 16 };

/** @implements {Part} */
export class HdrScreen {
  canvas = Object.assign(document.createElement("canvas"), { id: "hdr", hidden: true });
  /** @type {GPUDevice | null} */ device = null;
  /** @type {GPUCanvasContext | null} */ context = null;
  /** @type {GPURenderPipeline | null} */ pipeline = null;
  /** @type {GPUBuffer | null} */ uniform = null;
  /** Pictures that were uploaded, and where. @type {{ [name: string]: { frame: Frame | null, buffer: GPUBuffer } }} */ uploads = {};
  isStarting = false;
  /** Whether this browser cannot do it. */ isUnable = false;

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    this.canvas.setAttribute("aria-hidden", "true");
    byId("picture").after(this.canvas);
    this.range = matchMedia("(dynamic-range: high)");
    this.range.addEventListener("change", () => viewer.changed());
    byId("hdr-on").addEventListener("change", () => viewer.set({ hdr: byId("hdr-on").checked }));
    byId("hdr-auto").addEventListener("change", () => viewer.set({ headroom: byId("hdr-auto").checked ? 0 : this.stops() }));
    byId("hdr-headroom").addEventListener("input", () => viewer.set({ headroom: byId("hdr-headroom").valueAsNumber }));
  }

  /** Headroom above white, stops. */
  stops() {
    return this.viewer.state.headroom || /** @type {HdrScreenFacts} */ (screen).highDynamicRangeHeadroom || USUAL_STOPS;
  }

  /** Whether the picture goes through this canvas now. */
  isOn() {
    const { state, comparison } = this.viewer;
    const isElsewhere = comparison?.isOn() && (state.compare === "difference" || state.compare === "beside" || comparison.kind() !== "truth");
    const isPicture = state.layer === "radiance" && !isElsewhere;
    // Colours of a display end at white.
    const isDisplay = this.viewer.scene?.is_display || state.curve === "ocio";
    return this.range.matches && state.hdr && isPicture && this.viewer.shown !== null && !isDisplay;
  }

  async start() {
    this.isStarting = true;
    try {
      const { device } = await openGpu();
      const context = /** @type {GPUCanvasContext | null} */ (this.canvas.getContext("webgpu"));
      if (!context) return this.giveUp();
      const { COPY_SRC, RENDER_ATTACHMENT } = TEXTURE_USAGE;
      context.configure({ device, format: "rgba16float", colorSpace: "srgb", toneMapping: { mode: "extended" }, alphaMode: "opaque", usage: COPY_SRC | RENDER_ATTACHMENT });
      // A browser that does not know the mode leaves it out.
      if (context.getConfiguration?.()?.toneMapping?.mode !== "extended") return this.giveUp();
      const module = device.createShaderModule({ label: "hdr", code: HDR });
      const fragment = { module, entryPoint: "shade", targets: [{ format: /** @type {const} */ ("rgba16float") }] };
      this.pipeline = await device.createRenderPipelineAsync({ label: "hdr", layout: "auto", vertex: { module, entryPoint: "corner" }, fragment });
      this.uniform = device.createBuffer({ label: "look", size: LOOK_BYTES, usage: USAGE.UNIFORM | USAGE.COPY_DST });
      this.uploads = {};
      [this.device, this.context] = [device, context];
      void device.lost.then(() => {
        this.device = null;
        this.isStarting = false;
        this.viewer.changed();
      });
      this.viewer.changed();
    } catch {
      this.giveUp();
    }
  }

  /** Without WebGPU the picture ends at white, as on any screen. */
  giveUp() {
    this.isUnable = true;
    this.viewer.changed();
  }

  /** The buffer with this picture's half floats. @param {string} name @param {GPUDevice} device @param {Frame | null} frame */
  upload(name, device, frame) {
    const known = this.uploads[name];
    if (known && known.frame === frame) return known.buffer;
    const bytes = Math.max(16, Math.ceil((frame?.rgb.byteLength ?? 0) / 4) * 4);
    let buffer = known?.buffer;
    if (!buffer || buffer.size < bytes) {
      buffer?.destroy();
      buffer = device.createBuffer({ label: name, size: bytes, usage: USAGE.STORAGE | USAGE.COPY_DST });
    }
    if (frame) {
      const { rgb } = frame;
      const whole = rgb.length & ~1;
      device.queue.writeBuffer(buffer, 0, /** @type {Uint16Array<ArrayBuffer>} */ (rgb), 0, whole);
      if (whole < rgb.length) device.queue.writeBuffer(buffer, 2 * whole, new Uint16Array([rgb[whole], 0]));
    }
    this.uploads[name] = { frame, buffer };
    return buffer;
  }

  draw() {
    const isOn = this.isOn();
    if (isOn && !this.device && !this.isStarting) void this.start();
    this.canvas.hidden = !isOn || !this.device;
    if (!this.canvas.hidden) this.render();
  }

  /** Draws the newest picture. */
  render() {
    const { device, context, pipeline, uniform, canvas, viewer } = this;
    const { shown, display } = viewer;
    if (!device || !context || !pipeline || !uniform || !shown) return;
    if (canvas.width !== viewer.canvas.width || canvas.height !== viewer.canvas.height) [canvas.width, canvas.height] = [viewer.canvas.width, viewer.canvas.height];
    const { left, top, width, height } = viewer.canvas.style;
    Object.assign(canvas.style, { left, top, width, height });
    const isComparing = viewer.comparison?.isOn() ?? false;
    const picture = this.upload("picture", device, shown.frame);
    const truth = this.upload("truth", device, isComparing ? display.truth : null);
    device.queue.writeBuffer(uniform, 0, this.look(shown, isComparing ? display.truth : null));
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginRenderPass({ colorAttachments: [{ view: context.getCurrentTexture().createView(), loadOp: "clear", storeOp: "store" }] });
    pass.setPipeline(pipeline);
    const entries = [uniform, picture, truth].map((buffer, binding) => ({ binding, resource: { buffer } }));
    pass.setBindGroup(0, device.createBindGroup({ layout: pipeline.getBindGroupLayout(0), entries }));
    pass.draw(3);
    pass.end();
    device.queue.submit([encoder.finish()]);
  }

  /** The uniform, in the order of `Look`. @param {import("../scene/stream.js").Shown} shown @param {Frame | null} truth */
  look({ frame, full }, truth) {
    const { state, scene, comparison, canvas } = this.viewer;
    const bytes = new DataView(new ArrayBuffer(LOOK_BYTES));
    let at = 0;
    const floats = (/** @type {number[]} */ ...values) => values.forEach((value) => bytes.setFloat32((at += 4) - 4, value, true));
    const numbers = (/** @type {number[]} */ ...values) => values.forEach((value) => bytes.setUint32((at += 4) - 4, value, true));
    for (const row of scene?.rec709_from_scene ?? []) floats(...row, 0);
    floats(...(scene?.luminance_weights ?? [0, 0, 0]), 0, ...zebraStops(this.viewer), canvas.width, canvas.height);
    numbers(frame.head.width, frame.head.height, truth?.head.width ?? 0, truth?.head.height ?? 0);
    floats(frame.head.scale, truth?.head.scale ?? 1, 2 ** state.exposure / (scene?.radiance_scale ?? 1), state.wipe);
    floats(2 ** this.stops(), Math.max(1, canvas.width / Math.max(1, canvas.clientWidth)));
    const isFlicker = truth && state.compare === "flicker" && comparison?.showsTruth(performance.now());
    numbers(CURVES.indexOf(state.curve), isFlicker ? 2 : truth && state.compare === "wipe" ? 1 : 0, state.zebra ? 1 : 0, full ? 0 : 1);
    return bytes.buffer;
  }

  reflect() {
    const { state } = this.viewer;
    byId("hdr-section").hidden = !this.range.matches || this.isUnable;
    byId("hdr-on").checked = state.hdr;
    byId("hdr-auto").checked = state.headroom === 0;
    byId("hdr-headroom").value = String(this.stops());
    byId("hdr-headroom-text").textContent = `${signed(this.stops(), 2)} stops`;
    for (const id of ["hdr-auto", "hdr-headroom"]) byId(id).disabled = !state.hdr;
  }
}
