/** The panels of settings: those of daily use, and all others by stage. */

import { el, setText } from "./dom.js";
import { Comparison } from "./compare.js";
import { control, title } from "./controls.js";

/** @typedef {import("./types.js").Setting} Setting */
/** @typedef {import("./settings.js").Settings} Settings */
/** @typedef {(action: string, words?: Record<string, any>, progress?: (seconds: number) => void) => Promise<import("./types.js").Done | null>} Act */

/** Keys of the panel Tune in its order: settings that an operator changes while looking at the ball. */
const TUNE = [
  "motion.scale_x", "motion.scale_y", "motion.scale_z", "motion.player", "pointer.horizon", "pointer.smooth",
  "wand.pointing.by", "wand.pointing.scale_x", "wand.pointing.scale_y", "wand.pointing.scale_z", "wand.lost_after",
  "discs.polarity", "discs.contrast", "so3.acceleration_sigma", "loss.lost_after", "camera.exposure_s", "camera.gain",
];

const NO_SETTINGS = "The settings appear when the service runs.";

export class TunePanel {
  /** @type {(() => void)[]} */ #shows = [];
  #list = el("div", { class: "settings" });
  #undo = el("button", { type: "button", id: "undo" }, "Undo");
  #save = el("button", { type: "button", id: "save", class: "main" }, "Save");
  #mark = el("p", { class: "help", id: "unsaved", role: "status" });
  #profile = el("select", { id: "profile" });
  #apply = el("button", { type: "button", id: "apply-profile" }, "Apply");
  #profiles = el("div", { class: "row", hidden: true }, el("label", { for: "profile" }, "Profile"), this.#profile, this.#apply);
  element;
  #settings;

  constructor(/** @type {Settings} */ settings, /** @type {Act} */ perform, /** @type {import("./picture.js").Picture} */ picture) {
    this.#settings = settings;
    const comparison = new Comparison(picture);
    settings.begun = (key) => comparison.begin(key);
    this.element = el("div", {}, this.#profiles, this.#list,
      el("div", { class: "sticky" }, comparison.element, el("div", { class: "row" }, this.#undo, this.#save, this.#mark)));
    this.#undo.addEventListener("click", () => void perform("undo"));
    this.#save.addEventListener("click", () => void perform("save"));
    this.#apply.addEventListener("click", () => void perform("profile", { name: this.#profile.value }));
    settings.listen(() => this.#show());
    this.#show();
  }

  /** @param {import("./types.js").Hello} hello */
  load({ profiles }) {
    const controls = TUNE.flatMap((key) => {
      const setting = this.#settings.all.get(key);
      return setting ? [control(setting, this.#settings, "tune")] : [];
    });
    this.#shows = controls.map((c) => c.show);
    this.#list.replaceChildren(...controls.map((c) => c.element));
    this.#profiles.hidden = !Object.keys(profiles).length;
    this.#profile.replaceChildren(...Object.entries(profiles).map(([name, changes]) =>
      el("option", { value: name, title: changes.join(", ") }, name)));
    this.#show();
  }

  #show() {
    for (const show of this.#shows) show();
    const { undo, unsaved, locked } = this.#settings;
    this.#undo.disabled = locked || undo === 0;
    this.#save.disabled = locked || unsaved.size === 0;
    this.#apply.disabled = locked;
    setText(this.#undo, undo ? `Undo (${undo})` : "Undo");
    setText(this.#mark, !this.#shows.length ? NO_SETTINGS : unsaved.size ? `${unsaved.size} unsaved: in force until the next start.` : "All settings are saved.");
  }
}

const STAGES = /** @type {Record<string, string>} */ ({
  "": "The run", camera: "Camera", rings: "Targets", pose: "Camera pose", discs: "Discs", blobs: "Discs, published detector",
  so3: "Filter", euler: "Published filters", loss: "Loss and recovery", motion: "Motion to counts", pointer: "Reports",
  wand: "Wand", "wand.pointing": "Wand, pointing", control: "Control socket", record: "Recordings", metrics: "Metrics",
});

export class ExpertPanel {
  /** @type {{setting: Setting, element: HTMLElement, show: () => void}[]} */ #controls = [];
  #search = el("input", { type: "search", id: "search", placeholder: "Name or effect", autocomplete: "off" });
  #changed = el("input", { type: "checkbox", id: "changed-only" });
  #reset = el("button", { type: "button", id: "reset-all" }, "Reset all");
  #export = el("button", { type: "button", id: "export" }, "Export");
  #import = el("button", { type: "button", id: "import", click: () => this.#file.click() }, "Import");
  #file = el("input", { type: "file", id: "import-file", accept: ".yaml,.yml,text/yaml", class: "unseen", tabindex: "-1",
    "aria-label": "File of settings" });
  #list = el("div", { class: "stages" });
  #count = el("p", { class: "help", role: "status" });
  element;
  #settings;

  constructor(/** @type {Settings} */ settings, /** @type {Act} */ perform) {
    this.#settings = settings;
    this.#export.addEventListener("click", async () => download(await perform("export")));
    this.element = el("div", {},
      el("div", { class: "row" }, el("label", { for: "search" }, "Search"), this.#search,
        el("label", { class: "check" }, this.#changed, "changed only")),
      el("div", { class: "row" }, this.#reset, this.#export, this.#import, this.#file), this.#count, this.#list);
    this.#search.addEventListener("input", () => this.#show());
    this.#changed.addEventListener("change", () => this.#show());
    this.#reset.addEventListener("click", () => {
      const keys = this.#controls.map((c) => c.setting).filter((s) => this.#isReset(s)).map((s) => s.key);
      if (keys.length) void perform("reset", { keys });
    });
    this.#file.addEventListener("change", async () => {
      const file = this.#file.files?.[0];
      if (file) await perform("import", { text: await file.text() });
      this.#file.value = "";
    });
    settings.listen(() => this.#show());
    this.#show();
  }

  load() {
    const others = [...this.#settings.all.values()].filter((s) => !TUNE.includes(s.key));
    this.#controls = others.map((setting) => ({ setting, ...control(setting, this.#settings, "expert") }));
    const groups = [...new Set(others.map((setting) => setting.group))];
    this.#list.replaceChildren(...groups.map((name) => el("section", {}, el("h3", {}, STAGES[name] ?? title(name)),
      ...this.#controls.filter((c) => c.setting.group === name).map((c) => c.element))));
    this.#show();
  }

  /** @param {Setting} setting */
  #isChanged(setting) {
    return JSON.stringify(this.#settings.value(setting.key)) !== JSON.stringify(setting.default);
  }

  /**
   * Return if "Reset all" changes a setting. It leaves the files and devices of the run as they are.
   * @param {Setting} setting
   */
  #isReset(setting) {
    return setting.live && setting.group !== "" && setting.key !== "wand.balls" && this.#isChanged(setting);
  }

  #show() {
    const words = this.#search.value.trim().toLowerCase().split(/\s+/);
    const isSought = (/** @type {Setting} */ { key, meaning }) => words.every((w) => `${key} ${meaning}`.toLowerCase().includes(w));
    const inTune = [...this.#settings.all.values()].filter((s) => TUNE.includes(s.key) && isSought(s)).length;
    let shown = 0;
    for (const { setting, element, show } of this.#controls) {
      show();
      element.hidden = !isSought(setting) || (this.#changed.checked && !this.#isChanged(setting));
      shown += Number(!element.hidden);
    }
    for (const section of this.#list.children) {
      const rows = [...section.querySelectorAll(".setting")];
      section.toggleAttribute("hidden", rows.every((row) => row.hasAttribute("hidden")));
    }
    const changed = this.#controls.filter((c) => this.#isChanged(c.setting));
    this.#import.disabled = this.#export.disabled = this.#settings.locked;
    this.#reset.disabled = this.#settings.locked || !changed.some((c) => this.#isReset(c.setting));
    const loaded = this.#controls.length > 0;
    this.#export.disabled ||= !loaded;
    this.#import.disabled ||= !loaded;
    setText(this.#count, !loaded ? NO_SETTINGS : `${shown} of ${this.#controls.length} settings shown, ${changed.length} differ from the default.${words[0] && inTune ? ` Tune has ${inTune} more.` : ""}`);
  }
}

/** @param {import("./types.js").Done | null} done */
function download(done) {
  if (!done) return;
  const url = URL.createObjectURL(new Blob([String(done.data.text ?? "")], { type: "text/yaml" }));
  el("a", { href: url, download: "spheremouse-settings.yaml" }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}
