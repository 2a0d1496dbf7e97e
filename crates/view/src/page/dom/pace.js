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
  /** The timer of the next beat at rest; 0 where a refresh of the screen brings it. */ timer = 0;
  before = performance.now();

  /** @param {(now: number, seconds: number) => boolean} beat does what is due, and returns whether more is */
  constructor(beat) {
    this.beat = beat;
    this.step = this.step.bind(this);
    for (const event of EVENTS) addEventListener(event, () => this.wake(), { capture: true, passive: true });
    this.wake();
    this.next();
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
    this.before = this.wokenAt;
    this.next();
  }

  /** Has the next refresh of the screen count. */
  next() {
    // From here on it comes by itself: another call would start a second clock.
    this.timer = 0;
    requestAnimationFrame(this.step);
  }

  /** @param {number} now */
  step(now) {
    // A refresh is dated from its beginning, which may be before the event that woke the clock.
    const isBusy = this.beat(now, Math.max(0, now - this.before) / 1000);
    this.before = now;
    if (isBusy || now - this.wokenAt < AWAKE_MS) this.next();
    else this.timer = setTimeout(() => this.next(), REST_MS);
  }
}
