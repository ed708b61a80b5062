/** The panel of the recordings: a replay in place of the camera, and two settings compared on the same seconds. */

import { el, formatNumber, setText, table } from "./dom.js";

/** @typedef {import("./types.js").Status} Status */
/** @typedef {import("./tune.js").Act} Act */
/** @typedef {{name: string, frames: number, seconds: number, wand: boolean, truth: boolean, problem: string}} Recording */

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5];

/** @type {[label: string, unit: string, read: (report: any) => number | null | undefined, best: number][]} */
const ROWS = [
  ["Attitude, RMS error", "°", (r) => r.attitude_rmse_deg?.combined ?? r.rotation_rmse_deg, 0],
  ["Rate, RMS error", "°/s", (r) => r.rate_rmse_deg_s?.combined, 0],
  ["Position, RMS error", "mm", (r) => r.position_rmse_mm && Math.hypot(...Object.values(r.position_rmse_mm)), 0],
  ["Frames tracked", "%", (r) => (100 * r.tracked) / r.frames, 100],
  ["Times lost", "", (r) => r.lost_episodes, 0],
  ["Points used", "", (r) => r.mean_discs, Infinity],
  ["Innovation (NIS; 1 is right)", "", (r) => r.nis, 1],
  ["Roughness of the rate", "°/s", (r) => r.rate_roughness_deg_s, 0],
];

export class RecordingsPanel {
  /** @type {Map<string, Recording>} */ #all = new Map();
  #list = el("select", { id: "recording", change: () => this.#choose() });
  #note = el("p", { class: "help", role: "status" });
  #play = el("button", { type: "button", id: "play", class: "main" }, "Play");
  #leave = el("button", { type: "button", id: "leave" }, "Back to the camera");
  #position = el("p", { class: "help" });
  #hold = el("button", { type: "button", id: "hold" }, "Pause");
  #speed = el("select", { id: "replay-speed" }, ...SPEEDS.map((x) => el("option", { value: x, selected: x === 1 }, `${x} ×`)));
  #loop = el("input", { type: "checkbox", id: "replay-loop" });
  #begin = el("input", { type: "number", id: "replay-begin", min: 0, step: 0.1, value: 0 });
  #end = el("input", { type: "number", id: "replay-end", min: 0, step: 0.1, placeholder: "end" });
  #evaluate = el("button", { type: "button", id: "compare" }, "Compare saved and present settings");
  #stop = el("button", { type: "button", id: "stop-compare", hidden: true, click: () => void this.#perform("stop") }, "Stop");
  #results = el("tbody", {});
  #table = table("Comparison", ["On these seconds", "Saved", "Present"], this.#results);
  #player;
  #status = /** @type {Status | null} */ (null);
  #perform;
  element;

  /** @param {Act} perform */
  constructor(perform) {
    this.#perform = perform;
    const control = (/** @type {Record<string, any>} */ values) => void perform("replay", values);
    const button = (/** @type {string} */ id, /** @type {string} */ name, /** @type {Record<string, any>} */ values) =>
      el("button", { type: "button", id, click: () => control(values) }, name);
    this.#play.addEventListener("click", () => void this.#run(this.#play, "play", "The tracker starts. This takes some seconds."));
    this.#leave.addEventListener("click", () => void this.#run(this.#leave, "leave", ""));
    this.#evaluate.addEventListener("click", () => void this.#compare());
    this.#hold.addEventListener("click", () => void perform(this.#status?.paused ? "resume" : "pause"));
    this.#speed.addEventListener("change", () => control({ speed: Number(this.#speed.value) }));
    this.#loop.addEventListener("change", () => control({ loop: this.#loop.checked }));
    for (const field of [this.#begin, this.#end]) field.addEventListener("change", () => control(this.#section()));
    this.#player = el("fieldset", { class: "player", hidden: true }, el("legend", { class: "unseen" }, "Replay"), this.#position,
      el("div", { class: "row" }, this.#hold, button("step", "Step", { step: true }), button("rewind", "From the start", { rewind: true }),
        el("label", { class: "check" }, this.#loop, "loop"), el("label", { class: "check" }, "Speed", this.#speed)));
    this.element = el("div", {},
      el("div", { class: "row" }, el("label", { for: "recording" }, "Recording"), this.#list, this.#play, this.#leave), this.#note, this.#player,
      el("div", { class: "row" }, el("label", { for: "replay-begin" }, "Seconds from"), this.#begin, el("label", { for: "replay-end" }, "to"), this.#end,
        this.#evaluate, this.#stop),
      el("p", { class: "help" }, "While a recording plays, change settings in Tune or Expert. The comparison tracks these seconds with the saved and with the present settings."),
      this.#table);
    this.#table.hidden = true;
  }

  /** Read the list again, as the panel is opened. */
  async open() {
    const done = await this.#perform("recordings");
    if (!done) return;
    const { recordings, folders } = /** @type {{recordings: Recording[], folders: string[]}} */ (done.data);
    const chosen = this.#list.value;
    this.#all = new Map(recordings.map((r) => [r.name, r]));
    this.#list.replaceChildren(...recordings.map((r) => el("option", { value: r.name, selected: r.name === chosen },
      `${r.name} (${r.problem || `${formatNumber(r.seconds, 3)} s${r.truth ? ", with truth" : ""}`})`)));
    setText(this.#note, recordings.length ? "" : `No recording in ${folders.join(" and ")}. Record makes one.`);
    this.#choose();
  }

  /** @param {Status | null} status */
  show(status) {
    this.#status = status;
    const replay = status?.source?.replay;
    this.#leave.hidden = this.#player.hidden = !replay;
    if (!replay) return;
    setText(this.#position, `Frame ${replay.frame + 1} of ${replay.frames}, ${replay.seconds.toFixed(2)} s`);
    setText(this.#hold, status?.paused ? "Resume" : "Pause");
    this.#loop.checked = replay.loop;
    for (const [field, value] of /** @type {const} */ ([[this.#speed, replay.speed], [this.#begin, replay.begin], [this.#end, replay.end ?? ""]]))
      if (document.activeElement !== field) field.value = String(value);
  }

  #choose() {
    const chosen = this.#all.get(this.#list.value);
    this.#play.disabled = this.#evaluate.disabled = !chosen || chosen.problem !== "";
    this.#table.hidden = true;
  }

  #section() {
    return { begin: Number(this.#begin.value) || 0, end: Number(this.#end.value) || 0 };
  }

  /** Carry out an action; the button is disabled and the note shown while it runs. */
  async #run(/** @type {HTMLButtonElement} */ button, /** @type {string} */ action, /** @type {string} */ note) {
    button.disabled = true;
    setText(this.#note, note);
    const words = action === "leave" ? {} : { name: this.#list.value, ...(action === "compare" ? this.#section() : {}) };
    const done = await this.#perform(action, words, (seconds) => setText(this.#note, `${note} ${seconds} s so far.`.trim()));
    button.disabled = false;
    setText(this.#note, "");
    return done;
  }

  async #compare() {
    const whole = this.#all.get(this.#list.value)?.wand ? " Of balls in a hand, this is the whole recording." : "";
    this.#stop.hidden = false;
    const both = this.#status?.changes?.length ? "Both settings are tracked." : "No setting is unsaved, so both columns will be equal.";
    const done = await this.#run(this.#evaluate, "compare", both + whole);
    if (document.activeElement === this.#stop) this.#evaluate.focus();
    this.#stop.hidden = true;
    if (!done) return;
    const reports = [done.data.before, done.data.after];
    this.#results.replaceChildren(...ROWS.flatMap(([label, unit, read, best]) => {
      const values = reports.map((report) => read(report) ?? null);
      const distances = values.map((v) => (v === null ? Infinity : best === Infinity ? -v : Math.abs(v - best)));
      if (values.every((v) => v === null)) return [];
      return [el("tr", {}, el("th", { scope: "row" }, label), ...values.map((v, i) => {
        const better = (distances[i] ?? 0) < (distances[1 - i] ?? 0);
        return el("td", better ? { class: "better" } : {}, v === null ? "–" : `${formatNumber(v, 3)}${unit === "°" ? "" : " "}${unit}${better ? " (better)" : ""}`);
      }))];
    }));
    this.#table.hidden = false;
  }
}
