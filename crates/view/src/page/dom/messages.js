/** Messages over the picture: what is wrong is shown until it is right again, a notice for a while. */

import { byId } from "./elements.js";

/** Time for which a notice is shown, ms. */
const NOTICE_MS = 8000;

/** What a message is about: of several, the first in this order is shown. @typedef {"connection" | "display" | "mesh" | "notice" | "picture" | "other picture"} About */

export class Messages {
  /** @type {{ [about in About]: string }} */ texts = { connection: "", display: "", mesh: "", notice: "", picture: "", "other picture": "" };
  /** The timer of the notice. */ timer = 0;

  /** Shows what is wrong; "" once it is right again, which leaves what is wrong with others. @param {About} about @param {string} text */
  set(about, text) {
    if (this.texts[about] === text) return;
    this.texts[about] = text;
    const shown = Object.values(this.texts).find(Boolean) ?? "";
    const element = byId("message");
    element.hidden = shown === "";
    if (element.textContent !== shown) element.textContent = shown;
  }

  /** Shows a message for a while. @param {string} text */
  notice(text) {
    this.set("notice", text);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.set("notice", ""), NOTICE_MS);
  }
}
