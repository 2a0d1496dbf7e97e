/** Elements of the document, and rows of buttons of which one is chosen. */

/** @template {HTMLElement} [T=HTMLInputElement] @param {string} id @returns {T} */
export const byId = (id) => /** @type {T} */ (document.getElementById(id));

/** Fills a row of buttons of which one is chosen. @param {HTMLElement} group @param {readonly string[]} names @param {(name: string) => void} chosen */
export function segmented(group, names, chosen) {
  for (const name of names) {
    const button = Object.assign(document.createElement("button"), { textContent: name, type: "button" });
    button.dataset.value = name;
    button.addEventListener("click", () => chosen(name));
    group.append(button);
  }
}

/** Shows which button of a row is chosen. @param {string} id @param {string} value */
export function press(id, value) {
  for (const button of byId(id).querySelectorAll("button")) button.setAttribute("aria-pressed", String(button.dataset.value === value));
}
