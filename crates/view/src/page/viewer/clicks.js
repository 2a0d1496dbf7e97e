/** Clicks that need a position: depth comes with the picture at rest, so clicks before it wait for it. */

/** @typedef {import("../picture/pixels.js").Sample} Sample */
/** @typedef {import("./viewer.js").Viewer} Viewer */
/** A click at a place of a picture, 0 to 1 each, and what it does; the key is that of the picture. @typedef {{ key: string, u: number, v: number, act: (sample: Sample) => void }} Click */

export class Clicks {
  /** @type {Click[]} */ waiting = [];

  /** @param {Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
  }

  /** Has `act` take what the picture holds at a place, with its depth: at once, or as soon as it is there. @param {number} u @param {number} v @param {(sample: Sample) => void} act */
  at(u, v, act) {
    const { viewer } = this;
    const sample = viewer.sample(u, v);
    if (!sample) return;
    if (viewer.shown?.frame.depth) act(sample);
    else this.waiting.push({ key: viewer.want().key, u, v, act });
  }

  /** Takes back the last click that does this, if it waits; returns whether it does. @param {(sample: Sample) => void} act */
  takeBack(act) {
    const last = this.waiting.findLastIndex((click) => click.act === act);
    return last >= 0 && this.waiting.splice(last, 1).length > 0;
  }

  /** Does what waits, once the picture at rest is there. */
  step() {
    if (this.waiting.length === 0) return;
    const { viewer } = this;
    const { key } = viewer.want();
    const { fullKey, restedKey } = viewer.stream;
    if (!viewer.shown?.full || fullKey !== key || restedKey !== key) return;
    const clicks = this.waiting;
    this.waiting = [];
    for (const click of clicks) {
      const sample = viewer.sample(click.u, click.v);
      if (sample && click.key === key) click.act(sample);
      else viewer.messages.notice("The picture changed before its depth was there; click again.");
    }
  }
}
