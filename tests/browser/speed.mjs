// Measures the viewer's server over HTTP: time to the first picture, pictures a second, latency, time
// of the processor and memory.
//
//     node tests/browser/speed.mjs LUXEL RUN|SCENE

import { spawn } from "node:child_process";
import { readFileSync } from "node:fs";

const [luxel, subject] = process.argv.slice(2);
const start = performance.now();
const child = spawn(luxel, ["view", subject, "--listen", "127.0.0.1:0", "--no-browser", "-q"], { stdio: ["ignore", "pipe", "inherit"] });
const url = await new Promise((resolve) => child.stdout.on("data", (data) => resolve(String(data).match(/http:\S+/)?.[0])));
const addressAfter = performance.now() - start;
const scene = await (await fetch(`${url}api/scene`)).json();
const pose = scene.cameras[0]?.transform_matrix ?? [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];

/** Address of a picture whose camera sways. */
function address(turn, width, height, more) {
  const matrix = pose.map((row, i) => (i === 3 ? row : [...row.slice(0, 3), row[3] + 0.02 * Math.sin(turn + i)]));
  const camera = JSON.stringify({ transform_matrix: matrix, fl_x: 0.55 * width, fl_y: 0.55 * width });
  return `${url}api/frame?camera=${encodeURIComponent(camera)}&width=${width}&height=${height}${more}`;
}

await (await fetch(address(0, 1280, 720, ""))).arrayBuffer();
console.log(`${scene.splats} splats: address after ${addressAfter.toFixed(0)} ms, first picture after ${(performance.now() - start).toFixed(0)} ms`);

const residentMb = () => Number(readFileSync(`/proc/${child.pid}/status`, "utf8").match(/VmRSS:\s+(\d+)/)[1]) / 1024;
function processorMs() {
  const fields = readFileSync(`/proc/${child.pid}/stat`, "utf8").split(") ")[1].split(" ");
  return (Number(fields[11]) + Number(fields[12])) * 10;
}

async function measure(width, height, { more = "", seconds = 4, inFlight = 1 } = {}) {
  const [latencies, engine, end, before] = [[], [], performance.now() + 1000 * seconds, processorMs()];
  let turn = 0;
  const client = async () => {
    while (performance.now() < end) {
      const asked = performance.now();
      turn += 0.03;
      const response = await fetch(address(turn, width, height, more));
      await response.arrayBuffer();
      latencies.push(performance.now() - asked);
      engine.push(JSON.parse(response.headers.get("luxel-frame")).seconds * 1000);
    }
  };
  await Promise.all(Array.from({ length: inFlight }, client));
  const median = (values) => values.sort((a, b) => a - b)[values.length >> 1].toFixed(0);
  const count = latencies.length;
  console.log(
    `${width}x${height}${more}, ${inFlight} at a time: ${(count / seconds).toFixed(1)} a second, ${median(latencies)} ms from asking to having, ` +
      `engine ${median(engine)} ms, processor ${((processorMs() - before) / count).toFixed(0)} ms each, ${residentMb().toFixed(0)} MB`,
  );
}

await measure(640, 360, { inFlight: 2 });
await measure(640, 360);
await measure(1280, 720);
await measure(1280, 720, { more: "&channels=rgb,alpha,depth" });
await measure(640, 360, { inFlight: 2, seconds: 12 });
await measure(320, 180, { inFlight: 10 });
child.kill();
