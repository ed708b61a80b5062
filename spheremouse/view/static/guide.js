/** The panel of the guide: what the camera sees without a rig, and the steps from an empty folder to the service. */

import { el, setText } from "./dom.js";

/** @typedef {import("./types.js").Status} Status */
/** @typedef {import("./tune.js").Act} Act */
/** @typedef {{name: string, state: string, found: string, todo: string[], command: string, otherwise: [string, string][]}} Step */

const PAUSE_MS = 500; // between two looks

export class GuidePanel {
  #look = el("button", { type: "button", id: "look", class: "main" }, "Look");
  #again = el("input", { type: "checkbox", id: "look-again" });
  #note = el("p", { class: "help", role: "status" }, "The guide looks through the camera and at the files of the calibration.");
  #picture = el("img", { class: "sight", alt: "Picture of the camera with targets and dark spots", hidden: true });
  #lines = el("ul", { class: "findings" });
  #steps = el("ol", { class: "findings" });
  element = el("div", {}, el("div", { class: "row" }, this.#look, el("label", { class: "check" }, this.#again, "repeat")),
    this.#note, this.#picture, this.#lines, el("h3", {}, "Steps"), this.#steps);
  #perform;

  /** @param {Act} perform */
  constructor(perform) {
    this.#perform = perform;
    this.#look.addEventListener("click", () => void this.#run());
  }

  async #run() {
    this.#look.disabled = true;
    if (!this.#steps.children.length) setText(this.#note, "Looking. This takes a few seconds.");
    const done = await this.#perform("guide");
    this.#look.disabled = false;
    if (done) this.#show(done.data);
    else this.#again.checked = false;
    setTimeout(() => {
      if (!this.#again.checked) return;
      if (this.element.offsetParent && !document.hidden) void this.#run();
      else this.#again.checked = false; // nobody looks
    }, PAUSE_MS);
  }

  /** @param {Record<string, any>} data */
  #show({ folder, camera, problem, lines, picture, steps }) {
    setText(this.#note, problem ? "" : `Camera: ${camera}. Folder: ${folder}.`);
    const shown = problem ? [`camera  ${problem}`] : lines;
    this.#lines.replaceChildren(...shown.map((/** @type {string} */ line) => {
      const [name = "", text = ""] = line.split(/\s{2,}/); // aligned in a terminal
      return el("li", problem ? { class: "wrong" } : {}, el("b", {}, name), el("span", {}, text));
    }));
    URL.revokeObjectURL(this.#picture.src);
    this.#picture.hidden = !picture;
    if (picture) this.#picture.src = URL.createObjectURL(new Blob([Uint8Array.from(atob(picture), (c) => c.charCodeAt(0))], { type: "image/jpeg" }));
    this.#steps.replaceChildren(...steps.map((/** @type {Step} */ step) => el("li", { class: step.state.replace(" ", "-") },
      el("b", {}, step.state), el("span", {}, step.name + (step.found ? `: ${step.found}` : "")), ...(step.state === "next" ? task(step) : []))));
  }
}

/** @param {Step} step */
function task({ todo, command, otherwise }) {
  const run = (/** @type {string} */ text) => (text ? [el("p", {}, el("code", { class: "command" }, text))] : []);
  return [...todo.map((text) => el("p", { class: "help" }, text)), ...run(command),
    ...otherwise.flatMap(([text, other]) => [el("p", { class: "help" }, text), ...run(other)])];
}
