/**
 * Messages between page process and browser, and settings.
 *
 * @typedef {number | string | boolean | null | Array<any>} Value
 *
 * @typedef {object} Setting
 * @property {string} key
 * @property {Value} value
 * @property {Value} default
 * @property {string} unit
 * @property {string} meaning
 * @property {"number" | "integer" | "choice" | "flag" | "text" | "list"} type
 * @property {number | null} minimum
 * @property {number | null} maximum
 * @property {string[] | null} choices
 * @property {string} group
 * @property {boolean} live `set` applies it without a restart
 *
 * @typedef {[number, number]} Point px
 * @typedef {[number, number, number]} Vector m, or a direction
 * @typedef {[number, number, number]} Shape xx, xy, yy of S, px²: (x-c)' S^-1 (x-c) = 1 is the outline
 * @typedef {number[]} Mask left, top, right, bottom of a rectangle, or x and y of each corner of a polygon, px
 *
 * @typedef {object} Annotations
 * @property {number} [camera] from 0
 * @property {Point[]} [outline]
 * @property {Point[][]} [others] outlines of further balls
 * @property {{x: number, y: number, shape: Shape, used: boolean}[]} [detected]
 * @property {{x: number, y: number, shape: Shape, gate?: Shape}[]} [predicted]
 * @property {{code: string, x: number, y: number, shape?: Shape}[]} [targets]
 * @property {Point[]} [masked]
 * @property {{code: string, x: number, y: number, radius: number}[]} [strangers]
 *
 * @typedef {object} Frame
 * @property {number} [number] with `stamp` in s, size in px and annotations, if it has a picture
 * @property {number} [stamp]
 * @property {number} [width]
 * @property {number} [height]
 * @property {Annotations} [annotations]
 * @property {any[][]} samples stamp, ball, confirmed, quaternion (4), rate (3), sigma (3), counts (3), latency, discs, position (3)
 *
 * @typedef {object} Scene
 * @property {{position: Vector, rotation: number[], covariance: number[] | null, focal: Point, centre: Point, size: Point} | null} camera
 * @property {number | null} radius m
 * @property {Vector[] | null} discs
 * @property {number | null} disc_radius m
 * @property {{code: string, position: Vector}[] | null} targets
 * @property {string[] | null} balls
 *
 * @typedef {object} Hello
 * @property {string} version
 * @property {boolean} owner
 * @property {Setting[]} settings
 * @property {Record<string, string[]>} profiles
 * @property {Scene | null} scene
 * @property {[number, string][]} log time since 1970, s, and text
 *
 * @typedef {Record<string, any>} Status keys of `ctl status`
 *
 * @typedef {{message: string, data: Record<string, any>}} Done
 *
 * @typedef {object} Sample
 * @property {number} stamp s
 * @property {number} ball
 * @property {boolean} confirmed
 * @property {number[] | null} quaternion
 * @property {Vector | null} rate rad/s
 * @property {Vector | null} sigma rad/s
 * @property {Vector} counts
 * @property {number | null} latency s
 * @property {number | null} discs
 * @property {Vector | null} position m
 */
export {};
