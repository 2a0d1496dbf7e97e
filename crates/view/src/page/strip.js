/** The strip of the data set's cameras, with pictures of their ground truth. */

/** @typedef {import("./scene.js").Scene} Scene */

/** @param {HTMLElement} strip @param {Scene} scene @param {(name: string) => void} chosen */
export function fillStrip(strip, scene, chosen) {
  strip.hidden = scene.cameras.length === 0;
  strip.replaceChildren(
    ...scene.cameras.map((camera) => {
      const button = document.createElement("button");
      button.dataset.view = camera.name;
      button.title = `${camera.name} (${camera.split}): stand at this camera`;
      const name = document.createElement("span");
      name.textContent = `${camera.name.split("/").at(-1)}${camera.split === "test" ? " test" : ""}`;
      if (camera.has_ground_truth) {
        const image = new Image();
        image.loading = "lazy";
        image.alt = "";
        image.src = `/api/thumbnail?view=${encodeURIComponent(camera.name)}`;
        button.append(image);
      }
      button.append(name);
      button.addEventListener("click", () => chosen(camera.name));
      return button;
    }),
  );
}
