/** Sections of the panel that fold, so that the main controls fit a small screen. Which are open is kept by the browser. */

const KEY = "luxel folded";

/** @returns {{ [title: string]: boolean }} */
function stored() {
  try {
    return JSON.parse(localStorage.getItem(KEY) ?? "{}") ?? {};
  } catch {
    return {};
  }
}

/** @param {{ [title: string]: boolean }} folded */
function store(folded) {
  try {
    localStorage.setItem(KEY, JSON.stringify(folded));
  } catch {
    // A browser that keeps nothing.
  }
}

/** Makes the headings of sections buttons that fold them; `data-folded` in the document is the start. @param {HTMLElement} panel @param {() => void} changed what a section holds is drawn once it is seen */
export function foldSections(panel, changed) {
  const folded = stored();
  for (const section of panel.querySelectorAll("section")) {
    const heading = section.querySelector("h2");
    if (!heading) continue;
    const title = heading.textContent ?? "";
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: title, title: `Show or hide ${title.toLowerCase()}` });
    heading.replaceChildren(button);
    const show = (/** @type {boolean} */ isFolded) => {
      section.classList.toggle("folded", isFolded);
      button.setAttribute("aria-expanded", String(!isFolded));
    };
    show(folded[title] ?? section.hasAttribute("data-folded"));
    button.addEventListener("click", () => {
      folded[title] = !section.classList.contains("folded");
      show(folded[title]);
      store(folded);
      changed();
    });
  }
}
