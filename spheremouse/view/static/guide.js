/** The panel of the guide: the camera's picture, and the steps from an empty folder to the service with their commands. */

import { el, setText } from "./dom.js";

/** @typedef {import("./tune.js").Act} Act */
/** @typedef {{name: string, state: string, found: string, todo: string[], command: string, otherwise: [string, string][]}} Step */
/** @typedef {{lines?: string[], source?: string, photos?: number, check?: string, gain?: string, status?: string[], wanted?: string[]}} Check of a frame */
/** @typedef {{running: string, lines: string[], check: Check | null, picture: string | null, problem: string}} State */

const CAMERA = "camera"; // the step before all others

export class GuidePanel {
  #look = el("button", { type: "button", id: "look", class: "main", click: () => void this.#do("look") }, "Look through the camera");
  #stop = el("button", { type: "button", id: "stop", click: () => void this.#do("stop") }, "Stop");
  #note = el("p", { class: "help", role: "status" });
  #wanted = el("p", { class: "wanted", role: "status" });
  #picture = el("img", { class: "sight", alt: "Picture of the camera with what was detected in it", hidden: true });
  #status = el("pre", { class: "coverage", role: "group", "aria-label": "Photos by region and tilt" });
  #checks = el("ul", { class: "findings" });
  #output = el("div", { class: "output", role: "log", "aria-label": "Output of the command" });
  #steps = el("ol", { class: "findings" });
  element = el("div", {}, el("div", { class: "row" }, this.#look, this.#stop), this.#note, this.#wanted, this.#picture, this.#status,
    this.#checks, this.#output, el("h3", {}, "Steps"), this.#steps);
  #perform;
  #running = "";
  #shown = ""; // steps

  /** @param {Act} perform */
  constructor(perform) {
    this.#perform = perform;
    this.take({ running: "", lines: [], check: null, picture: null, problem: "" });
  }

  /** Read the steps again. */ refresh = () => this.#do("steps");

  async #do(/** @type {string} */ action, /** @type {Record<string, any>} */ words = {}) {
    if (action !== "steps") setText(this.#note, "One moment.");
    else if (!this.#shown) this.#steps.replaceChildren(el("li", { class: "busy" }, "Reading the folder"));
    const done = await this.#perform("guide", { do: action, ...words });
    if (!done || action === "describe") setText(this.#note, "");
    if (!done && !this.#shown) this.#steps.replaceChildren();
    if (done?.data["steps"]) this.#showSteps(done.data);
  }

  /** @param {State} state of the command that runs, or ended last */
  take({ running, lines, check, picture, problem }) {
    if (this.#running && !running && this.#running !== CAMERA) void this.refresh();
    const focused = document.activeElement; // it is hidden or disabled below
    this.#running = running;
    [this.#look.hidden, this.#look.disabled] = [running === CAMERA, running !== "" && running !== CAMERA];
    if (!running && focused === this.#stop) this.#look.focus();
    this.#stop.hidden = !running;
    if (running && (focused === this.#look || focused?.closest("li.next button"))) this.#stop.focus();
    for (const [name, is] of /** @type {const} */ ([["refused", problem !== ""], ["busy", running !== ""]])) this.#note.classList.toggle(name, is);
    const camera = check?.source ? `The camera is ${check.source}.` : "Opening the camera.";
    setText(this.#note, problem || (running === CAMERA ? camera : running ? `Under way: ${running}.` : "Place and focus the camera first. Then follow the steps."));
    setText(this.#wanted, running && check?.wanted?.[0] ? `Next: ${check.wanted[0]}` : "");
    if (!running) [check, picture] = [null, null]; // the steps come up
    setText(this.#status, (check?.status ?? []).join("\n"));
    this.#checks.replaceChildren(...(check?.lines ?? [`${check?.gain ? "photo" : "frame"}  ${check?.check ?? ""}`]).filter(() => check).map((line) => {
      const [name = "", text = ""] = line.split(/\s{2,}/); // aligned in a terminal
      return el("li", {}, el("b", {}, name), el("span", {}, text));
    }));
    // The problem is the last line of a command that failed.
    setText(this.#output, lines.slice(-12, problem ? -1 : undefined).join("\n"));
    this.#picture.hidden = !picture;
    URL.revokeObjectURL(this.#picture.src);
    if (picture) this.#picture.src = URL.createObjectURL(new Blob([Uint8Array.from(atob(picture), (c) => c.charCodeAt(0))], { type: "image/jpeg" }));
    for (const button of this.#steps.querySelectorAll("button")) button.disabled = running !== "" && running !== CAMERA;
  }

  /** @param {Record<string, any>} data */
  #showSteps({ steps, device }) {
    const text = JSON.stringify([steps, device]);
    if (text === this.#shown) return;
    this.#shown = text;
    const focused = this.#steps.contains(document.activeElement);
    this.#steps.replaceChildren(...steps.map((/** @type {Step} */ step) => el("li", { class: step.state.replace(" ", "-") },
      el("b", {}, step.state), el("span", {}, step.name + (step.found ? `: ${step.found}` : "")), ...(step.state === "next" ? this.#task(step, device) : []))));
    if (focused) this.#look.focus();
    this.#steps.querySelector(".next")?.scrollIntoView({ block: "nearest" }); // below the output of the last one
  }

  /**
   * @param {Step} step
   * @param {string | undefined} device text of device.yaml, if it is to be filled in
   */
  #task({ name, todo, command, otherwise }, device) {
    const square = el("input", { id: "square", class: "number", inputmode: "decimal", placeholder: "as printed", autocomplete: "off" });
    const run = (/** @type {string} */ text, /** @type {number} */ number) => {
      if (!text) return [];
      const code = el("code", { class: "command" }, text);
      if (!text.startsWith("spheremouse ")) return [el("p", { class: "help" }, "In a terminal:", code)];
      const button = el("button", { type: "button", class: number ? "" : "main", "aria-label": `Run ${text}`,
        click: () => void this.#do("run", { step: name, number, square: square.value.trim().replace(",", ".") }) }, "Run");
      const side = text.endsWith("--for camera") ? [el("label", { for: "square" }, "Side of a square, mm"), square] : [];
      return [el("p", {}, el("span", { class: "row" }, button, ...side), code)];
    };
    const area = el("textarea", { id: "device", rows: "14", spellcheck: "false" });
    area.value = device ?? "";
    const entry = device === undefined ? [] : [el("p", {}, el("label", { for: "device" }, "device.yaml"), area,
      el("button", { type: "button", id: "describe", class: "main", click: () => void this.#do("describe", { text: area.value }) }, "Write device.yaml"))];
    return [...todo.map((text) => el("p", { class: "help" }, text)), ...entry, ...run(command, 0),
      ...otherwise.flatMap(([text, other], i) => [el("p", { class: "help" }, text), ...run(other, i + 1)])];
  }
}
