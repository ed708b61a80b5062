/** The page: state and buttons at the top, picture, space and plots, and the panels at the side. */

import { CalibrationPanel } from "./calibration.js";
import { byId, el, formatDuration, setSentence, setText } from "./dom.js";
import { DrawPanel } from "./draw.js";
import { GuidePanel } from "./guide.js";
import { Link } from "./link.js";
import { Picture } from "./picture.js";
import { Plots, readSample } from "./plots.js";
import { RecordingsPanel } from "./recordings.js";
import { DoctorPanel, LogPanel, OutputsPanel } from "./reports.js";
import { Settings } from "./settings.js";
import { Space } from "./space.js";
import { ExpertPanel, TunePanel } from "./tune.js";

/** @typedef {import("./types.js").Status} Status */

/** @type {Record<string, {word: string, look: string, advice: string}>} */
const STATES = {
  starting: { word: "starting", look: "wait", advice: "Wait a few seconds." },
  "no-camera": { word: "no camera", look: "bad", advice: "Check the camera's cable. The service opens the camera as soon as it is there." },
  "searching-targets": { word: "searching", look: "wait", advice: "The camera must see at least three targets. Clear its view, and add light." },
  tracking: { word: "tracking", look: "good", advice: "The pointer follows the ball." },
  lost: { word: "lost", look: "wait", advice: "Take hands and cloths off the ball, and light it evenly. If the camera was moved, estimate its pose again." },
  paused: { word: "paused", look: "wait", advice: "The pointer stands still. Press Resume." },
  "failed-output": { word: "no output", look: "bad", advice: "The ball is followed, but its motion is not sent. Open Outputs." },
};
const MESSAGE_MS = 12000;

let owner = true;
/** @type {Status | null} */
let status = null;
/** @type {number[]} */
const pictures = []; // times of the last ones, ms
let messageTimer = 0;
let refusal = ""; // of the page process, since the token is another one

const link = new Link({ message: receive, frame: draw, lost });
const settings = new Settings(link);
const camera = byId("camera", HTMLSelectElement); // of the picture, if there are two
const picture = new Picture(byId("picture", HTMLCanvasElement), byId("layers", HTMLElement));
const space = new Space(byId("space", HTMLCanvasElement), byId("space-note", HTMLElement), byId("views", HTMLElement));
const plots = new Plots();
const tune = new TunePanel(settings, perform, picture);
const expert = new ExpertPanel(settings, perform);
const log = new LogPanel();
const drawing = new DrawPanel(settings, picture);
const outputs = new OutputsPanel();
const doctor = new DoctorPanel(perform);
const guide = new GuidePanel(perform);
const calibration = new CalibrationPanel(perform);
const recordings = new RecordingsPanel(perform);

/**
 * Carry out an action and show its result. Returns null if it was refused.
 * @type {import("./tune.js").Act}
 */
async function perform(action, words = {}, progress = undefined) {
  try {
    const done = await link.request("do", { action, arguments: words }, progress);
    showMessage(/^\/[^:]*$/.test(done.message) ? `Written: ${done.message}` : done.message, false);
    return done;
  } catch (error) {
    showMessage(/** @type {Error} */ (error).message, true);
    return null;
  }
}

function showMessage(/** @type {string} */ text, /** @type {boolean} */ refused) {
  const line = byId("message", HTMLElement);
  clearTimeout(messageTimer);
  setSentence(byId("message-text", HTMLElement), text);
  line.classList.toggle("bad", refused);
  line.hidden = !text;
  if (!refused) messageTimer = setTimeout(() => (line.hidden = true), MESSAGE_MS);
}

/** @param {any} message */
function receive(message) {
  if (message.type === "hello") hello(message);
  else if (message.type === "status") showStatus(message.status, message.reason, message.hint && `${message.hint}. Before the calibration, open Guide.`);
  else if (message.type === "values") settings.update(message);
  else if (message.type === "log") log.add(message.lines);
  else if (message.type === "trouble") showMessage(message.text, true);
  else if (message.type === "scene") space.load(message.scene);
  else if (message.type === "guide") guide.take(message);
}

/** @param {import("./types.js").Hello} message */
function hello(message) {
  owner = message.owner;
  settings.locked = !owner;
  for (const line of document.querySelectorAll(".visitors")) line.toggleAttribute("hidden", owner);
  if (!owner) drawing.activate(false);
  for (const panel of /** @type {NodeListOf<HTMLFieldSetElement>} */ (document.querySelectorAll("fieldset.owners"))) {
    panel.disabled = !owner;
    if (!owner) panel.parentElement?.setAttribute("tabindex", "0"); // keys scroll it
  }
  if (message.settings.length && settings.load(message.settings)) {
    expert.load();
    drawing.load();
    tune.load(message);
  }
  space.load(message.scene);
  plots.load(message.scene?.balls ?? null);
  log.load(message.log);
}

function draw(/** @type {import("./types.js").Frame} */ frame, /** @type {ImageBitmap | null} */ bitmap) {
  const now = performance.now();
  if (bitmap && String(frame.annotations?.camera ?? 0) !== camera.value) {
    bitmap.close();
    bitmap = null;
  }
  if (bitmap) pictures.push(now);
  while (pictures[0] !== undefined && pictures[0] < now - 2000) pictures.shift();
  const samples = frame.samples.map(readSample);
  picture.take(frame, bitmap);
  plots.take(samples);
  space.take(samples);
  const masked = owner ? "" : ", masked to ball and targets";
  setText(byId("picture-rate", HTMLElement), pictures.length ? `${Math.round(pictures.length / 2)} pictures/s${masked}` : status ? "no picture" : "not live");
  picture.canvas.classList.toggle("old", !pictures.length);
  plots.read(status);
}

async function lost() {
  showStatus(null, refusal || "The page process does not answer. The page connects again by itself.", refusal ? "" : "Start it: `spheremouse view`");
  refusal = await fetch("/").then((answer) => (answer.status === 403 ? answer.text() : ""), () => "");
}

/**
 * @param {Status | null} now null if no daemon answers
 * @param {string} reason why not
 * @param {string} remedy of no answer
 */
function showStatus(now, reason, remedy) {
  status = now;
  camera.hidden = !(now?.cameras?.length > 1);
  if (camera.hidden) camera.value = "0";
  const known = STATES[now?.state ?? ""];
  const replay = now?.source?.replay;
  const word = now ? (replay ? "replay: " : "") + (known?.word ?? now.state ?? "unknown") : "offline";
  const pill = byId("state", HTMLElement);
  setText(pill, word);
  pill.dataset["look"] = now ? (known?.look ?? "wait") : "bad";
  document.title = `${word} – spheremouse`;
  setSentence(byId("reason", HTMLElement), now ? (now.reason ?? "") : reason);
  setSentence(byId("advice", HTMLElement), now ? advice(now) : remedy);
  document.body.classList.toggle("stale", !now);
  if (!now) {
    pictures.length = 0;
    setText(byId("picture-rate", HTMLElement), "not live");
  }
  const recording = now?.recording;
  const button = byId("record", HTMLButtonElement);
  setText(button, recording ? `Stop recording, ${formatDuration(recording.seconds ?? 0)}` : "Record");
  button.classList.toggle("on", Boolean(recording));
  setText(byId("pause", HTMLElement), now?.paused ? "Resume" : "Pause");
  setText(byId("reinit", HTMLElement), now?.balls ? "Search for balls again" : "Estimate camera pose");
  for (const id of ["reinit", "pause", "record", "snapshot"]) byId(id, HTMLButtonElement).disabled = !now || !owner;
  outputs.show(now);
  recordings.show(now);
  plots.read(now);
}

/** @param {Status} now */
function advice(now) {
  if (now.source?.replay) return "A recording plays. The pointer follows the camera, not the recording.";
  const troubled = now.cameras?.findIndex((/** @type {{trouble?: string}} */ camera) => camera.trouble) ?? -1;
  if (troubled >= 0) return `Camera ${troubled + 1} takes no part: ${now.cameras[troubled].trouble}`;
  const missing = now.targets?.missing;
  if (now.state === "searching-targets" && missing?.length) return `Not seen: targets ${missing.join(", ")}. Clear the view of them, and add light.`;
  if (now.state === "lost" && now.balls) return "Hold the ball before the camera, and light it evenly.";
  if (now.state === "tracking" && now.outputs?.every((/** @type {{spec: string}} */ output) => output.spec === "null"))
    return "The ball is followed. The output null sends no motion.";
  return STATES[now.state]?.advice ?? "";
}

// ---- buttons and panels ----

byId("reinit", HTMLElement).addEventListener("click", () => void perform("reinit"));
byId("pause", HTMLElement).addEventListener("click", () => void perform(status?.paused ? "resume" : "pause"));
byId("record", HTMLElement).addEventListener("click", () => void perform("record", status?.recording ? { stop: true } : {}));
byId("snapshot", HTMLElement).addEventListener("click", () => void perform("snapshot"));
byId("message-close", HTMLElement).addEventListener("click", () => showMessage("", false));

/** @type {[name: string, element: HTMLElement][]} */
const PANELS = [
  ["Tune", tune.element], ["Expert", expert.element], ["Log", log.element], ["Draw", drawing.element], ["Recordings", recordings.element],
  ["Outputs", outputs.element], ["Doctor", doctor.element], ["Calibration", calibration.element], ["Guide", guide.element],
];

const OWNERS = ["Draw", "Recordings", "Doctor", "Calibration", "Guide"]; // their buttons are disabled for visitors

/** @param {string} chosen */
function show(chosen) {
  for (const [name] of PANELS) {
    const tab = byId(`tab-${name}`, HTMLElement);
    const is = name === chosen;
    tab.setAttribute("aria-selected", String(is));
    tab.tabIndex = is ? 0 : -1;
    byId(`panel-${name}`, HTMLElement).hidden = !is;
  }
  drawing.activate(chosen === "Draw" && owner);
  if (chosen === "Recordings" && owner) void recordings.open();
  if (chosen === "Calibration" && owner) void calibration.open();
  if (chosen === "Guide" && owner) void guide.refresh();
}

const tabs = PANELS.map(([name], i) => el("button", {
  type: "button", role: "tab", id: `tab-${name}`, "aria-controls": `panel-${name}`, click: () => show(name),
  keydown: (event) => {
    const to = { ArrowRight: i + 1, ArrowLeft: i - 1, Home: 0, End: PANELS.length - 1 }[/** @type {string} */ (event.key)];
    if (to === undefined) return;
    const next = PANELS.at(to % PANELS.length)?.[0] ?? name;
    show(next);
    byId(`tab-${next}`, HTMLElement).focus();
  },
}, name));
byId("tabs", HTMLElement).append(...tabs);
byId("tab-panels", HTMLElement).append(...PANELS.map(([name, element]) =>
  el("div", { role: "tabpanel", id: `panel-${name}`, "aria-labelledby": `tab-${name}` }, OWNERS.includes(name) ? el("fieldset", { class: "owners" },
    el("p", { class: "visitors help", hidden: true }, "Only the owner can use this panel."), element) : element)));
show("Tune");
link.connect();
