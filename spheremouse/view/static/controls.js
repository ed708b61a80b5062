/** A control for a setting: name, number, slider, range, default and effect. */

import { el, formatNumber, valueText, setText, withCode } from "./dom.js";

/** @typedef {import("./types.js").Setting} Setting */
/** @typedef {import("./types.js").Value} Value */
/** @typedef {import("./settings.js").Settings} Settings */

const STEPS = 200; // positions of a slider, at most
const MIN_LOG_RATIO = 1000; // a wider range has a logarithmic slider
const LOG_REACH = 20; // a logarithmic slider reaches this factor below and above the default; the number takes all values
const MAX_UNIT_LENGTH = 10; // characters; a longer one is in the help alone
const MAX_LINEAR_RANGE = 1e5; // of a range from 0 that a linear slider still resolves

/**
 * Return the name of a setting for people: "motion.scale_x" is "Scale x", "wand.pointing.by" is "Pointing by".
 * @param {string} key
 */
export function title(key) {
  const words = key.split(".").slice(key.startsWith("wand.") ? 1 : -1).join(" ").replaceAll("_", " ").replace(/ s$/, "").replace(/ per /, " per ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}

/** Return the value that was typed; a text that is none stays a text, which the daemon refuses in words. @type {(setting: Setting, text: string) => Value} */
export function parse(setting, text) {
  const typed = text.trim();
  if (typed === "") return setting.default === null || setting.type === "text" ? null : "";
  if (setting.type === "number" || setting.type === "integer") {
    const number = Number(/^[-+]?\d+,\d+$/.test(typed) ? typed.replace(",", ".") : typed.replace("−", "-"));
    return Number.isFinite(number) ? number : typed;
  }
  if (setting.type !== "list") return typed;
  try {
    return JSON.parse(typed);
  } catch {
    return typed;
  }
}

/**
 * Return the conversion between the position of a slider, 0 to 1, and a value; null if no slider suits the range.
 * @param {Setting} setting
 */
export function scale({ type, minimum, maximum, default: usual }) {
  if ((type !== "number" && type !== "integer") || minimum === null || maximum === null || !(maximum > minimum)) return null;
  const logarithmic = minimum > 0 && maximum / minimum >= MIN_LOG_RATIO;
  if (!logarithmic && maximum - minimum > MAX_LINEAR_RANGE) return null;
  const around = logarithmic && typeof usual === "number" && usual > 0;
  const low = around ? Math.max(minimum, usual / LOG_REACH) : minimum;
  const high = around ? Math.min(maximum, usual * LOG_REACH) : maximum;
  const unit = 10 ** Math.floor(Math.log10((high - low) / STEPS));
  return {
    steps: type === "integer" && !logarithmic ? Math.min(STEPS, high - low) : STEPS,
    /** @param {number} share 0 to 1 */
    value(share) {
      const raw = logarithmic ? low * (high / low) ** share : low + (high - low) * share;
      if (type === "integer") return Math.round(raw);
      const rounded = logarithmic ? Number(raw.toPrecision(2)) : Number((Math.round(raw / unit) * unit).toPrecision(6));
      return Math.min(maximum, Math.max(minimum, rounded));
    },
    /** @param {number} value */
    share(value) {
      const at = logarithmic ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
      return Math.min(1, Math.max(0, at));
    },
  };
}

/** @param {Setting} setting */
function range({ minimum, maximum, unit, choices, type }) {
  const words = unit && unit !== "-" ? ` ${unit}` : "";
  if (choices?.length || type === "flag") return "";
  if (minimum !== null && maximum !== null) return `${formatNumber(minimum)} to ${formatNumber(maximum)}${words}. `;
  return words ? `In${words}. ` : "";
}

/** @param {Setting} setting */
function defaultText(setting) {
  const text = setting.type === "flag" ? (setting.default ? "on" : "off") : valueText(setting.default);
  return `Default ${text === "" ? "not set" : text}.`;
}

/**
 * Return the element of a setting, and a function that shows its value. A field that has focus is not overwritten.
 * @param {Setting} setting
 * @param {Settings} settings
 * @param {string} prefix of ids
 */
export function control(setting, settings, prefix) {
  const { key } = setting;
  const id = `${prefix}-${key}`;
  const change = (/** @type {Value} */ value) => settings.change(key, value);
  const error = el("p", { class: "refused", id: `${id}-error`, role: "alert" });
  const meaning = (setting.meaning.charAt(0).toUpperCase() + setting.meaning.slice(1)).replace(/\.?$/, ". ");
  const help = el("p", { class: "help", id: `${id}-help` }, ...withCode(meaning),
    range(setting), defaultText(setting), setting.live || setting.meaning.includes("at the start only") ? "" : " Read at the start only.", " ", el("code", {}, key));
  const state = { id, "aria-describedby": `${id}-help ${id}-error` };
  const field = entry(setting, state, change);
  const conversion = scale(setting);
  const slider = conversion && el("input", {
    type: "range", min: 0, max: conversion.steps, class: "slider",
    "aria-label": `${title(key)}, slider`, "aria-describedby": `${id}-help`,
    pointerdown: () => settings.hold(),
    input() {
      const value = conversion.value(Number(slider?.value) / conversion.steps);
      setField(field, value);
      announce(value);
      change(value);
    },
  });
  const announce = (/** @type {Value} */ value) => {
    slider?.setAttribute("aria-valuetext", `${valueText(value)} ${setting.unit === "-" ? "" : setting.unit}`);
  };
  const mark = el("span", { class: "unsaved" });
  const reset = el("button", { type: "button", class: "quiet", click: () => change(setting.default),
    "aria-label": `Default of ${title(key)}`, title: "Back to the default" }, "Default");
  const unit = setting.unit === "-" || setting.unit.length > MAX_UNIT_LENGTH ? "" : setting.unit;
  const row = el("div", { class: `setting ${setting.type}`, "data-key": key },
    el("div", { class: "head" }, el("label", { for: id }, title(key)), mark, reset, field, el("span", { class: "unit" }, unit)),
    ...(slider ? [slider] : []), help, error);

  const inputs = slider ? [field, slider] : [field];
  const show = () => {
    const value = settings.value(key);
    const refused = settings.refused.get(key) ?? "";
    if (document.activeElement !== field && !refused) setField(field, value);
    if (slider && conversion) {
      slider.hidden = typeof value !== "number";
      if (document.activeElement !== slider && typeof value === "number") slider.value = String(conversion.share(value) * conversion.steps);
      announce(value);
    }
    setText(error, refused);
    for (const input of inputs) input.disabled = !setting.live || settings.locked;
    field.toggleAttribute("aria-invalid", refused !== "");
    setText(mark, settings.unsaved.has(key) ? "unsaved" : "");
    const names = setting.group === "" && setting.default === null; // a file or device, without which nothing runs
    reset.hidden = !setting.live || settings.locked || names || JSON.stringify(settings.all.get(key)?.value ?? null) === JSON.stringify(setting.default);
  };
  for (const input of inputs) input.addEventListener("blur", show);
  show();
  return { element: row, show };
}

function entry(/** @type {Setting} */ setting, /** @type {Record<string, string>} */ state, /** @type {(value: Value) => void} */ change) {
  if (setting.type === "flag")
    return el("input", { ...state, type: "checkbox", change: (event) => change(event.target.checked) });
  if (setting.choices?.length) {
    const given = setting.choices.map((choice) => el("option", { value: choice }, choice));
    const none = setting.default === null ? [el("option", { value: "" }, "not set")] : [];
    return el("select", { ...state, change: (event) => change(parse(setting, event.target.value)) }, ...none, ...given);
  }
  const numeric = setting.type === "number" || setting.type === "integer";
  return el("input", {
    ...state, type: "text", class: numeric ? "number" : "text", autocomplete: "off", spellcheck: "false",
    inputmode: numeric && (setting.minimum ?? -1) >= 0 ? "decimal" : "text",
    placeholder: setting.default === null ? "not set" : "",
    change: (event) => change(parse(setting, event.target.value)),
  });
}

function setField(/** @type {HTMLInputElement | HTMLSelectElement} */ field, /** @type {Value} */ value) {
  if (field instanceof HTMLInputElement && field.type === "checkbox") field.checked = value === true;
  else field.value = valueText(value);
}
