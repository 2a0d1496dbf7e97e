/** Files that the browser gives and takes: dropped on the page, and saved. */

/** @typedef {import("../viewer/viewer.js").Viewer} Viewer */

/** Opens a file. @typedef {(file: File) => Promise<void>} Open */

/** Lets the page open files by the ends of their names. @param {Viewer} viewer @param {{ [extension: string]: Open }} openers */
export function openDropped(viewer, openers) {
  addEventListener("dragover", (event) => event.dataTransfer?.types.includes("Files") && event.preventDefault());
  addEventListener("drop", (event) => {
    const file = event.dataTransfer?.files[0];
    if (!file) return;
    event.preventDefault();
    const open = openers[file.name.split(".").at(-1)?.toLowerCase() ?? ""];
    if (open) void open(file);
    else viewer.messages.notice(`${file.name}: expected a camera path (.json), edits (.edits) or an object (.glb)`);
  });
}

/** Has the browser save a file. @param {string} url @param {string} name */
export function download(url, name) {
  const link = Object.assign(document.createElement("a"), { href: url, download: name });
  link.click();
}
