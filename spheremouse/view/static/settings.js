/** Values of the settings: as the daemon has them, and as they are on the way to it. */

/** @typedef {import("./types.js").Setting} Setting */
/** @typedef {import("./types.js").Value} Value */
/** @typedef {import("./link.js").Link} Link */

const SAME_GESTURE_MS = 1000;

export class Settings {
  /** @type {Map<string, Setting>} */ all = new Map();
  /** @type {Set<string>} */ unsaved = new Set();
  undo = 0;
  locked = false; // this page only shows
  /** @type {Map<string, string>} */ refused = new Map(); // why the last value of a key was refused
  /** @type {{gesture: string, values: Record<string, Value>}[]} */ #queue = [];
  /** @type {Record<string, Value>} */ #underWay = {};
  #busy = false;
  #begun = NaN; // number of the last gesture with a change
  #gesture = { key: "", number: Math.floor(Math.random() * 1e9), at: -Infinity, held: false }; // another page has others
  /** @type {(() => void)[]} */ #listeners = [];
  /** @type {(key: string) => void} called before the first change of a gesture */ begun = () => {};
  #link;

  /** @param {Link} link */
  constructor(link) {
    this.#link = link;
    for (const end of ["pointerup", "pointercancel"]) addEventListener(end, () => (this.#gesture.held = false));
  }

  /** @param {() => void} listener called after every change of values */
  listen(listener) {
    this.#listeners.push(listener);
  }

  /**
   * Take the settings of a tracker. Returns false if they are the known ones with other values; then values on their
   * way to the daemon still go there.
   * @param {Setting[]} settings
   */
  load(settings) {
    const bare = (/** @type {Iterable<Setting>} */ all) => JSON.stringify([...all].map((s) => ({ ...s, value: 0, saved: 0 })));
    const rebuilt = bare(this.all.values()) !== bare(settings);
    this.all = new Map(settings.map((s) => [s.key, s]));
    if (rebuilt) this.#queue = [];
    this.refused.clear();
    this.#emit();
    return rebuilt;
  }

  /** @param {{values: Record<string, Value>, unsaved: string[], undo: number}} message */
  update(message) {
    for (const [key, value] of Object.entries(message.values)) {
      const setting = this.all.get(key);
      if (setting) setting.value = value;
    }
    this.unsaved = new Set(message.unsaved);
    this.undo = message.undo;
    this.#emit();
  }

  /** Return the value that the user chose, or the daemon's. @type {(key: string) => Value} */
  value(key) {
    for (const entry of [...this.#queue].reverse()) if (key in entry.values) return entry.values[key] ?? null;
    return (key in this.#underWay ? this.#underWay[key] : this.all.get(key)?.value) ?? null;
  }

  /** Begin a gesture that lasts until the pointer is released. */
  hold() {
    this.#gesture = { key: "", number: this.#gesture.number + 1, at: performance.now(), held: true };
  }

  /** End the gesture: the next change is another step of undo. */
  release() {
    this.#gesture = { ...this.#gesture, key: "", held: false };
  }

  /**
   * Send a value. Changes of one key within a second, or while the pointer is down, are one gesture.
   * @param {string} key
   * @param {Value} value
   */
  change(key, value) {
    const gesture = this.#gesture;
    const now = performance.now();
    const same = gesture.held ? gesture.key === "" || gesture.key === key : gesture.key === key;
    if (!same || (!gesture.held && now - gesture.at > SAME_GESTURE_MS)) gesture.number++;
    if (gesture.number !== this.#begun) this.begun(key);
    [gesture.key, gesture.at, this.#begun] = [key, now, gesture.number];
    const name = `${key} ${gesture.number}`;
    for (const entry of this.#queue) delete entry.values[key];
    const last = this.#queue.at(-1);
    if (last?.gesture === name) last.values[key] = value;
    else this.#queue.push({ gesture: name, values: { [key]: value } });
    this.refused.delete(key);
    this.#emit();
    void this.#send();
  }

  async #send() {
    if (this.#busy) return;
    this.#busy = true;
    for (let entry = this.#queue.shift(); entry; entry = this.#queue.shift()) {
      if (!Object.keys(entry.values).length) continue;
      this.#underWay = entry.values;
      try {
        await this.#link.request("set", entry);
        for (const [key, value] of Object.entries(entry.values)) {
          const setting = this.all.get(key);
          if (setting) setting.value = value;
        }
      } catch (error) {
        for (const key of Object.keys(entry.values)) this.refused.set(key, /** @type {Error} */ (error).message);
      }
      this.#underWay = {};
      this.#emit();
    }
    this.#busy = false;
  }

  #emit() {
    for (const listener of this.#listeners) listener();
  }
}
