/** The browser's GPU: one device for the page, and in words why there is none. */

/** A device, its name, and whether a processor plays the GPU. @typedef {{ device: GPUDevice, name: string, isSoftware: boolean }} Gpu */

/** Uses of buffers, and the mode of mapping, as the specification of WebGPU numbers them. */
export const USAGE = { MAP_READ: 1, COPY_SRC: 4, COPY_DST: 8, UNIFORM: 64, STORAGE: 128, INDIRECT: 256 };
export const MAP_READ = 1;

/** @type {Promise<Gpu> | null} */
let opened = null;

/** Limits that scenes need more of than every adapter has. @type {readonly ("maxBufferSize" | "maxStorageBufferBindingSize")[]} */
const WANTED = ["maxBufferSize", "maxStorageBufferBindingSize"];

/** @returns {Promise<Gpu>} */
async function request() {
  const gpu = navigator.gpu;
  if (!gpu) {
    const reason = isSecureContext ? "Chrome and Edge 113, Safari 26 and Firefox 141 or newer have it on most systems" : "browsers offer it only to secure pages: those of HTTPS, and of an address of this machine";
    throw new Error(`this browser has no WebGPU: ${reason}`);
  }
  const adapter = await gpu.requestAdapter({ powerPreference: "high-performance" });
  if (!adapter) throw new Error("the browser offers no GPU to this page: its hardware acceleration is off (switch it on in the settings of the browser), or its driver is not supported (another browser or computer may do)");
  /** @type {{ [name: string]: number }} */
  const requiredLimits = {};
  for (const name of WANTED) requiredLimits[name] = adapter.limits[name];
  const device = await adapter.requestDevice({ requiredLimits });
  const { info } = adapter;
  const name = info.description || [info.vendor, info.architecture].filter(Boolean).join(" ") || "GPU";
  const isSoftware = info.isFallbackAdapter ?? /** @type {{ isFallbackAdapter?: boolean }} */ (/** @type {unknown} */ (adapter)).isFallbackAdapter ?? info.architecture === "swiftshader";
  void device.lost.then(() => (opened = null));
  return { device, name, isSoftware };
}

/** The device, opened at first use, and again after it was lost. @returns {Promise<Gpu>} */
export function openGpu() {
  opened ??= request();
  opened.catch(() => (opened = null));
  return opened;
}
