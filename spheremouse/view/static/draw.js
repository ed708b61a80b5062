/** Draw on the picture: rectangles and polygons without discs, and colours of targets and discs. */

import { el, setText } from "./dom.js";
import { control } from "./controls.js";

/** @typedef {import("./types.js").Mask} Mask */
/** @typedef {import("./types.js").Point} Point */
/** @typedef {import("./settings.js").Settings} Settings */
/** @typedef {import("./picture.js").Picture} Picture */
/** @typedef {{hint: string, take: (rgb: [number, number, number], at: Point) => unknown}} Pick true from `take`: once more */

const MASKS = "discs.masks";
const WEIGHTS = "discs.weights";
const POLARITY = "discs.polarity";
const RECTANGLE = [[0, 1], [2, 1], [2, 3], [0, 3]]; // edges at the corners
const EDGES = ["left", "top", "right", "bottom"];
const TARGETS = ["rings.cyan", "rings.magenta", "rings.yellow"];
const LIMITS = ["rings.saturation", "rings.value"];
const HUE_HALF_WIDTH = 27; // OpenCV hue, up to halfway to the other two colours
const GRIP_RADIUS = 9; // screen pixels about a corner
const MIN_SIDE = 3; // px of a rectangle

/** Return OpenCV's hue, 0 to 180, and saturation, 0 to 255. */
export function hue(/** @type {[number, number, number]} */ [r, g, b]) {
  const [high, low] = [Math.max(r, g, b), Math.min(r, g, b)];
  const range = high - low || 1;
  const sixth = high === r ? (g - b) / range : high === g ? 2 + (b - r) / range : 4 + (r - g) / range;
  return { hue: Math.round(30 * ((sixth + 6) % 6)), saturation: Math.round((255 * (high - low)) / (high || 1)) };
}

export class DrawPanel {
  /** @type {Mask[]} */ #masks = [];
  /** @type {number[]} */ #draft = []; // corners of a polygon that is being drawn
  #chosen = -1;
  #active = false;
  /** @type {Pick | null} */ #pick = null;
  /** @type {Point} */ #cross = [0, 0];
  /** @type {{from: Point, edges: number[], start: Mask} | null} */ #drag = null;
  /** @type {(() => void)[]} */ #shows = [];
  #list = el("ol", { class: "masks" });
  #add = el("button", { type: "button", id: "add-mask", click: () => this.#insert() }, "Add rectangle");
  #polygon = this.#picker("Draw polygon", [{ hint: "Click the corners one after another, and the last one twice.", take: (_, at) => this.#corner(at) }]);
  #hint = el("p", { class: "hint", role: "status" });
  #none = el("p", { class: "help" }, "These regions need a service that tracks a ball in its frame.");
  #colours = el("div", {});
  element = el("div", {}, this.#hint,
    el("h3", {}, "Regions without discs"),
    el("p", { class: "help" }, "The tracker looks for no disc in these places: buttons, screws, reflections."),
    el("p", { class: "help" }, "Pointer: drag on the picture to add a rectangle, drag a place to move it, drag a corner to change it."),
    el("p", { class: "help" }, "Keys, with the picture in focus: arrows move it, Shift and arrows resize it, Page Down chooses " +
      "the next one, Delete removes it."),
    this.#list, el("div", { class: "row" }, this.#add, this.#polygon), this.#none, this.#colours);
  #settings;
  #picture;

  constructor(/** @type {Settings} */ settings, /** @type {Picture} */ picture) {
    this.#settings = settings;
    this.#picture = picture;
    picture.painters.push((c, view) => this.#paint(c, view.scale));
    const { canvas } = picture;
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => this.#up());
    canvas.addEventListener("keydown", (event) => this.#key(event));
    settings.listen(() => this.#show());
    this.#allow();
  }

  /** Allow masks if the tracker has them. */
  #allow() {
    this.#add.disabled = this.#polygon.disabled = !this.#settings.all.has(MASKS);
    this.#none.hidden = !this.#add.disabled;
  }

  load() {
    const make = (/** @type {string} */ key) => {
      const setting = this.#settings.all.get(key);
      return setting ? [control(setting, this.#settings, "draw")] : [];
    };
    const targets = TARGETS.flatMap((key) => make(key).map((c) => ({ key, ...c })));
    /** @type {(() => void)[]} */
    const bars = [];
    for (const { key, element } of targets) {
      const name = key.split(".")[1] ?? "";
      const take = (/** @type {unknown} */ _, /** @type {Point} */ place) => {
        const at = hue(this.#picture.sampleOnWhite(place) ?? [0, 0, 0]).hue;
        this.#settings.change(key, [Math.max(0, at - HUE_HALF_WIDTH), Math.min(180, at + HUE_HALF_WIDTH)]);
      };
      const pick = this.#picker(`Pick ${name}`, [{ hint: `Click the ${name} ring of a target in the picture.`, take }]);
      const bar = el("i", { class: "hues", "aria-hidden": "true" });
      element.append(el("div", { class: "row" }, bar, pick));
      bars.push(() => {
        const [from = 0, to = 0] = /** @type {number[]} */ (this.#settings.value(key) ?? []);
        bar.style.setProperty("--from", `${from / 1.8}%`);
        bar.style.setProperty("--to", `${100 - to / 1.8}%`);
      });
    }
    const limits = LIMITS.flatMap(make);
    const discs = [POLARITY, WEIGHTS].flatMap(make);
    this.#shows = [...bars, ...[...targets, ...limits, ...discs].map((c) => c.show)];
    this.#colours.replaceChildren(
      ...(targets.length ? [el("h3", {}, "Colours of the targets"), ...[...targets, ...limits].map((c) => c.element)] : []),
      ...(discs.length ? [el("h3", {}, "Colours of the discs"), ...discs.map((c) => c.element)] : []));
    if (this.#settings.all.has(WEIGHTS)) this.#colours.append(el("div", { class: "row" }, this.#discPicker()));
    this.#allow();
    this.#show();
  }

  /** @param {boolean} active */
  activate(active) {
    this.#active = active;
    [this.#pick, this.#draft] = [null, []];
    const { canvas } = this.#picture;
    canvas.classList.toggle("drawing", active);
    if (active) canvas.tabIndex = 0;
    else canvas.removeAttribute("tabindex");
    this.#refresh();
  }

  #picker(/** @type {string} */ words, /** @type {Pick[]} */ steps) {
    /** @type {(steps: Pick[]) => void} */
    const choose = ([step, ...rest]) => {
      this.#pick = step ? { hint: step.hint, take: (rgb, at) => step.take(rgb, at) === true || choose(rest) } : null;
    };
    const begin = () => {
      choose(steps);
      [this.#draft, this.#cross] = [[], [this.#picture.view.width / 2, this.#picture.view.height / 2]];
      this.#picture.canvas.focus();
      this.#refresh();
    };
    return el("button", { type: "button", click: begin }, words);
  }

  #discPicker() {
    /** @type {[number, number, number]} */
    let disc = [0, 0, 0];
    return this.#picker("Pick disc and ball", [
      { hint: "Click a disc in the picture.", take: (rgb) => (disc = rgb) },
      { hint: "Now click the ball beside it.", take: (ball) => {
        const difference = [2, 1, 0].map((i) => (ball[i] ?? 0) - (disc[i] ?? 0)); // blue, green, red
        const largest = Math.max(...difference.map(Math.abs)) || 1;
        this.#settings.change(WEIGHTS, difference.map((d) => Math.round((100 * d) / largest) / 100));
      } },
    ]);
  }

  // ---- rectangles ----

  /** @param {number} chosen */
  #send(chosen) {
    this.#chosen = chosen;
    this.#settings.change(MASKS, this.#masks.map((m) => m.map(Math.round)));
  }

  #insert() {
    const { width, height } = this.#picture.view;
    const [w, h] = [width / 10, height / 10].map(Math.round);
    const [x, y] = [(width - (w ?? 0)) / 2, (height - (h ?? 0)) / 2].map(Math.round);
    this.#settings.release();
    this.#masks.push([x ?? 0, y ?? 0, (x ?? 0) + (w ?? 0), (y ?? 0) + (h ?? 0)]);
    this.#send(this.#masks.length - 1);
  }

  /** @param {Point} at of a polygon; the last one again ends it. Returns true if there are more. */
  #corner(at) {
    const [x = NaN, y = NaN] = this.#draft.slice(-2);
    const again = Math.hypot(at[0] - x, at[1] - y) <= GRIP_RADIUS / this.#picture.view.scale;
    if (!again) this.#draft.push(...at.map(Math.round));
    if (!again || this.#draft.length < 6) return true;
    this.#settings.release();
    this.#masks.push(this.#draft);
    this.#draft = [];
    this.#send(this.#masks.length - 1);
    return false;
  }

  /** @param {number} index */
  #remove(index) {
    this.#settings.release();
    this.#masks.splice(index, 1);
    this.#send(Math.min(index, this.#masks.length - 1));
  }

  /** @param {PointerEvent} event */
  #down(event) {
    if (!this.#active) return;
    const at = this.#picture.locate(event);
    if (this.#pick) {
      this.#take(at);
      return;
    }
    if (!this.#settings.all.has(MASKS)) return;
    this.#settings.hold();
    this.#picture.canvas.setPointerCapture(event.pointerId);
    const grip = GRIP_RADIUS / this.#picture.view.scale;
    for (const [i, mask] of this.#masks.entries()) {
      const places = corners(mask);
      const corner = places.findIndex(([x, y]) => Math.abs(at[0] - x) <= grip && Math.abs(at[1] - y) <= grip);
      const edges = corner < 0 ? [...mask.keys()] : mask.length > 4 ? [2 * corner, 2 * corner + 1] : RECTANGLE[corner] ?? [];
      if (corner < 0 && !contains(places, at)) continue;
      this.#chosen = i;
      this.#drag = { from: at, edges, start: [...mask] };
      return;
    }
    this.#masks.push([at[0], at[1], at[0], at[1]]);
    this.#chosen = this.#masks.length - 1;
    this.#drag = { from: at, edges: [2, 3], start: [at[0], at[1], at[0], at[1]] };
  }

  /** @param {PointerEvent} event */
  #move(event) {
    if (!this.#drag) return;
    const at = this.#picture.locate(event);
    const { from, edges, start } = this.#drag;
    this.#masks[this.#chosen] = ordered(start.map((v, e) => (edges.includes(e) ? v + (at[e % 2] ?? 0) - (from[e % 2] ?? 0) : v)));
    this.#refresh();
  }

  #up() {
    if (!this.#drag) return;
    this.#drag = null;
    this.#masks = this.#masks.filter(isLarge);
    if (JSON.stringify(this.#masks.map((m) => m.map(Math.round))) !== JSON.stringify(this.#settings.value(MASKS)))
      this.#send(Math.min(this.#chosen, this.#masks.length - 1));
    this.#refresh();
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (!this.#active) return;
    const arrows = /** @type {Record<string, Point>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] });
    const arrow = arrows[event.key];
    const mask = this.#masks[this.#chosen];
    if (this.#pick && arrow) this.#cross = [this.#cross[0] + 4 * arrow[0], this.#cross[1] + 4 * arrow[1]];
    else if (this.#pick && (event.key === "Enter" || event.key === " ")) this.#take(this.#cross);
    else if (this.#pick && event.key === "Escape") [this.#pick, this.#draft] = [null, []];
    else if (arrow && mask) {
      const step = event.ctrlKey ? 20 : 4;
      const first = event.shiftKey ? mask.length - 2 : 0;
      const moved = mask.map((v, e) => (e >= first ? v + step * (arrow[e % 2] ?? 0) : v));
      if (isLarge(moved)) this.#masks[this.#chosen] = moved;
      this.#send(this.#chosen);
    } else if (event.key === "Delete" && mask) this.#remove(this.#chosen);
    else if (event.key === "PageDown" && this.#masks.length) this.#chosen = (this.#chosen + 1) % this.#masks.length;
    else return;
    event.preventDefault();
    this.#refresh();
  }

  /** @param {Point} at */
  #take(at) {
    const rgb = this.#picture.sample(at);
    if (rgb) this.#pick?.take(rgb, at);
    this.#refresh();
  }

  #show() {
    for (const show of this.#shows) show();
    if (this.#drag) return;
    const value = this.#settings.value(MASKS);
    if (!this.#list.contains(document.activeElement) || (Array.isArray(value) && value.length !== this.#masks.length)) {
      this.#masks = Array.isArray(value) ? value.map((m) => [...m]) : [];
      this.#list.replaceChildren(...this.#masks.map((mask, i) => this.#row(mask, i)));
    }
    this.#refresh();
  }

  #row(/** @type {Mask} */ mask, /** @type {number} */ i) {
    const fields = mask.map((v, e) => el("label", {}, mask.length > 4 ? `${"xy"[e % 2]} ${(e >> 1) + 1}` : EDGES[e] ?? "", el("input", {
      type: "number", value: Math.round(v), step: 1,
      focus: () => this.#choose(i),
      change: (event) => {
        mask[e] = Number(event.target.value);
        this.#masks[i] = ordered(mask);
        this.#send(i);
      },
    })));
    return el("li", {}, ...fields, el("button", { type: "button", class: "quiet", "aria-label": `Remove place ${i + 1}`,
      click: () => this.#remove(i) }, "Remove"));
  }

  /** @param {number} index */
  #choose(index) {
    this.#chosen = index;
    this.#refresh();
  }

  #refresh() {
    const idle = this.#settings.refused.get(MASKS) ?? "";
    setText(this.#hint, this.#pick ? `${this.#pick.hint} Or move the cross with arrow keys and press Enter; Escape ends it.` : idle);
    this.#picture.draw();
  }

  #paint(/** @type {CanvasRenderingContext2D} */ c, /** @type {number} */ s) {
    if (!this.#active) return;
    for (const [i, places] of [...this.#masks.map(corners), pairs(this.#draft)].entries()) {
      const chosen = i === this.#chosen || i === this.#masks.length;
      c.beginPath();
      for (const [x, y] of places) c.lineTo(x * s, y * s);
      c.closePath();
      c.fillStyle = chosen ? "rgba(255, 157, 46, .35)" : "rgba(255, 157, 46, .2)";
      c.fill();
      [c.fillStyle, c.strokeStyle, c.lineWidth] = ["#ffb764", "#ffb764", chosen ? 2.5 : 1.5];
      c.stroke();
      if (chosen) for (const [x, y] of places) c.fillRect(x * s - 4, y * s - 4, 8, 8);
    }
    if (!this.#pick) return;
    const [x, y] = [this.#cross[0] * s, this.#cross[1] * s];
    for (const [line, width] of /** @type {[string, number][]} */ ([["#000", 4], ["#fff", 1.5]])) {
      [c.strokeStyle, c.lineWidth] = [line, width];
      c.beginPath();
      c.moveTo(x - 14, y);
      c.lineTo(x + 14, y);
      c.moveTo(x, y - 14);
      c.lineTo(x, y + 14);
      c.stroke();
    }
  }
}

/** Return a mask; of a rectangle, left is before right, and top before bottom. */
function ordered(/** @type {Mask} */ mask) {
  const [a = 0, b = 0, c = 0, d = 0] = mask;
  return mask.length > 4 ? mask : [Math.min(a, c), Math.min(b, d), Math.max(a, c), Math.max(b, d)];
}

const isLarge = (/** @type {Mask} */ [a = 0, b = 0, c = 0, d = 0, ...more]) => more.length > 0 || (c - a >= MIN_SIDE && d - b >= MIN_SIDE);

/** @type {(flat: number[]) => Point[]} */
const pairs = (flat) => flat.flatMap((x, e) => (e % 2 ? [] : [[x, flat[e + 1] ?? 0]]));

/** @param {Mask} mask */
function corners(mask) {
  const [a = 0, b = 0, c = 0, d = 0] = mask;
  return pairs(mask.length > 4 ? mask : [a, b, c, b, c, d, a, d]);
}

/** Return if a polygon contains a point: a ray from it crosses an odd number of sides. */
function contains(/** @type {Point[]} */ places, /** @type {Point} */ [x, y]) {
  const crossed = places.filter(([ax, ay], i) => {
    const [bx, by] = places[(i + 1) % places.length] ?? [0, 0];
    return ay > y !== by > y && x < ax + ((y - ay) / (by - ay)) * (bx - ax);
  });
  return crossed.length % 2 === 1;
}
