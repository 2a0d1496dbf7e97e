/** Live plots of a training: one small canvas per quantity, its newest value in words. */

/** @typedef {{ iteration: number, loss: number, psnr_train: number | null, psnr_test: number | null, splats: number, iterations_per_second: number, elapsed_s: number }} Record */

/** @type {readonly { name: string, of: (record: Record) => number | null, log?: boolean, text: (v: number) => string }[]} */
const QUANTITIES = [
  { name: "loss", of: (r) => r.loss, log: true, text: (v) => v.toPrecision(3) },
  { name: "PSNR of training views, dB", of: (r) => r.psnr_train, text: (v) => v.toFixed(2) },
  { name: "splats", of: (r) => r.splats, text: (v) => v.toLocaleString("en") },
  { name: "steps a second", of: (r) => r.iterations_per_second, text: (v) => v.toFixed(1) },
];

/** @param {HTMLElement} element @param {Record[]} records */
export function drawPlots(element, records) {
  QUANTITIES.forEach((quantity, i) => {
    const canvas = /** @type {HTMLCanvasElement} */ (element.children[i] ?? element.appendChild(document.createElement("canvas")));
    const points = records.flatMap((r) => {
      const v = quantity.of(r);
      return v === null || !Number.isFinite(v) ? [] : [[r.iteration, quantity.log ? Math.log(Math.max(v, 1e-12)) : v, v]];
    });
    const dots = devicePixelRatio;
    const [width, height] = [canvas.clientWidth || 248, 58];
    [canvas.width, canvas.height] = [width * dots, height * dots];
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    context.scale(dots, dots);
    context.fillStyle = "#181818";
    context.fillRect(0, 0, width, height);
    context.font = "11px system-ui, sans-serif";
    const newest = points.at(-1);
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${quantity.name}: ${newest ? quantity.text(newest[2]) : "none yet"}`);
    if (newest && points.length > 1) {
      const [xs, ys] = [points.map((p) => p[0]), points.map((p) => p[1])];
      const [low, high] = [Math.min(...ys), Math.max(...ys)];
      const x = (/** @type {number} */ v) => 2 + ((v - xs[0]) / Math.max(1, xs[xs.length - 1] - xs[0])) * (width - 4);
      const y = (/** @type {number} */ v) => height - 4 - ((v - low) / Math.max(1e-12, high - low)) * (height - 24);
      context.strokeStyle = "#c8c8c8";
      context.beginPath();
      points.forEach((p, k) => (k ? context.lineTo(x(p[0]), y(p[1])) : context.moveTo(x(p[0]), y(p[1]))));
      context.stroke();
    }
    context.fillStyle = "#9a9a9a";
    context.fillText(quantity.name, 4, 12);
    context.fillStyle = "#eee";
    context.textAlign = "right";
    context.fillText(newest ? quantity.text(newest[2]) : "–", width - 4, 12);
  });
}
