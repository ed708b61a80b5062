/** The panels of the log, the outputs and the doctor. */

import { byId, el, formatDuration, formatLatency, formatSigned, setText, table, withCode } from "./dom.js";

/** @typedef {import("./types.js").Status} Status */
/** @typedef {import("./tune.js").Act} Act */

const MAX_LINES = 2000;

export class LogPanel {
  #filter = el("input", { type: "search", id: "log-filter", placeholder: "Text in the line", autocomplete: "off" });
  #count = el("p", { class: "help" });
  #lines = el("div", { class: "log", role: "log", tabindex: "0", "aria-label": "Lines of the log" });
  element = el("div", { class: "logs" }, el("div", { class: "row" }, el("label", { for: "log-filter" }, "Filter"), this.#filter),
    this.#count, this.#lines);

  constructor() {
    this.#filter.addEventListener("input", () => this.#show());
  }

  /** @param {[number, string][]} lines the last ones before now, as of `add` */
  load(lines) {
    this.#lines.replaceChildren();
    this.add(lines);
  }

  /** @param {[number, string][]} lines time since 1970, s, and text */
  add(lines) {
    const { scrollTop, scrollHeight, clientHeight } = this.#lines;
    const atEnd = scrollTop + clientHeight >= scrollHeight - 8;
    this.#lines.append(...lines.map(([at, line]) => el("p", {}, el("time", {}, new Date(1000 * at).toTimeString().slice(0, 8)), line)));
    while (this.#lines.children.length > MAX_LINES) this.#lines.firstElementChild?.remove();
    this.#show();
    if (atEnd) this.#lines.scrollTop = this.#lines.scrollHeight;
  }

  #show() {
    const wanted = this.#filter.value.trim().toLowerCase();
    let shown = 0;
    for (const line of this.#lines.children) {
      const hidden = !(line.textContent ?? "").toLowerCase().includes(wanted);
      line.toggleAttribute("hidden", hidden);
      shown += Number(!hidden);
    }
    const all = this.#lines.children.length;
    setText(this.#count, all ? `${shown} of ${all} lines` : "No line yet. The page shows the lines since it was opened.");
  }
}

export class OutputsPanel {
  #table = el("tbody", {});
  #facts = el("dl", { class: "facts" });
  element = el("div", {},
    table("Table of the outputs", ["Output", "State", "Reports", "Dropped", "Latency", "Counts not sent"], this.#table),
    el("h3", {}, "The run"), this.#facts);

  /** @param {Status | null} status */
  show(status) {
    const rows = (status?.outputs ?? []).map((/** @type {any} */ o) => [
      o.spec ?? "–", o.failed ?? o.left_out ?? "sends", o.reports ?? 0, o.dropped ?? 0,
      formatLatency(o.latency_ms), o.unsent?.some(Boolean) ? o.unsent.join(", ") : "none"]);
    fill(this.#table, rows, (row) => el("tr", {}, ...row.map((cell, i) => (i ? el("td", {}, cell) : el("th", { scope: "row" }, cell)))));
    const s = status ?? {};
    const pose = s.pose;
    const cameras = (s.cameras ?? []).map((/** @type {any} */ c, /** @type {number} */ i) => [
      `Camera ${i + 1}`, `${c.description || c.spec}: ${c.trouble || `${c.frames ?? 0} frames`}`]);
    const facts = status ? [
      ["Tracker", s.tracker], ...(cameras.length ? cameras : [["Source", s.source?.description ?? s.source?.spec]]), ["Configuration", s.config],
      ...(s.balls ? [] : [["Rig", s.rig], ["Map", s.map]]),
      ["Frames", `${s.frames ?? 0} tracked, ${s.skipped ?? 0} skipped, ${s.dropped ?? 0} lost by the driver, ${s.damaged ?? 0} damaged`],
      ...(s.balls ? [] : [["Camera pose", pose?.position_m ? `${pose.position_m.map((/** @type {number} */ v) => formatSigned(v, 3)).join(", ")} m, σ ${(pose.sigma_mm ?? []).map((/** @type {number} */ v) => v.toFixed(1)).join(", ")} mm` : "not known"]]),
      ["Running", `${formatDuration(s.uptime_s ?? 0)}, without tracking ${formatDuration(s.unseen_s ?? 0)}, lost ${s.lost_count ?? 0} ${s.lost_count === 1 ? "time" : "times"}`],
      ["Process", `${Math.round(s.memory_mb ?? 0)} MB, ${Math.round(100 * (s.cpu_share ?? 0))} % of a core, ${s.scheduling ?? ""}`],
      ["Version", s.version]] : [["Tracker", "not running"]];
    fill(this.#facts, facts.map(([name, value]) => [name, value ?? "none"]), ([name = "", value = ""]) => el("div", {}, el("dt", {}, name), el("dd", {}, value)));
  }
}

/**
 * Write rows of texts; the elements stay, so that a selection in them stays.
 * @param {HTMLElement} parent
 * @param {any[][]} rows
 * @param {(row: string[]) => HTMLElement} make
 */
function fill(parent, rows, make) {
  const texts = rows.map((row) => row.map(String));
  while (parent.children.length > texts.length) parent.lastElementChild?.remove();
  texts.forEach((row, i) => {
    const present = parent.children[i];
    if (!present) parent.append(make(row));
    else row.forEach((cell, k) => setText(/** @type {HTMLElement} */ (present.children[k]), cell));
  });
}

export class DoctorPanel {
  #run = el("button", { type: "button", id: "doctor", class: "main" }, "Examine");
  #note = el("p", { class: "help", role: "status" }, "The doctor checks everything between the camera and the pointer.");
  #list = el("div", {});
  element = el("div", {}, el("div", { class: "row" }, this.#run), this.#note, this.#list);

  #perform;

  /** @param {Act} perform */
  constructor(perform) {
    this.#perform = perform;
    this.#run.addEventListener("click", async () => {
      this.#run.disabled = true;
      setText(this.#note, "Examining. This takes some seconds.");
      const done = await perform("doctor", {}, (seconds) => setText(this.#note, `Examining: ${seconds} s so far.`));
      this.#run.disabled = false;
      setText(this.#note, done?.message || (done ? "" : "The doctor gave no report."));
      if (done) this.#show(done.data.checks ?? []);
    });
  }

  /** @param {{subject: string, name: string, verdict: string, text: string, advice: string}[]} checks */
  #show(checks) {
    const subjects = [...new Set(checks.map((c) => c.subject))];
    this.#list.replaceChildren(...subjects.map((subject) => el("section", {}, el("h3", {}, subject),
      el("ul", { class: "findings" }, ...checks.filter((c) => c.subject === subject).map((c) =>
        el("li", { class: c.verdict.replace(" ", "-") }, el("b", {}, c.verdict), el("span", {}, `${c.name}: ${c.text}`),
          ...(c.advice ? [el("p", { class: "help" }, ...withCode(c.advice), ...this.#remedies(c.advice))] : [])))))));
  }

  /** @param {string} advice */
  #remedies(advice) {
    const open = (/** @type {string} */ panel) => () => byId(`tab-${panel}`, HTMLElement).click();
    /** @type {[RegExp, string, () => void][]} */
    const remedies = [
      [/ctl resume/, "Resume", () => void this.#perform("resume")], [/ctl reload/, "Read the configuration again", () => void this.#perform("reload")],
      [/uncover and light the targets/, "Estimate camera pose", () => void this.#perform("reinit")], [/section output/, "Open Outputs", open("Outputs")],
      [/calibrat/, "Open Guide", open("Guide")], [/(?<!docs\/)camera\.\w+|exposure|discs\./, "Open Tune", open("Tune")],
    ];
    return remedies.filter(([words]) => words.test(advice)).map(([, name, click]) => el("button", { type: "button", class: "quiet", click }, name));
  }
}
