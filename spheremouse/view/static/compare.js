/** Before and after a gesture side by side, in the picture of the stage that the setting changes. */

import { el, setText } from "./dom.js";

const DETECTION = ["contours", "predicted", "masked"];
const STAGES = /** @type {Record<string, string[]>} */ ({ // layers by section of the settings
  camera: ["targets"], rings: ["targets"], pose: ["targets"], discs: DETECTION, blobs: DETECTION, so3: DETECTION, loss: DETECTION, wand: DETECTION,
});

export class Comparison {
  #canvases = ["Before", "Now"].map((name) => el("canvas", { role: "img", "aria-label": `${name}: picture of the stage` }));
  #captions = ["Before", "Now"].map(() => el("figcaption"));
  element = el("div", { class: "comparison", hidden: true }, ...this.#canvases.map((canvas, i) => el("figure", {}, canvas, this.#captions[i] ?? "")));
  /** @type {string[]} */ #layers = [];
  #picture;

  /** @param {import("./picture.js").Picture} picture */
  constructor(picture) {
    this.#picture = picture;
    picture.painters.push(() => this.#draw(1));
  }

  /**
   * Keep the present picture as that before a gesture.
   * @param {string} key of the setting
   */
  begin(key) {
    const layers = STAGES[key.split(".")[0] ?? ""];
    this.element.hidden = !layers;
    this.#layers = layers ?? [];
    for (const i of [0, 1]) this.#draw(i);
    if (!this.element.offsetParent) this.element.hidden = true; // another panel is open
  }

  /** @param {number} i 0 before, 1 now */
  #draw(i) {
    const [canvas, caption] = [this.#canvases[i], this.#captions[i]];
    if (!canvas || !caption || !this.element.offsetParent) return;
    setText(caption, `${i ? "Now" : "Before"}: ${this.#picture.copy(canvas, this.#layers)}`);
  }
}
