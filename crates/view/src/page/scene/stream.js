/**
 * Asks for pictures: small ones while the camera moves, so that latency stays near a target, with
 * coverage and depth where these are shown; a full one, with both, when it rests.
 */

import { clamp } from "../math/vectors.js";
import { sampled, sharp } from "./variant.js";

/** @typedef {import("../math/lens.js").Lens} Lens */
/** @typedef {import("./scene.js").Frame} Frame */
/** @typedef {import("./source.js").Source} Source */
/** A picture that is wanted: key changes whenever it would differ; `layers` tells whether coverage or depth is what is shown. @typedef {{ key: string, layers: boolean, lens: (width: number, height: number) => Lens, width: number, height: number, edit: string, variant: import("./variant.js").Variant }} Want */
/** A picture, the lens it was rendered with, and whether it is of full resolution. @typedef {{ frame: Frame, lens: Lens, full: boolean, latency: number }} Shown */

/** Time from asking to a picture that is aimed at while moving, ms. */
const TARGET_MS = 45;
/** Samples of a lens while moving. */
const MOVING_SAMPLES = 4;
/** Time without movement after which the full picture is asked for, ms. */
const REST_MS = 30;
/** Requests on their way while moving: one is rendered while another travels. */
const IN_FLIGHT = 2;
/** Least height of a moving picture, pixels. */
const LEAST_HEIGHT = 180;
/** Rows by which the height of moving pictures changes: each change costs a new canvas. */
const ROWS = 24;
/** Time between two pictures beyond which they are not of one movement, ms. */
const APART_MS = 250;
/** Latency of full pictures up to which the moving ones before them are given up, ms. */
const SOON_MS = 250;

export class Stream {
  /** @type {Want | null} */ want = null;
  movedAt = -Infinity;
  moving = 0;
  sequence = 0;
  shownSequence = 0;
  sentKey = "";
  fullKey = "";
  /** Key of the full picture whose coverage and depth are there, too. */ restedKey = "";
  /** @type {AbortController | null} */ full = null;
  /** Gives up the moving pictures on their way. */ movement = new AbortController();
  /** Milliseconds per pixel while moving, a running mean. */ cost = TARGET_MS / (640 * 360);
  /** Height of the last moving picture. */ height = 0;
  /** Time at which the last moving picture was shown. */ movingAt = -Infinity;
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

  /** Takes what is wanted next for no movement, during which small pictures are asked for. */
  jump() {
    this.want = null;
  }

  /** Pictures per second over the last second. @param {number} now */
  rate(now) {
    while (this.times.length && now - this.times[0] > 1000) this.times.shift();
    return this.times.length;
  }

  /** Called at each beat of the clock. @param {Want} want @param {number} now */
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
    // Also where coverage and depth were given up, when something else was wanted for a moment.
    else if (!isMoving && !this.full && (this.fullKey !== want.key || this.restedKey !== want.key)) void this.sendFull(want);
  }

  /** Size of the next moving picture. @param {Want} want */
  movingSize(want) {
    const affordable = TARGET_MS / this.cost;
    const factor = Math.sqrt(affordable / (want.width * want.height));
    const affordableHeight = clamp(want.height * factor, Math.min(LEAST_HEIGHT, want.height), want.height);
    // Another height only where it is well worth it.
    if (this.height > want.height || Math.abs(affordableHeight - this.height) > ROWS * 1.5) this.height = Math.min(want.height, Math.round(affordableHeight / ROWS) * ROWS);
    const { height } = this;
    return { width: Math.max(1, Math.round((want.width * height) / want.height)), height };
  }

  /** @param {Want} want */
  async send(want) {
    this.sentKey = want.key;
    this.moving++;
    const { signal } = this.movement;
    const sequence = ++this.sequence;
    const { width, height } = this.movingSize(want);
    const lens = want.lens(width, height);
    const start = performance.now();
    try {
      const variant = sampled(want.variant, { samples: MOVING_SAMPLES, part: [0, 1] });
      const frame = await this.source.frame(lens, { edit: want.edit, variant, radiance: true, layers: want.layers }, signal);
      const latency = performance.now() - start;
      this.failures = 0;
      this.onState(null);
      if (!frame || signal.aborted) return;
      this.latency = latency;
      // Two travel at a time, so that each waits for the one before it. Drawing takes time, too, of
      // which fewer pixels save a part only.
      const now = performance.now();
      const apart = now - this.movingAt < APART_MS ? now - this.movingAt : 0;
      this.cost += 0.2 * (clamp(apart, latency / IN_FLIGHT, (1.4 * latency) / IN_FLIGHT) / (width * height) - this.cost);
      this.movingAt = now;
      if (sequence > this.shownSequence) {
        this.shownSequence = sequence;
        // The full picture is no longer the one that is seen.
        this.fullKey = this.restedKey = "";
        this.shown({ frame, lens, full: false, latency });
      }
    } catch (error) {
      if (!signal.aborted) this.failed(/** @type {Error} */ (error));
    } finally {
      this.moving--;
    }
    // Not only at the next refresh of the screen.
    if (this.want) this.tick(this.want, performance.now());
  }

  /** @param {Want} want */
  async sendFull(want) {
    const abort = new AbortController();
    this.full = abort;
    // Rendering and drawing them would delay the full picture, which comes before anybody misses them.
    if (this.moving && this.fullLatency > 0 && this.fullLatency < SOON_MS) {
      this.movement.abort();
      this.movement = new AbortController();
    }
    const sequence = ++this.sequence;
    const lens = want.lens(want.width, want.height);
    const start = performance.now();
    const apart = this.source.layersApart;
    try {
      const frame = await this.source.frame(lens, { edit: want.edit, variant: want.variant, radiance: true, layers: !apart }, abort.signal);
      this.failures = 0;
      this.onState(null);
      if (!frame || this.full !== abort) return;
      this.fullLatency = performance.now() - start;
      this.fullKey = want.key;
      this.shownSequence = sequence;
      this.shown({ frame, lens, full: true, latency: this.fullLatency });
      // Coverage and depth may follow: the eye does not miss them.
      const layers = apart ? await this.source.frame(lens, { edit: want.edit, variant: sharp(want.variant), radiance: false, layers: true }, abort.signal) : null;
      if (layers && this.full === abort && layers.head.version === frame.head.version) {
        Object.assign(frame, { alpha: layers.alpha, depth: layers.depth });
        this.shown({ frame, lens, full: true, latency: this.fullLatency });
      }
      if (this.full !== abort) return;
      // Something newer took their place.
      if (apart && !layers) this.fullKey = "";
      else this.restedKey = want.key;
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
