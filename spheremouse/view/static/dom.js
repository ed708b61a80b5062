/** Elements, numbers as text, and colours of the style sheet. */

/**
 * Return a new element. A function is a listener of the event of its name; a flag sets or omits its attribute.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {Record<string, string | number | boolean | ((event: any) => void)>} [attributes]
 * @param {...(Node | string)} children
 * @returns {HTMLElementTagNameMap[T]}
 */
export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(name, value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false) made.setAttribute(name, String(value));
  }
  made.append(...children);
  return made;
}

/** Return a table that scrolls; readers know it by `name`. @type {(name: string, head: string[], body: HTMLElement) => HTMLElement} */
export const table = (name, head, body) => el("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": name }, el("table", {},
  el("thead", {}, el("tr", {}, ...head.map((text) => el("th", { scope: "col" }, text)))), body));

/**
 * Return an element of the page by its id.
 * @template {HTMLElement} T
 * @param {string} id
 * @param {new () => T} type
 * @returns {T}
 */
export function byId(id, type) {
  const found = document.getElementById(id);
  if (!(found instanceof type)) throw new Error(`index.html: no ${type.name} with the id ${id}`);
  return found;
}

/** Write a text only if it differs, so that screen readers announce changes alone. */
export function setText(/** @type {HTMLElement} */ element, /** @type {string} */ text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Return the parts of a text; between backticks is code. @type {(text: string) => (HTMLElement | string)[]} */
export const withCode = (text) => text.split("`").map((part, i) => (i % 2 ? el("code", {}, part) : part));

/** Write a sentence with code as `setText` does. A first word begins with a capital letter unless it is a path or name. */
export function setSentence(/** @type {HTMLElement} */ element, /** @type {string} */ text) {
  const parts = withCode(text.replace(/^[a-z]+(?=[ ,]|$)/, (word) => word.charAt(0).toUpperCase() + word.slice(1)));
  if (element.textContent !== el("p", {}, ...parts).textContent) element.replaceChildren(...parts);
}

/** @type {Map<string, string>} */
const colours = new Map();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => colours.clear());

/** Return a colour of style.css, for example "--x". */
export function colour(/** @type {string} */ name) {
  let value = colours.get(name);
  if (value === undefined) {
    value = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    colours.set(name, value);
  }
  return value;
}

/** Match the canvas to its place on the screen. Returns its context in CSS pixels, cleared, with width and height. */
export function prepareCanvas(/** @type {HTMLCanvasElement} */ canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = devicePixelRatio || 1;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

/** Return a number with at most `digits` digits that count. */
export function formatNumber(/** @type {number} */ value, digits = 4) {
  return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(digits)));
}

/** Return a number with its sign and a fixed number of decimals. */
export function formatSigned(/** @type {number} */ value, decimals = 1) {
  const text = Math.abs(value).toFixed(decimals);
  return (value < 0 && Number(text) !== 0 ? "−" : "+") + text;
}

/** Return a duration in the largest two units, for example "3 min 20 s". */
export function formatDuration(/** @type {number} */ seconds) {
  const s = Math.floor(seconds);
  if (s < 60) return `${s} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${s % 60} s`;
  return `${Math.floor(s / 3600)} h ${Math.floor((s % 3600) / 60)} min`;
}

/** Return the quantiles of a latency of the status, ms. */
export function formatLatency(/** @type {{p50?: number, p99?: number} | null | undefined} */ latency) {
  const text = (/** @type {number} */ ms) => ms.toFixed(ms < 10 ? 1 : 0);
  return latency?.p50 === undefined ? "–" : `${text(latency.p50)} ms, 99 % ${text(latency.p99 ?? 0)} ms`;
}

/** Return the text of a value as it is typed. */
export function valueText(/** @type {any} */ value) {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return formatNumber(value, 12);
  return typeof value === "string" ? value : JSON.stringify(value).replaceAll(",", ", ");
}
