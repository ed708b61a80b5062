/** The picture of the camera, and layers over it. */

import { prepareCanvas, colour, el } from "./dom.js";

/** @typedef {import("./types.js").Annotations} Annotations */
/** @typedef {import("./types.js").Point} Point */
/** @typedef {import("./types.js").Shape} Shape */
/** @typedef {import("./types.js").Frame} Frame */
/** @typedef {{x: number, y: number, scale: number, width: number, height: number}} View place of the picture on the canvas */
/** @typedef {(context: CanvasRenderingContext2D, view: View) => void} Painter */

const TRAIL = 15; // pictures: a second
const PAPER_SHARE = 0.1; // of the picture's width, in which a target shows paper, as `rings.py` has it
const HALO = "rgba(0, 0, 0, .6)"; // keeps a line legible on a bright ball
/** @type {[name: string, label: string, shown: boolean][]} */
const LAYERS = [
  ["contours", "contours", true], ["predicted", "predictions", true], ["targets", "targets", true],
  ["trails", "trails", false], ["masked", "masked", false],
];

export class Picture {
  /** @type {Painter[]} */ painters = [];
  /** @type {View} */ view = { x: 0, y: 0, scale: 1, width: 640, height: 480 };
  /** @type {ImageBitmap | null} */ #bitmap = null;
  /** @type {Annotations} */ #annotations = {};
  /** @type {Point[][]} */ #trail = [];
  /** @type {Map<string, HTMLInputElement>} */ #shown = new Map();

  constructor(/** @type {HTMLCanvasElement} */ canvas, /** @type {HTMLElement} */ layers) {
    this.canvas = canvas;
    for (const [name, label, shown] of LAYERS) {
      const box = el("input", { type: "checkbox", id: `layer-${name}`, checked: shown, change: () => this.draw() });
      this.#shown.set(name, box);
      layers.append(el("label", { class: "check" }, box, el("i", { class: `key ${name}`, "aria-hidden": "true" }), label));
    }
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  /** Take a frame; without a picture the last one stays. */
  take(/** @type {Frame} */ frame, /** @type {ImageBitmap | null} */ bitmap) {
    const { width, height } = frame;
    if (!bitmap || !width || !height) return;
    this.#bitmap?.close();
    this.#bitmap = bitmap;
    this.#annotations = frame.annotations ?? {};
    [this.view.width, this.view.height] = [width, height];
    const used = this.#annotations.detected?.filter((d) => d.used) ?? [];
    this.#trail = [...this.#trail.slice(1 - TRAIL), used.map((d) => /** @type {Point} */ ([d.x, d.y]))];
    this.canvas.style.setProperty("--ratio", `${width} / ${height}`);
    this.draw();
  }

  /** Return the place of a pointer in the picture, px. @type {(event: PointerEvent) => Point} */
  locate(event) {
    const box = this.canvas.getBoundingClientRect();
    const { x, y, scale } = this.view;
    return [(event.clientX - box.left - x) / scale - 0.5, (event.clientY - box.top - y) / scale - 0.5];
  }

  /** Return the mean colour of 5 x 5 px of the picture; null without a picture. @type {(at: Point) => [red: number, green: number, blue: number] | null} */
  sample(at) {
    const data = this.#pixels(at, 5);
    const mean = (/** @type {number} */ c) => data.reduce((sum, v, i) => (i % 4 === c ? sum + v : sum), 0) / 25;
    return data.length ? [mean(0), mean(1), mean(2)] : null;
  }

  /** Return that colour under light that makes paper white, as targets are detected: each channel over its greatest value nearby. @type {(at: Point) => [red: number, green: number, blue: number] | null} */
  sampleOnWhite(at) {
    const rgb = this.sample(at), data = this.#pixels(at, Math.round(PAPER_SHARE * (this.#bitmap?.width ?? 0)));
    const paper = (/** @type {number} */ c) => data.reduce((most, v, i) => (i % 4 === c ? Math.max(most, v) : most), 1);
    return rgb && [(255 * rgb[0]) / paper(0), (255 * rgb[1]) / paper(1), (255 * rgb[2]) / paper(2)];
  }

  /** Return the red, green, blue and alpha of a square of `size` px about a place; empty without a picture. @type {(at: Point, size: number) => Uint8ClampedArray} */
  #pixels([x, y], size) {
    const context = size > 0 ? new OffscreenCanvas(size, size).getContext("2d") : null;
    if (!this.#bitmap || !context) return new Uint8ClampedArray();
    const scale = this.#bitmap.width / this.view.width, half = Math.floor(size / 2);
    context.drawImage(this.#bitmap, half - Math.round(x * scale), half - Math.round(y * scale));
    return context.getImageData(0, 0, size, size).data;
  }

  draw() {
    this.#paint(this.canvas, this.view, (name) => this.#shown.get(name)?.checked ?? false, this.painters);
  }

  /** Draw the picture with some layers on another canvas. Returns the number of what they show, in words. */
  copy(/** @type {HTMLCanvasElement} */ canvas, /** @type {string[]} */ layers) {
    canvas.style.aspectRatio = `${this.view.width} / ${this.view.height}`;
    this.#paint(canvas, { ...this.view }, (name) => layers.includes(name), []);
    const { detected = [], targets = [] } = this.#annotations;
    return layers.includes("targets") ? `${targets.length} targets` : `${detected.filter((d) => d.used).length} of ${detected.length} contours used`;
  }

  /** @type {(canvas: HTMLCanvasElement, view: View, on: (name: string) => boolean, painters: Painter[]) => void} */
  #paint(canvas, view, on, painters) {
    const { context: c, width, height } = prepareCanvas(canvas);
    view.scale = Math.min(width / view.width, height / view.height);
    view.x = (width - view.width * view.scale) / 2;
    view.y = (height - view.height * view.scale) / 2;
    c.save();
    c.beginPath();
    c.roundRect(view.x, view.y, view.width * view.scale, view.height * view.scale, 6);
    c.fillStyle = colour("--empty");
    c.fill();
    c.clip();
    if (this.#bitmap) c.drawImage(this.#bitmap, view.x, view.y, view.width * view.scale, view.height * view.scale);
    c.translate(view.x + view.scale / 2, view.y + view.scale / 2); // pixel (0, 0) is the centre of the first pixel
    if (this.#bitmap) this.#layers(c, view.scale, on);
    for (const paint of painters) paint(c, view);
    c.restore();
  }

  /** Draw layers; `s` are the screen pixels in a pixel. @type {(c: CanvasRenderingContext2D, s: number, on: (name: string) => boolean) => void} */
  #layers(c, s, on) {
    const { outline, others, detected, predicted, targets, masked, strangers } = this.#annotations;
    for (const points of on("contours") ? [outline ?? [], ...(others ?? [])] : []) {
      c.beginPath();
      for (const [x, y] of points) c.lineTo(x * s, y * s);
      strokeWithHalo(c, "#8fd3ff", 1.2);
    }
    if (on("trails")) this.#trails(c, s);
    if (on("predicted"))
      for (const p of predicted ?? []) {
        if (p.gate && Math.max(p.gate[0], p.gate[2]) < (this.view.width / 4) ** 2) ellipse(c, p.x, p.y, p.gate, s, "#ff9d94", 1, [3, 3]);
        ellipse(c, p.x, p.y, p.shape, s, "#ff5a4f", 1.5);
      }
    if (on("contours"))
      for (const d of detected ?? []) ellipse(c, d.x, d.y, d.shape, s, d.used ? "#ffffff" : "#ffd24a", 1.5, d.used ? [] : [2, 2]);
    if (on("targets")) {
      for (const t of targets ?? []) {
        if (t.shape) ellipse(c, t.x, t.y, t.shape, s, "#5ee06e", 1.5);
        label(c, t.code, t.x * s + 9, t.y * s - 7, "#8df29a");
      }
      for (const t of strangers ?? []) {
        const square = Math.max(5 / s, t.radius) ** 2;
        ellipse(c, t.x, t.y, [square, 0, square], s, "#ff9d2e", 1.5, [4, 3]);
        label(c, `${t.code} ?`, t.x * s + 9, t.y * s - 7, "#ffb764");
      }
    }
    if (on("masked")) for (const [x, y] of masked ?? []) cross(c, x * s, y * s, "#ff9d2e");
  }

  #trails(/** @type {CanvasRenderingContext2D} */ c, /** @type {number} */ s) {
    this.#trail.forEach((points, age) => {
      c.fillStyle = `rgba(120, 220, 255, ${(age + 1) / this.#trail.length})`;
      for (const [x, y] of points) {
        c.beginPath();
        c.arc(x * s, y * s, 1.6, 0, 2 * Math.PI);
        c.fill();
      }
    });
  }
}

/** Draw the current path with a dark edge. @type {(c: CanvasRenderingContext2D, line: string, width: number, dash?: number[]) => void} */
function strokeWithHalo(c, line, width, dash = []) {
  c.setLineDash(dash);
  [c.strokeStyle, c.lineWidth] = [HALO, width + 1.6];
  c.stroke();
  [c.strokeStyle, c.lineWidth] = [line, width];
  c.stroke();
  c.setLineDash([]);
}

/**
 * Draw the ellipse (p - c)' S^-1 (p - c) = 1 with S = [[xx, xy], [xy, yy]], px².
 * @param {CanvasRenderingContext2D} c
 * @param {number} x
 * @param {number} y
 * @param {Shape} shape
 * @param {number} s
 * @param {string} line
 * @param {number} width
 * @param {number[]} [dash]
 */
function ellipse(c, x, y, [xx, xy, yy], s, line, width, dash) {
  const mean = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, xy);
  const [long, short] = [Math.sqrt(mean + spread), Math.sqrt(Math.max(0, mean - spread))]; // of the eigenvalues
  const angle = Math.atan2(2 * xy, xx - yy) / 2; // of the long axis
  c.beginPath();
  c.ellipse(x * s, y * s, s * long, s * short, angle, 0, 2 * Math.PI);
  strokeWithHalo(c, line, width, dash);
}

/** @type {(c: CanvasRenderingContext2D, x: number, y: number, line: string) => void} */
function cross(c, x, y, line) {
  c.beginPath();
  for (const d of [4, -4]) {
    c.moveTo(x - 4, y - d);
    c.lineTo(x + 4, y + d);
  }
  strokeWithHalo(c, line, 1.5);
}

/** @type {(c: CanvasRenderingContext2D, text: string, x: number, y: number, fill: string) => void} */
function label(c, text, x, y, fill) {
  c.font = "600 11px system-ui, sans-serif";
  c.lineJoin = "round";
  [c.lineWidth, c.strokeStyle, c.fillStyle] = [3, "rgba(0, 0, 0, .75)", fill];
  c.strokeText(text, x, y);
  c.fillText(text, x, y);
}
