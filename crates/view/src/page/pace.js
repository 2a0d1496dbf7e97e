/**
 * The page's clock: each refresh of the screen while something happens, ten times a second at rest,
 * which leaves the processor to a training beside it, and spares batteries.
 */

/** Time after the last event during which each refresh counts, ms. */
const AWAKE_MS = 1000;
/** Time between two beats at rest, ms. */
const REST_MS = 100;
/** Events of the window that may change what is shown. */
const EVENTS = ["pointerdown", "pointermove", "pointerup", "wheel", "keydown", "keyup", "input", "change", "click", "dragover", "drop", "resize", "hashchange", "focus"];

export class Pace {
  wokenAt = -Infinity;
  /** The timer of the next beat at rest; 0 while awake. */ timer = 0;
  before = performance.now();

  /** @param {(now: number, seconds: number) => boolean} beat does what is due, and returns whether more is */
  constructor(beat) {
    this.beat = beat;
    this.step = this.step.bind(this);
    for (const event of EVENTS) addEventListener(event, () => this.wake(), { capture: true, passive: true });
    this.wake();
    requestAnimationFrame(this.step);
  }

  /** Whether something happened lately. */
  isAwake() {
    return performance.now() - this.wokenAt < AWAKE_MS;
  }

  /** Has each refresh of the screen count for a while. */
  wake() {
    this.wokenAt = performance.now();
    if (!this.timer) return;
    clearTimeout(this.timer);
    this.timer = 0;
    this.before = this.wokenAt;
    requestAnimationFrame(this.step);
  }

  /** @param {number} now */
  step(now) {
    this.timer = 0;
    const isBusy = this.beat(now, (now - this.before) / 1000);
    this.before = now;
    if (isBusy || now - this.wokenAt < AWAKE_MS) requestAnimationFrame(this.step);
    else this.timer = setTimeout(() => requestAnimationFrame(this.step), REST_MS);
  }
}
