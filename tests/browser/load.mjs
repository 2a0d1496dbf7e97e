// Puts load on the viewer's server, and measures what one quiet client notices of it: ten clients at
// once, clients that never read, malformed messages, and minutes of movement.
//
//     node tests/browser/load.mjs LUXEL RUN|SCENE [MESSAGES] [MINUTES]
//
// Fails if an answer is wrong or missing, or if memory grows. Times are printed, not judged.

import { spawn } from "node:child_process";
import { readFileSync } from "node:fs";
import net from "node:net";

const [luxel, subject, messages = "100000", minutes = "0"] = process.argv.slice(2);
const child = spawn(luxel, ["view", subject, "--listen", "127.0.0.1:0", "--no-browser", "-q"], { stdio: ["ignore", "pipe", "inherit"] });
const url = await new Promise((resolve) => child.stdout.on("data", (data) => resolve(String(data).match(/http:\S+/)?.[0])));
const { hostname, port, host } = new URL(url);
const scene = await (await fetch(`${url}api/scene`)).json();
const pose = scene.cameras[0]?.transform_matrix ?? [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];

let turn = 0;
/** Address of a picture whose camera sways. */
function address(width, height, viewer) {
  turn += 0.03;
  const matrix = pose.map((row, i) => (i === 3 ? row : [...row.slice(0, 3), row[3] + 0.02 * Math.sin(turn + i)]));
  const camera = JSON.stringify({ transform_matrix: matrix, fl_x: 0.55 * width, fl_y: 0.55 * width });
  return `${url}api/frame?camera=${encodeURIComponent(camera)}&width=${width}&height=${height}&viewer=${viewer}`;
}

const residentMb = () => Number(readFileSync(`/proc/${child.pid}/status`, "utf8").match(/VmRSS:\s+(\d+)/)[1]) / 1024;
const sorted = (values) => [...values].sort((a, b) => a - b);
const at = (values, part) => sorted(values)[Math.min(values.length - 1, Math.floor(part * values.length))] ?? NaN;
let faults = 0;
const wrong = (what) => {
  faults++;
  console.log(`WRONG: ${what}`);
};

/** One client that asks for pictures until `isOver`; returns the times from asking to having, ms. */
async function client(name, isOver, [width, height] = [640, 360]) {
  const times = [];
  while (!isOver()) {
    const asked = performance.now();
    const response = await fetch(address(width, height, name));
    const body = await response.arrayBuffer();
    if (response.status !== 200 || body.byteLength !== 6 * width * height) wrong(`${name}: ${response.status}, ${body.byteLength} bytes`);
    times.push(performance.now() - asked);
  }
  return times;
}
const report = (what, times) =>
  console.log(`${what}: ${times.length} pictures, ${at(times, 0.5).toFixed(0)} ms in the median, ${at(times, 0.99).toFixed(0)} ms at 99 %, ${Math.max(...times).toFixed(0)} ms at most; ${residentMb().toFixed(0)} MB`);
const lasting = (seconds) => {
  const end = performance.now() + 1000 * seconds;
  return () => performance.now() > end;
};

report("alone", await client("alone", lasting(5)));
const ten = await Promise.all(Array.from({ length: 10 }, (_, i) => client(`of ten ${i}`, lasting(10), [320, 180])));
report("ten clients at 320x180", ten.flat());
console.log(`   each: ${ten.map((times) => times.length).join(" ")} pictures`);

// Clients that ask for large pictures and never take them.
const stalled = Array.from({ length: 20 }, () => {
  const socket = net.connect(Number(port), hostname);
  socket.on("error", () => undefined);
  socket.write(`GET ${address(2000, 1500, "").slice(url.length - 1)} HTTP/1.1\r\nHost: ${host}\r\n\r\n`);
  socket.pause();
  return socket;
});
report("beside 20 clients that never read", await client("quiet", lasting(10)));
for (const socket of stalled) socket.destroy();
await new Promise((resolve) => setTimeout(resolve, 1000));

/** A message that is wrong in one of many ways. */
function malformed(i) {
  const noise = Array.from({ length: 1 + (i * 7919) % 300 }, (_, k) => String.fromCharCode((i * 31 + k * 17) % 256)).join("");
  const kinds = [
    () => noise,
    () => "GET",
    () => "GET / HTTP/9\r\n\r\n",
    () => `GET /${"a".repeat(1 << (i % 17))} HTTP/1.1\r\nHost: ${host}\r\n\r\n`,
    () => `POST /api/training/${noise} HTTP/1.1\r\nHost: ${host}\r\nContent-Length: -1\r\n\r\n`,
    () => `POST /api/scene HTTP/1.1\r\nHost: ${host}\r\nContent-Length: 99999999999\r\n\r\nx`,
    () => `GET /api/frame?camera=%7B&width=${i}&height=4 HTTP/1.1\r\nHost: ${host}\r\n\r\n`,
    () => `GET /api/frame?view=${i}&edit=${"(".repeat(i % 2000)} HTTP/1.1\r\nHost: ${host}\r\n\r\n`,
    () => `GET /page/../../../etc/passwd HTTP/1.1\r\nHost: ${host}\r\n\r\n`,
    () => `GET /api/scene HTTP/1.1\r\nHost: elsewhere.example\r\n\r\n`,
    () => `GET /api/scene HTTP/1.1\r\nHost: ${host}\r\nOrigin: http://elsewhere.example\r\n\r\n`,
    () => `GET /api/probe?view=000&x=-1&y=1e99 HTTP/1.1\r\nHost: ${host}\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n`,
  ];
  return Buffer.from(kinds[i % kinds.length](), "latin1");
}
let sent = 0;
const total = Number(messages);
const before = residentMb();
const senders = Promise.all(
  Array.from({ length: 16 }, async () => {
    while (sent < total) {
      const message = malformed(sent++);
      await new Promise((resolve) => {
        const socket = net.connect(Number(port), hostname);
        const done = () => {
          socket.destroy();
          resolve();
        };
        socket.on("error", done);
        socket.on("data", (data) => {
          if (/^HTTP\/1.1 2/.test(String(data.subarray(0, 12)))) wrong(`an answer to ${message.toString("latin1").slice(0, 60)}`);
          done();
        });
        socket.on("close", done);
        socket.setTimeout(20, done);
        socket.write(message);
      });
    }
  }),
);
report(`beside ${messages} malformed messages`, await client("quiet", () => sent >= total));
await senders;
const after = residentMb();
if (after > before + 100) wrong(`memory grew from ${before.toFixed(0)} to ${after.toFixed(0)} MB`);

if (Number(minutes) > 0) {
  const resident = [];
  const isOver = lasting(60 * Number(minutes));
  const clock = setInterval(() => resident.push(residentMb()), 15000);
  report(`${minutes} minutes of movement at 640x360`, await client("moving", isOver));
  clearInterval(clock);
  console.log(`   resident, MB: ${resident.map((mb) => mb.toFixed(0)).join(" ")}`);
  const half = resident.length >> 1;
  if (Math.max(...resident.slice(half)) > Math.max(...resident.slice(0, half)) + 20) wrong("memory grows with time");
}
child.kill();
console.log(faults ? `${faults} wrong` : "all answers right, memory flat");
process.exit(faults ? 1 : 0);
