/** Ball, targets and camera in space on canvas 2-D. Drag, or press arrow keys, to turn the view. */

import { prepareCanvas, colour, el, setText } from "./dom.js";

/** @typedef {import("./types.js").Vector} Vector */
/** @typedef {import("./types.js").Scene} Scene */
/** @typedef {import("./types.js").Sample} Sample */
/** @typedef {(p: Vector) => Vector} Project point in space to x, y on the screen and depth towards the viewer, m */
/** @typedef {{c: CanvasRenderingContext2D, project: Project, towards: Vector, scale: number, radius: number}} View of a ball */

const TURN = 0.01; // rad for a pixel of drag
const KEY_TURN = 0.1; // rad
const DEFAULT_RADIUS = { ball: 0.6, wand: 0.05 };
const SIGMA = 3;
const FACTORS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000]; // that make an ellipsoid visible
/** @type {Record<string, [number, number]>} */
const VIEWS = { Oblique: [0.8, 0.35], Front: [0, 0], Side: [Math.PI / 2, 0], Top: [0, Math.PI / 2] };

const dot = (/** @type {Vector} */ a, /** @type {Vector} */ b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @type {(a: Vector, b: Vector, s?: number) => Vector} a + s b */
const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
/** @type {(a: Vector, s: number) => Vector} */
const times = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
/** @type {(a: Vector, b: Vector) => Vector} */
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (/** @type {Vector} */ a) => times(a, 1 / (Math.hypot(...a) || 1));

/** Return two unit vectors that are perpendicular to a unit vector and to each other. @type {(n: Vector) => [Vector, Vector]} */
function perpendicular(n) {
  const u = unit(cross(n, Math.abs(n[0]) < 0.8 ? [1, 0, 0] : [0, 1, 0]));
  return [u, cross(n, u)];
}

/** Return the function that rotates by a unit quaternion (w, x, y, z). @type {(q: number[]) => (v: Vector) => Vector} */
function rotation([w = 1, x = 0, y = 0, z = 0]) {
  const axis = /** @type {Vector} */ ([x, y, z]);
  return (v) => {
    const t = times(cross(axis, v), 2);
    return add(add(v, t, w), cross(axis, t));
  };
}

/** Return the lower Cholesky factor's columns of a covariance (9, row-major). @type {(m: number[]) => [Vector, Vector, Vector]} */
function cholesky([a = 0, , , b = 0, c = 0, , d = 0, e = 0, f = 0]) {
  const l11 = Math.sqrt(Math.max(a, 0));
  const [l21, l31] = l11 ? [b / l11, d / l11] : [0, 0];
  const l22 = Math.sqrt(Math.max(c - l21 * l21, 0));
  const l32 = l22 ? (e - l31 * l21) / l22 : 0;
  return [[l11, l21, l31], [0, l22, l32], [0, 0, Math.sqrt(Math.max(f - l31 * l31 - l32 * l32, 0))]];
}

/** Return a closed circle about a centre, in the plane of u and v. @type {(centre: Vector, u: Vector, v: Vector, parts?: number) => Vector[]} */
function circle(centre, u, v, parts = 24) {
  return Array.from({ length: parts }, (_, i) => {
    const angle = (2 * Math.PI * i) / parts;
    return add(add(centre, u, Math.cos(angle)), v, Math.sin(angle));
  });
}

export class Space {
  /** @type {Scene | null} */ #scene = null;
  /** @type {Map<number, Sample>} */ #samples = new Map();
  #yaw = 0;
  #pitch = 0;
  #zoom = 1;

  constructor(/** @type {HTMLCanvasElement} */ canvas, /** @type {HTMLElement} */ note, /** @type {HTMLElement} */ views) {
    this.canvas = canvas;
    this.note = note;
    [this.#yaw, this.#pitch] = VIEWS["Oblique"] ?? [0, 0];
    views.append(...Object.entries(VIEWS).map(([name, view]) =>
      el("button", { type: "button", class: "quiet", click: () => this.#look(...view) }, name)));
    let from = /** @type {[number, number] | null} */ (null);
    canvas.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.#turn((from[0] - event.clientX) * TURN, (event.clientY - from[1]) * TURN);
      from = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (from = null));
    canvas.addEventListener("keydown", (event) => this.#key(event));
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  /** @param {Scene | null} scene */
  load(scene) {
    this.#scene = scene?.camera?.position ? scene : scene && { ...scene, camera: null }; // its pose is not known yet
    this.draw();
  }

  /** @param {Sample[]} samples */
  take(samples) {
    for (const sample of samples) this.#samples.set(sample.ball, sample);
    this.draw();
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const turns = /** @type {Record<string, [number, number]>} */ ({
      ArrowLeft: [-KEY_TURN, 0], ArrowRight: [KEY_TURN, 0], ArrowUp: [0, KEY_TURN], ArrowDown: [0, -KEY_TURN] });
    const turn = turns[event.key];
    const zoom = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 }[event.key];
    if (turn) this.#turn(...turn);
    else if (zoom) this.#zoom = Math.min(8, Math.max(0.5, this.#zoom * zoom));
    else return;
    event.preventDefault();
    this.draw();
  }

  /** @type {(yaw: number, pitch: number) => void} */
  #turn(yaw, pitch) {
    this.#look(this.#yaw + yaw, this.#pitch + pitch);
  }

  /** @type {(yaw: number, pitch: number) => void} */
  #look(yaw, pitch) {
    [this.#yaw, this.#pitch] = [yaw, Math.min(Math.PI / 2, Math.max(-Math.PI / 2, pitch))];
    this.draw();
  }

  get #wand() {
    return Boolean(this.#scene?.balls);
  }

  /** Return the axes of the view in space: right, up, towards the viewer. @returns {[Vector, Vector, Vector]} */
  #axes() {
    const [sy, cy, sp, cp] = [Math.sin(this.#yaw), Math.cos(this.#yaw), Math.sin(this.#pitch), Math.cos(this.#pitch)];
    // obj has Y up; cam has y down and z ahead.
    const turn = (/** @type {Vector} */ [x, y, z]) => /** @type {Vector} */ (this.#wand ? [x, -y, -z] : [x, y, z]);
    return [turn([cy, 0, -sy]), turn([-sy * sp, cp, -cy * sp]), turn([sy * cp, sp, cy * cp])];
  }

  draw() {
    const { context: c, width, height } = prepareCanvas(this.canvas);
    const scene = this.#scene;
    const radius = scene?.radius ?? (this.#wand ? DEFAULT_RADIUS.wand : DEFAULT_RADIUS.ball);
    const balls = this.#wand ? [...this.#samples.values()].filter((s) => s.position) : [this.#samples.get(1) ?? null];
    const [right, up, towards] = this.#axes();
    const shown = this.#extent(radius, balls).map((p) => [dot(p, right), dot(p, up)]);
    const bounds = [0, 1].map((i) => {
      const values = shown.map((p) => p[i] ?? 0);
      return [Math.min(...values), Math.max(...values)];
    });
    const [[left = 0, rightmost = 1] = [], [bottom = 0, top = 1] = []] = bounds;
    const scale = this.#zoom * Math.min((width - 40) / (rightmost - left), (height - 36) / (top - bottom));
    if (!(scale > 0)) return;
    /** @type {Project} */
    const project = (p) => [
      width / 2 + scale * (dot(p, right) - (left + rightmost) / 2),
      height / 2 - scale * (dot(p, up) - (bottom + top) / 2),
      dot(p, towards),
    ];
    c.lineJoin = "round";
    const camera = this.#wand ? { position: /** @type {Vector} */ ([0, 0, 0]), rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1] } : scene?.camera;
    const far = camera && dot(camera.position, towards) < 0;
    const view = { c, project, towards, scale, radius };
    if (camera && far) this.#camera(view, camera);
    this.#targets(view, false);
    for (const sample of balls) this.#ball(view, sample);
    this.#targets(view, true);
    if (camera && !far) this.#camera(view, camera);
    if (!scene) setText(this.note, "not known yet");
  }

  /** Return points that the view must contain. @type {(radius: number, balls: (Sample | null)[]) => Vector[]} */
  #extent(radius, balls) {
    const known = this.#wand ? balls.flatMap((b) => (b?.position ? [b.position] : [])) : [];
    const centres = known.length ? known : [/** @type {Vector} */ ([0, 0, this.#wand ? 1 : 0])];
    const r = this.#wand ? 4 * radius : 1.35 * radius;
    const corners = centres.flatMap((p) => [-r, r].flatMap((dx) => [-r, r].flatMap((dy) => [-r, r].map(
      (dz) => add(p, /** @type {Vector} */ (unit([dx, dy, dz]).map((v) => v * r)))))));
    const camera = this.#wand ? /** @type {Vector} */ ([0, 0, 0]) : this.#scene?.camera?.position;
    const targets = this.#scene?.targets?.map((t) => t.position) ?? [];
    return [...corners, ...targets, ...(camera ? [camera] : [])];
  }

  #ball(/** @type {View} */ view, /** @type {Sample | null} */ sample) {
    const { c, project, scale, radius } = view;
    const centre = /** @type {Vector} */ ((this.#wand && sample?.position) || [0, 0, 0]);
    const turn = rotation(sample?.quaternion ?? []);
    const [x, y] = project(centre);
    const r = scale * radius;
    const light = c.createRadialGradient(x - r / 3, y - r / 2, r / 8, x, y, r);
    light.addColorStop(0, colour("--ball-light"));
    light.addColorStop(1, colour("--ball-dark"));
    c.beginPath();
    c.arc(x, y, r, 0, 2 * Math.PI);
    c.fillStyle = light;
    c.fill();
    if (sample?.quaternion) this.#pattern(view, centre, turn);
    if (sample && !sample.confirmed) {
      [c.strokeStyle, c.lineWidth] = [colour("--warn"), 2];
      c.setLineDash([5, 4]);
      c.beginPath();
      c.arc(x, y, r + 3, 0, 2 * Math.PI);
      c.stroke();
      c.setLineDash([]);
    }
    const name = this.#scene?.balls?.[(sample?.ball ?? 1) - 1];
    c.fillStyle = colour("--text");
    if (name) text(c, name, x - 20, y + r + 32);
    const still = /** @type {[Vector, string][]} */ ([[[1, 0, 0], "X"], [[0, 1, 0], "Y"], [[0, 0, 1], "Z"]]);
    for (const [axis, name] of still) {
      const end = project(add(centre, this.#wand ? turn(axis) : axis, (this.#wand ? 2.2 : 1.3) * radius));
      [c.strokeStyle, c.fillStyle, c.lineWidth] = [colour(`--${name.toLowerCase()}`), colour(`--${name.toLowerCase()}`), 2];
      line(c, [project(centre), end]);
      text(c, name, end[0] + 4, end[1] + 4);
    }
  }

  /** Draw discs and two great circles that turn with the ball; those behind it are faint. */
  #pattern(/** @type {View} */ { c, project, towards, radius }, /** @type {Vector} */ centre, /** @type {(v: Vector) => Vector} */ turn) {
    const discs = this.#scene?.discs ?? [];
    const size = this.#scene?.disc_radius ?? radius / 25;
    for (const disc of discs) {
      const axis = turn(unit(disc));
      const [u, v] = perpendicular(axis);
      const front = dot(axis, towards) > 0;
      c.fillStyle = front ? "#14181d" : "rgba(20, 24, 29, .13)";
      c.beginPath();
      for (const [x, y] of circle(add(centre, axis, radius), times(u, size), times(v, size)).map(project)) c.lineTo(x, y);
      c.fill();
    }
    c.strokeStyle = "rgba(20, 24, 29, .25)";
    c.lineWidth = 1;
    for (const normal of /** @type {Vector[]} */ ([[0, 1, 0], [1, 0, 0]])) {
      const [u, v] = perpendicular(turn(normal));
      const points = circle(centre, times(u, radius), times(v, radius), 48);
      points.forEach((p, i) => {
        const next = points[(i + 1) % points.length] ?? p;
        if (dot(add(p, centre, -1), towards) > 0) line(c, [project(p), project(next)]);
      });
    }
  }

  /** Draw the targets, and the frame between them, if they are in front of the ball's centre or if not. */
  #targets(/** @type {View} */ { c, project, towards }, /** @type {boolean} */ front) {
    const targets = this.#scene?.targets ?? [];
    const middle = times(targets.reduce((sum, t) => add(sum, t.position), /** @type {Vector} */ ([0, 0, 0])), 1 / targets.length);
    if (!targets.length || dot(middle, towards) > 0 !== front) return;
    const angle = (/** @type {Vector} */ p) => Math.atan2(p[1] - middle[1], p[0] - middle[0]);
    const around = [...targets].sort((a, b) => angle(a.position) - angle(b.position)).map((t) => project(t.position));
    [c.strokeStyle, c.lineWidth] = [colour("--muted"), 1.5];
    c.globalAlpha = front ? 0.8 : 0.45;
    if (around[0]) line(c, [...around, around[0]]);
    c.globalAlpha = 1;
    [c.strokeStyle, c.fillStyle, c.lineWidth] = [colour("--y"), colour("--y"), 2];
    for (const target of targets) {
      const [x, y] = project(target.position);
      c.beginPath();
      c.arc(x, y, 3.5, 0, 2 * Math.PI);
      c.stroke();
      text(c, target.code, x + 6, y - 4);
    }
  }

  /**
   * Draw the camera's field of view, and the ellipsoid of its position.
   * @param {View} view
   * @param {{position: Vector, rotation: number[], covariance?: number[] | null, focal?: number[], centre?: number[], size?: number[]}} camera
   */
  #camera({ c, project, radius }, { position, rotation: r, covariance, focal, centre, size }) {
    const [fx = 1, fy = 1] = focal ?? [800, 800];
    const [cx = 0, cy = 0] = centre ?? [320, 240];
    const [w = 0, h = 0] = size ?? [640, 480];
    const depth = this.#wand ? 3 * radius : 0.4 * radius;
    const corners = [[0, 0], [w, 0], [w, h], [0, h]].map(([x = 0, y = 0]) => {
      const ray = [((x - cx) / fx) * depth, ((y - cy) / fy) * depth, depth];
      const [a = 0, b = 0, d = 0] = [0, 1, 2].map((i) => ray.reduce((sum, v, k) => sum + v * (r[3 * k + i] ?? 0), 0)); // R' ray
      return project(add(position, [a, b, d]));
    });
    const apex = project(position);
    [c.strokeStyle, c.lineWidth] = [colour("--z"), 1.5];
    line(c, [...corners, corners[0] ?? apex]);
    for (const corner of corners) line(c, [apex, corner]);
    c.fillStyle = colour("--text");
    if (!covariance) {
      text(c, "camera", apex[0] - 30, apex[1] + 30);
      setText(this.note, "");
      return;
    }
    const axes = cholesky(covariance);
    const largest = SIGMA * Math.max(...axes.map((a) => Math.hypot(...a)));
    const factor = FACTORS.findLast((f) => largest * f <= 0.2 * radius) ?? 1;
    c.strokeStyle = colour("--x");
    const [a, b, d] = /** @type {[Vector, Vector, Vector]} */ (axes.map((v) => times(v, SIGMA * factor)));
    for (const [u, v] of /** @type {[Vector, Vector][]} */ ([[a, b], [b, d], [d, a]])) {
      const points = circle(position, u, v).map(project);
      line(c, [...points, points[0] ?? apex]);
    }
    text(c, `camera, ${SIGMA} σ${factor > 1 ? ` × ${factor}` : ""}`, apex[0] - 30, apex[1] + 30);
    const sigma = [0, 4, 8].map((i) => (1000 * Math.sqrt(covariance[i] ?? 0)).toPrecision(2));
    setText(this.note, `camera σ ${sigma.join(", ")} mm`);
  }
}

function line(/** @type {CanvasRenderingContext2D} */ c, /** @type {Vector[]} */ points) {
  c.beginPath();
  for (const [x, y] of points) c.lineTo(x, y);
  c.stroke();
}

function text(/** @type {CanvasRenderingContext2D} */ c, /** @type {string} */ words, /** @type {number} */ x, /** @type {number} */ y) {
  c.save();
  c.font = "11px system-ui, sans-serif";
  const place = /** @type {const} */ ([Math.max(4, Math.min(x, c.canvas.clientWidth - c.measureText(words).width - 4)), Math.min(y, c.canvas.clientHeight - 4)]);
  [c.strokeStyle, c.lineWidth] = [colour("--panel"), 3]; // legible on the ball
  c.strokeText(words, ...place);
  c.fillText(words, ...place);
  c.restore();
}
