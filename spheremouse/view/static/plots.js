/** Plots of the last 10 s: rate with its band, counts, latency, discs. */

import { byId, colour, el, formatLatency, formatSigned, prepareCanvas, setText } from "./dom.js";

/** @typedef {import("./types.js").Sample} Sample */
/** @typedef {(sample: Sample) => number | null} Read */
/** @typedef {{name: string, colour: string, dash: number[], read: Read, sigma?: Read}} Series */

const SECONDS = 10;
const BAND = 2; // standard deviations
const NUMBER_HEIGHT = 11; // px that a number at the axis takes
const DEGREES = 180 / Math.PI;
const DASHES = [[], [6, 3], [2, 2]];
const AXES = ["X", "Y", "Z"];

/** Return a sample of the row of a frame message. @type {(row: any[]) => Sample} */
export function readSample(row) {
  const [stamp, ball, confirmed, qw, qx, qy, qz, wx, wy, wz, sx, sy, sz, cx, cy, cz, latency, discs, px, py, pz] = row;
  const known = (/** @type {any} */ v) => v !== null && v !== undefined;
  return {
    stamp, ball, confirmed: Boolean(confirmed),
    quaternion: known(qw) ? [qw, qx, qy, qz] : null,
    rate: known(wx) ? [wx, wy, wz] : null,
    sigma: known(sx) ? [sx, sy, sz] : null,
    counts: [cx ?? 0, cy ?? 0, cz ?? 0], latency: latency ?? null, discs: discs ?? null,
    position: known(px) && known(py) && known(pz) ? [px, py, pz] : null,
  };
}

/** Return at least two round numbers within a range that contains 0, and about `parts` of them. @type {(low: number, high: number, parts: number) => number[]} */
function ticks(low, high, parts) {
  const least = Math.min((0.8 * (high - low)) / parts, high / 2);
  const power = 10 ** Math.floor(Math.log10(least));
  const step = ([1, 2, 3, 5].find((m) => m * power >= least) ?? 10) * power;
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.max(0, Math.floor(high / step) - first + 1) }, (_, i) => (first + i) * step);
}

class Plot {
  /**
   * @param {string} id
   * @param {string} name
   * @param {string} unit
   * @param {Series[]} series
   * @param {{least: number, symmetric?: boolean, whole?: boolean}} range
   */
  constructor(id, name, unit, series, range) {
    this.canvas = byId(id, HTMLCanvasElement);
    this.series = series;
    this.range = range;
    const keys = series.length > 1 ? series.map((s, i) =>
      el("span", { class: `series ${s.name.toLowerCase()}` }, el("i", { class: `dash-${i}`, "aria-hidden": "true" }), s.name)) : [];
    byId(`${id}-legend`, HTMLElement).replaceChildren(el("b", {}, name), el("small", {}, unit), ...keys);
  }

  /** Draw samples; `now` is the stamp at the right edge, s. */
  draw(/** @type {Sample[]} */ samples, /** @type {number} */ now) {
    const { context: c, width, height } = prepareCanvas(this.canvas);
    const lines = this.series.map((s) => samples.map((sample) => s.read(sample)));
    const values = lines.flat().filter((v) => v !== null);
    const [left, bottom] = [44, height - 4];
    let high = Math.max(this.range.least, ...values) * 1.08;
    let low = 0;
    if (this.range.symmetric) {
      high = Math.max(high, -Math.min(0, ...values) * 1.08);
      low = -high;
    }
    const x = (/** @type {number} */ stamp) => left + (width - left) * (1 + (stamp - now) / SECONDS);
    const y = (/** @type {number} */ v) => bottom - ((v - low) / (high - low)) * (bottom - 6);
    c.font = "11px system-ui, sans-serif";
    c.textAlign = "right";
    c.textBaseline = "middle";
    let above = Infinity; // of the last number
    for (const tick of ticks(low, high, Math.min(4, Math.max(1, height / 26)))) {
      if (this.range.whole && !Number.isInteger(tick)) continue;
      [c.strokeStyle, c.fillStyle, c.lineWidth] = [colour("--line"), colour("--muted"), 1];
      c.beginPath();
      c.moveTo(left, y(tick));
      c.lineTo(width, y(tick));
      c.stroke();
      if (above - y(tick) < NUMBER_HEIGHT) continue;
      above = y(tick);
      c.fillText(String(Number(tick.toPrecision(3))).replace("-", "−"), left - 6, above);
    }
    c.save();
    c.beginPath();
    c.rect(left, 0, width - left, height);
    c.clip();
    c.lineWidth = 1.6;
    c.lineJoin = "round";
    this.series.forEach((series, i) => {
      const line = lines[i] ?? [];
      c.fillStyle = c.strokeStyle = colour(series.colour);
      const { sigma } = series;
      if (sigma) this.#band(c, samples.map((sample, k) => {
        const [value, s] = [line[k] ?? null, sigma(sample)];
        return value === null || s === null ? null : [x(sample.stamp), value, BAND * s];
      }), y);
      c.setLineDash(series.dash);
      c.beginPath();
      let pen = false;
      samples.forEach((sample, k) => {
        const value = line[k] ?? null;
        if (value !== null) c[pen ? "lineTo" : "moveTo"](x(sample.stamp), y(value));
        pen = value !== null;
      });
      c.stroke();
      c.setLineDash([]);
    });
    c.restore();
  }

  /** Fill the band about a line; each value is a place across, a value and half the band's width there, or null in a gap. */
  #band(/** @type {CanvasRenderingContext2D} */ c, /** @type {([number, number, number] | null)[]} */ values, /** @type {(value: number) => number} */ y) {
    c.globalAlpha = 0.25;
    let run = /** @type {[number, number, number][]} */ ([]);
    const flush = () => {
      c.beginPath();
      for (const [at, value, half] of run) c.lineTo(at, y(value + half));
      for (const [at, value, half] of run.reverse()) c.lineTo(at, y(value - half));
      c.fill();
      run = [];
    };
    for (const value of [...values, null]) {
      if (value) run.push(value);
      else flush();
    }
    c.globalAlpha = 1;
  }
}

/** @param {(sample: Sample, axis: number) => number | null} read */
const three = (read) => AXES.map((name, i) =>
  ({ name, colour: `--${name.toLowerCase()}`, dash: DASHES[i] ?? [], read: (/** @type {Sample} */ s) => read(s, i) }));

/** @type {(name: string, read: Read) => Series[]} */
const one = (name, read) => [{ name, colour: "--accent", dash: [], read }];

const discs = () => new Plot("discs", "Points", "used", one("discs", (s) => s.discs), { least: 4, whole: true });

export class Plots {
  /** @type {Sample[]} */ #samples = [];
  /** @type {{stamp: number, at: number}} */ #newest = { stamp: 0, at: 0 };
  #names = "";
  #balls = byId("ball", HTMLSelectElement);
  #choice = byId("ball-choice", HTMLElement);
  #readings = byId("readings", HTMLElement);
  #plots;

  constructor() {
    const degrees = (/** @type {number | undefined} */ v) => (v === undefined ? null : v * DEGREES);
    const rate = three((s, i) => degrees(s.rate?.[i])).map((s, i) =>
      ({ ...s, sigma: (/** @type {Sample} */ sample) => degrees(sample.sigma?.[i]) }));
    this.#plots = [
      new Plot("rate", "Rate", `°/s, band ${BAND} σ`, rate, { least: 10, symmetric: true }),
      new Plot("counts", "Counts", "a frame", three((s, i) => s.counts[i] ?? null), { least: 5, symmetric: true }),
      new Plot("latency", "Latency", "ms", one("latency", (s) => (s.latency === null ? null : 1000 * s.latency)), { least: 5 }),
      discs(),
    ];
    this.#balls.addEventListener("change", () => this.draw());
    new ResizeObserver(() => this.draw()).observe(byId("rate", HTMLCanvasElement));
  }

  /** @param {string[] | null} names of balls in a hand */
  load(names) {
    if (JSON.stringify(names) === this.#names) return;
    this.#names = JSON.stringify(names);
    this.#samples = [];
    this.#plots[3] = names ? new Plot("discs", "Position", "m", three((s, i) => s.position?.[i] ?? null), { least: 0.5, symmetric: true }) : discs();
    this.#choice.hidden = (names?.length ?? 0) < 2;
    this.#balls.replaceChildren(...(names ?? ["ball"]).map((name, i) => el("option", { value: String(i + 1) }, name)));
  }

  /** @param {Sample[]} samples */
  take(samples) {
    const last = samples.at(-1);
    if (last) {
      if (last.stamp < this.#newest.stamp) this.#samples = []; // the source began again
      this.#newest = { stamp: last.stamp, at: performance.now() };
      this.#samples.push(...samples);
    }
    this.#samples = this.#samples.filter((s) => s.stamp > this.#newest.stamp - SECONDS - 1);
    this.draw();
  }

  draw() {
    const ball = Number(this.#balls.value || 1);
    const now = this.#newest.stamp + (performance.now() - this.#newest.at) / 1000;
    const samples = this.#samples.filter((s) => s.ball === ball);
    for (const plot of this.#plots) plot.draw(samples, now);
    this.last = samples.at(-1) ?? null;
  }

  /** @param {import("./types.js").Status | null} status */
  read(status) {
    const { rate = null, sigma = null } = this.last ?? {};
    /** @type {[name: string, value: string, width?: "two" | "three" | "all"][]} columns that a reading takes */
    const rows = AXES.map((name, i) => [name, rate ? `${formatSigned((rate[i] ?? 0) * DEGREES)} °/s` : "–"]);
    rows.push(["σ", sigma ? `${(Math.max(...sigma) * DEGREES).toFixed(2)} °/s` : "–"]);
    if (status) {
      rows.push(["frames", `${(status.fps ?? 0).toFixed(1)} /s`], ["latency", formatLatency(status.latency_ms), "two"], ["counts", status.counts?.map((/** @type {number} */ v) => formatSigned(v, 0)).join(", ") ?? "–", "three"]);
      if (!status.balls) rows.push(["points", `${status.discs ?? "–"} used, ${status.discs_seen ?? "–"} seen, ${status.discs_known ?? "–"} known`, "three"]);
      const ball = status.balls?.[Number(this.#balls.value || 1) - 1];
      if (ball) rows.push([ball.name ?? "ball", ballText(ball), "all"]);
      rows.push(["motion", status.motion?.words ?? "not known", "all"]);
    }
    const known = new Map([...this.#readings.children].map((row) => [row.firstElementChild?.textContent, row.lastElementChild]));
    if (rows.length === known.size && rows.every(([name]) => known.has(name)))
      for (const [name, value] of rows) setText(/** @type {HTMLElement} */ (known.get(name)), value);
    else this.#readings.replaceChildren(...rows.map(([name, value, width = ""]) => el("div", { class: width }, el("dt", {}, name), el("dd", {}, value))));
  }
}

/** @param {Record<string, any>} ball of the status */
function ballText({ state, position_m: place, angles_deg: angles, sigma_mm: sigma, sigma_deg: turned }) {
  if (!place || !angles) return state ?? "not known";
  const [x, y, z] = place.map((/** @type {number} */ v) => formatSigned(v, 3));
  const [yaw, pitch, roll] = angles.map((/** @type {number} */ v) => formatSigned(v, 0));
  const error = sigma && turned ? ` ± ${Math.max(...sigma).toFixed(0)} mm, ± ${Math.max(...turned).toFixed(1)}°` : "";
  return `${state}: x ${x}, y ${y}, z ${z} m; yaw ${yaw}°, pitch ${pitch}°, roll ${roll}°${error}`;
}
