/** The WebSocket to the page process: requests with answers, one picture at a time, and a new connection after a loss. */

/** @typedef {import("./types.js").Frame} Frame */
/** @typedef {import("./types.js").Done} Done */

const RETRY_MS = [100, 250, 500];
const ANSWER_MS = 20000; // the page process reports progress every 2 s
const PICTURE_MS = 2000; // the page process answers `next` within 0.5 s
const MAX_SILENT = 4; // questions for a picture in a row during which no message came

/**
 * @typedef {object} Handlers
 * @property {(message: any) => void} message a text message that answers no request
 * @property {(frame: Frame, picture: ImageBitmap | null) => void} frame
 * @property {() => void} lost the connection ended
 */

export class Link {
  /** @type {WebSocket | null} */ #socket = null;
  /** @type {Map<number, {resolve: (done: Done) => void, reject: (error: Error) => void, progress: (seconds: number) => void, timer: number}>} */
  #requests = new Map();
  #id = 0;
  #attempts = 0;
  #pictureTimer = 0;
  #silent = 0; // questions for a picture since the last message
  #decoder = new TextDecoder();
  #handlers;

  /** @param {Handlers} handlers */
  constructor(handlers) {
    this.#handlers = handlers;
    document.addEventListener("visibilitychange", () => (document.hidden ? this.#rest() : this.#next()));
  }

  connect() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      this.#attempts = 0;
      if (!document.hidden) this.#next();
    });
    socket.addEventListener("message", (event) => {
      this.#silent = 0;
      if (typeof event.data === "string") this.#text(JSON.parse(event.data));
      else void this.#binary(event.data);
    });
    socket.addEventListener("close", () => socket === this.#socket && this.#closed());
    this.#socket = socket;
  }

  /**
   * Send a request. Rejects with one line for people if it was refused.
   * @param {"set" | "do"} type
   * @param {object} body
   * @param {(seconds: number) => void} progress called every 2 s with the time so far
   * @returns {Promise<Done>}
   */
  request(type, body, progress = () => {}) {
    return new Promise((resolve, reject) => {
      const id = ++this.#id;
      if (!this.#send({ type, id, ...body })) {
        reject(new Error("The page process does not answer. Nothing was changed."));
        return;
      }
      this.#requests.set(id, { resolve, reject, progress, timer: this.#deadline(id) });
    });
  }

  /** @param {object} message */
  #send(message) {
    if (this.#socket?.readyState !== WebSocket.OPEN) return false;
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  #next() {
    clearTimeout(this.#pictureTimer);
    if (this.#silent++ > MAX_SILENT) this.#closed(); // the page process stands still
    else if (this.#send({ type: "next" })) this.#pictureTimer = setTimeout(() => this.#next(), PICTURE_MS);
  }

  #rest() {
    clearTimeout(this.#pictureTimer);
    this.#send({ type: "rest" });
  }

  /** @param {number} id */
  #deadline(id) {
    return setTimeout(() => this.#answer(id)?.reject(new Error("The page process does not answer.")), ANSWER_MS);
  }

  /** @param {number} id */
  #answer(id) {
    const request = this.#requests.get(id);
    if (request) clearTimeout(request.timer);
    this.#requests.delete(id);
    return request;
  }

  /** @param {any} message */
  #text(message) {
    if (message.type === "progress") {
      const waiting = this.#requests.get(message.id);
      if (!waiting) return;
      clearTimeout(waiting.timer);
      waiting.timer = this.#deadline(message.id);
      waiting.progress(message.seconds);
      return;
    }
    const request = typeof message.id === "number" ? this.#answer(message.id) : undefined;
    if (request && message.type === "done") request.resolve({ message: message.message ?? "", data: message.data ?? {} });
    else if (request) request.reject(new Error(message.text ?? "refused without a reason"));
    else this.#handlers.message(message);
  }

  /** @param {ArrayBuffer} buffer */
  async #binary(buffer) {
    const length = new DataView(buffer).getUint32(0);
    /** @type {Frame} */
    const frame = JSON.parse(this.#decoder.decode(new Uint8Array(buffer, 4, length)));
    const jpeg = new Uint8Array(buffer, 4 + length);
    let picture = null;
    if (jpeg.length) picture = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" })).catch(() => null);
    this.#handlers.frame(frame, picture);
    if (!document.hidden) requestAnimationFrame(() => this.#next());
  }

  #closed() {
    clearTimeout(this.#pictureTimer);
    this.#socket?.close();
    [this.#socket, this.#silent] = [null, 0];
    for (const id of [...this.#requests.keys()])
      this.#answer(id)?.reject(new Error("The page process ended before it answered."));
    this.#handlers.lost();
    setTimeout(() => this.connect(), RETRY_MS[Math.min(this.#attempts++, RETRY_MS.length - 1)]);
  }
}
