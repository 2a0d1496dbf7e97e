/**
 * Asks for pictures: small ones while the camera moves, so that latency stays near a target; a full
 * one, with coverage and depth, when it rests.
 */

import { clamp } from "./math.js";

/** @typedef {import("./lens.js").Lens} Lens */
/** @typedef {import("./scene.js").Frame} Frame */
/** @typedef {import("./source.js").Source} Source */
/** A picture that is wanted: key changes whenever it would differ. @typedef {{ key: string, lens: (width: number, height: number) => Lens, width: number, height: number, edit: string }} Want */
/** A picture, the lens it was rendered with, and whether it is of full resolution. @typedef {{ frame: Frame, lens: Lens, full: boolean, latency: number }} Shown */

/** Time from asking to a picture that is aimed at while moving, ms. */
const TARGET_MS = 45;
/** Time without movement after which the full picture is asked for, ms. */
const REST_MS = 60;
/** Requests on their way while moving: one is rendered while another travels. */
const IN_FLIGHT = 2;
/** Least height of a moving picture, pixels. */
const LEAST_HEIGHT = 120;

export class Stream {
  /** @type {Want | null} */ want = null;
  movedAt = -Infinity;
  moving = 0;
  sequence = 0;
  shownSequence = 0;
  sentKey = "";
  fullKey = "";
  /** @type {AbortController | null} */ full = null;
  /** Milliseconds per pixel while moving, a running mean. */ cost = TARGET_MS / (640 * 360);
  /** Times at which the last pictures were shown. @type {number[]} */ times = [];
  latency = 0;
  fullLatency = 0;
  frames = 0;
  failures = 0;
  retryAt = 0;

  /** @param {Source} source @param {(shown: Shown) => void} onFrame @param {(error: Error | null) => void} onState */
  constructor(source, onFrame, onState) {
    this.source = source;
    this.onFrame = onFrame;
    this.onState = onState;
  }

  /** Forgets what was shown, so that everything is asked for again. */
  invalidate() {
    this.fullKey = "";
    this.full?.abort();
    this.full = null;
  }

  /** Pictures per second over the last second. @param {number} now */
  rate(now) {
    while (this.times.length && now - this.times[0] > 1000) this.times.shift();
    return this.times.length;
  }

  /** Called once per screen refresh. @param {Want} want @param {number} now */
  tick(want, now) {
    if (this.want?.key !== want.key) {
      if (this.want) this.movedAt = now;
      this.want = want;
      // What failed before may work now.
      this.retryAt = this.failures = 0;
      this.full?.abort();
      this.full = null;
    }
    if (now < this.retryAt) return;
    const isMoving = now - this.movedAt < REST_MS;
    if (isMoving && this.moving < IN_FLIGHT && this.sentKey !== want.key) void this.send(want);
    else if (!isMoving && !this.full && this.fullKey !== want.key && this.moving === 0) void this.sendFull(want);
  }

  /** Size of the next moving picture. @param {Want} want */
  movingSize(want) {
    const affordable = TARGET_MS / this.cost;
    const factor = Math.sqrt(affordable / (want.width * want.height));
    const height = clamp(Math.round((want.height * factor) / 24) * 24, Math.min(LEAST_HEIGHT, want.height), want.height);
    return { width: Math.max(1, Math.round((want.width * height) / want.height)), height };
  }

  /** @param {Want} want */
  async send(want) {
    this.sentKey = want.key;
    this.moving++;
    const sequence = ++this.sequence;
    const { width, height } = this.movingSize(want);
    const lens = want.lens(width, height);
    const start = performance.now();
    try {
      const frame = await this.source.frame(lens, { edit: want.edit, layers: false });
      const latency = performance.now() - start;
      this.failures = 0;
      this.onState(null);
      if (!frame) return;
      // Two travel at a time, so that each waits for the one before it.
      this.cost += 0.2 * (latency / IN_FLIGHT / (width * height) - this.cost);
      this.latency = latency;
      if (sequence > this.shownSequence) {
        this.shownSequence = sequence;
        this.shown({ frame, lens, full: false, latency });
      }
    } catch (error) {
      this.failed(/** @type {Error} */ (error));
    } finally {
      this.moving--;
    }
  }

  /** @param {Want} want */
  async sendFull(want) {
    const abort = new AbortController();
    this.full = abort;
    const sequence = ++this.sequence;
    const lens = want.lens(want.width, want.height);
    const start = performance.now();
    try {
      const frame = await this.source.frame(lens, { edit: want.edit, layers: true }, abort.signal);
      this.failures = 0;
      this.onState(null);
      if (frame && this.full === abort) {
        this.fullLatency = performance.now() - start;
        this.fullKey = want.key;
        this.shownSequence = sequence;
        this.shown({ frame, lens, full: true, latency: this.fullLatency });
      }
    } catch (error) {
      if (!abort.signal.aborted) this.failed(/** @type {Error} */ (error));
    } finally {
      if (this.full === abort) this.full = null;
    }
  }

  /** @param {Shown} shown */
  shown(shown) {
    this.frames++;
    this.times.push(performance.now());
    this.onFrame(shown);
  }

  /** @param {Error} error */
  failed(error) {
    this.failures++;
    this.sentKey = "";
    this.retryAt = performance.now() + Math.min(250 * 2 ** this.failures, 5000);
    this.onState(error);
  }
}
