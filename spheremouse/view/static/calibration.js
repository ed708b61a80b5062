/** The panel of the calibration: the reports of camera and device as they were written. */

import { el, setText, table } from "./dom.js";

/** @typedef {{file: string, rms_px: number | null, points: number | null, why: string}} Photo */
/** @typedef {{file: string, kind: string, date: string, rows: string[][], photos: Photo[], advice: string[], problem?: string}} Report */

export class CalibrationPanel {
  #note = el("p", { class: "help", role: "status" });
  #reports = el("div", {});
  element = el("div", {}, el("div", { class: "row" }, el("button", { type: "button", click: () => void this.open() }, "Read again")),
    this.#note, this.#reports);
  #perform;

  /** @param {import("./tune.js").Act} perform */
  constructor(perform) {
    this.#perform = perform;
  }

  /** Read the reports again, as the panel is opened. */
  async open() {
    const done = await this.#perform("calibration");
    if (!done) return;
    const { reports, folders } = /** @type {{reports: Report[], folders: string[]}} */ (done.data);
    setText(this.#note, reports.length ? "" : `No report in ${folders.join(" and ")}. The commands of the guide write them.`);
    this.#reports.replaceChildren(...reports.map((report) => el("section", {}, el("h3", {}, report.kind ? `${report.kind}, ${report.date}` : "Not read"),
      el("p", { class: "help" }, report.file), ...(report.problem ? [el("p", { class: "refused" }, report.problem)] : content(report)))));
  }
}

/** @param {Report} report */
function content({ kind, rows, photos, advice }) {
  return [el("ul", { class: "findings" }, ...advice.map((text) => el("li", {}, text))), table(`Quantities of the ${kind}`, ["Quantity", "Value", "σ"], rowsOf(rows)),
    ...(photos.length ? [table(`Photos of the ${kind}`, ["Photo", "RMS, px", "Points", "Note"], rowsOf(photos.map((photo) =>
      [photo.file, photo.rms_px?.toFixed(3) ?? "–", String(photo.points ?? "–"), photo.why])))] : [])];
}

/** @param {string[][]} rows */
function rowsOf(rows) {
  return el("tbody", {}, ...rows.map(([first = "", ...others]) => el("tr", {}, el("th", { scope: "row" }, first), ...others.map((text) => el("td", {}, text)))));
}
