/** The stream of the server's states; the browser connects again by itself. */

/** @typedef {import("./scene.js").Status} Status */

/** Time before a stream that was refused is asked for again, ms. */
const AGAIN_MS = 2000;

/** Called with each state, when the connection is lost, and when it is there again. @typedef {{ state: (status: Status) => void, lost: () => void, again: () => void }} Listener */

/** @param {Listener} on */
export function listen(on) {
  const source = new EventSource("/api/events");
  let wasLost = false;
  source.onmessage = (event) => {
    if (wasLost) on.again();
    wasLost = false;
    on.state(JSON.parse(event.data));
  };
  source.onerror = () => {
    wasLost = true;
    on.lost();
    // A server that refuses ends the stream for good.
    if (source.readyState === EventSource.CLOSED) setTimeout(() => listen(on), AGAIN_MS);
  };
}
