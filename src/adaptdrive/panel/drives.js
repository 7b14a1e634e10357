"use strict";
// What is known of each drive: its latest messages, how old they are, and a bounded history.

const Drives = (() => {
  const SLOW_ROWS = 4000; // an hour of one message a second, and some more
  const POINTS = 3600; // six minutes of ten readings a second
  const MARKS = 100;
  const EVENTS = 200;
  const COUNT = "latency"; // of late ticks: only the last one is shown
  const MOST_DRIVES = 500;
  const READINGS_PER_S = 10;
  const MARKED = new Set(["starting", "tripped", "standby"]);
  const STALE_S = 3; // telemetry/drive comes at least once a second

  const PLAIN = { unit: "", scale: 1, offset: 0 };

  /** @typedef {{output: number|null, reference?: number|null}} Measured */

  /** What was measured with its output and its reference converted.
   * @template {Measured} T @param {T} one @param {(value: number|null) => number|null} convert @returns {T} */
  function restated(one, convert) {
    const reference = one.reference === undefined ? {} : { reference: convert(one.reference) };
    return { ...one, output: convert(one.output), ...reference };
  }

  class Drive {
    /** @param {string} name */
    constructor(name) {
      this.name = name;
      this.availability = "unknown";
      /** @type {State|null} */ this.state = null;
      /** @type {Load|null} */ this.load = null;
      /** @type {Fast|null} */ this.fast = null;
      /** @type {Health|null} */ this.health = null;
      /** @type {Feature[]} */ this.features = [];
      /** @type {DriveEvent[]} */ this.events = [];
      /** @type {Load[]} */ this.slowRows = [];
      /** @type {Point[]} */ this.points = []; // readings of the last minutes
      /** @type {Mark[]} */ this.marks = []; // commands, trips and changes of the load
      this.heardS = -Infinity;
      this.lost = false; // the broker is gone since
      this.version = 0; // of all that is shown
      this.slowVersion = 0; // of what is plotted
      this.eventVersion = 0;
    }

    /** Seconds since a live message came. */
    get ageS() {
      return nowS() - this.heardS;
    }

    /** Age of the drive's last measurement; the daemon publishes although the drive is silent. */
    get measurementAgeS() {
      return this.ageS + (this.fast?.age_s ?? 0);
    }

    /** Whether the daemon is heard, with a measurement or without. */
    get heard() {
      return this.availability === "online" && !this.lost && this.ageS < STALE_S;
    }

    /** Whether what is shown may be taken for the present. */
    get live() {
      return this.heard && this.measurementAgeS < STALE_S;
    }

    /** How old what is shown is, in words. */
    get ageText() {
      if (this.live) return "live";
      return this.heard ? `drive silent: ${Dom.span(this.measurementAgeS)}` : `no data: ${Dom.span(this.ageS)}`;
    }

    /** The state, or that the daemon is gone. */
    get shown() {
      return this.availability === "online" ? this.state?.state ?? "unknown" : this.availability;
    }

    /** A stop that the drive has not confirmed, empty for none: it may be energised. */
    get openStop() {
      const stop = this.availability === "online" ? this.state?.stop ?? "confirmed" : "confirmed";
      return stop === "confirmed" ? "" : `stop ${stop}`;
    }

    /** The unit in which people see the output: all that is kept here is in it. */
    get display() {
      return this.state?.output?.display ?? PLAIN;
    }

    get unit() {
      return this.display.unit;
    }

    /** The unit of the output itself, which estimates keep. */
    get ownUnit() {
      return this.state?.output?.unit ?? "";
    }

    /** The unit that a command names, none where a typed value needs none. */
    get typedIn() {
      const { unit, scale, offset } = this.display;
      return scale === 1 && offset === 0 ? undefined : unit;
    }

    /** What the drive applies. */
    get given() {
      const { name, unit } = this.state?.manipulated ?? { name: "v_bst", unit: "V" };
      return { name: name === "v_bst" ? "boost voltage" : name, unit };
    }

    /** What a page of the drive is built from; the page is built again when it changes. */
    get build() {
      return JSON.stringify([this.outputName, this.display, this.given, this.state?.modes, this.features]);
    }

    get outputName() {
      return this.state?.output?.name ?? "output";
    }

    /** Time of the drive's clock, in seconds since 1970; the page has no other clock. */
    get clockS() {
      const newest = this.fast ?? this.load ?? this.state;
      return newest ? timeS(newest.time) : NaN;
    }

    /** @param {string} kind @param {any} message @param {boolean} retained */
    take(kind, message, retained) {
      this.version += 1;
      if (!retained && kind !== "history") {
        this.heardS = nowS();
        this.lost = false;
      }
      if (kind === "state") this._takeState(message);
      if (kind === "load") this._takeLoad(restated(message, this._seen), retained);
      if (kind === "fast") this._takeFast(restated(message, this._seen));
      if (kind === "health") this.health = message;
      if (kind === "event") this._takeEvent(message);
      if (kind === "history") this.remember({ rows: message.rows.map(this._restate), points: message.points.map(this._restate) });
    }

    /** @param {number|null} value */
    _seen = (value) => Payloads.shown(value, this.display);

    /** @template {Measured} T @param {T} one @returns {T} */
    _restate = (one) => restated(one, this._seen);

    /** Convert what came in another unit, as before the first state. @param {Display} to */
    _convert(to) {
      const { scale, offset } = this.display;
      const convert = (/** @type {number|null} */ value) => (value === null ? null : Payloads.shown((value - offset) / scale, to));
      this.load = this.load && restated(this.load, convert);
      this.fast = this.fast && restated(this.fast, convert);
      this.slowRows = this.slowRows.map((one) => restated(one, convert));
      this.points = this.points.map((one) => restated(one, convert));
      this.slowVersion += 1;
    }

    /** Mark a moment in the plots. @param {string} kind @param {string} text @param {number} [timeS] */
    mark(kind, text, timeS = this.clockS) {
      if (Number.isFinite(timeS)) push(this.marks, { timeS, kind, text }, MARKS);
    }

    /** @param {State} message */
    _takeState(message) {
      const last = this.state, { display } = message.output;
      if (display.scale !== this.display.scale || display.offset !== this.display.offset) this._convert(display);
      this.state = message;
      if (!last) return;
      const at = timeS(message.time);
      const wave = message.waveform ? `${message.waveform.shape} wave` : null;
      if (wave !== (last.waveform ? `${last.waveform.shape} wave` : null)) this.mark("command", wave ?? "waveform off", at);
      if (message.setpoint !== last.setpoint) this.mark("command", `set-point ${Dom.number(message.setpoint, this.unit)}`, at);
      if (message.mode !== last.mode) this.mark("command", message.mode, at);
      if (message.pole !== last.pole) this.mark("command", `pole ${Dom.number(message.pole)}`, at);
      if (message.state !== last.state && MARKED.has(message.state)) this.mark(message.state === "tripped" ? "trip" : "command", message.state, at);
    }

    /** @param {Fast} message */
    _takeFast(message) {
      this.fast = message;
      const at = timeS(message.time);
      if (at <= (this.points[this.points.length - 1]?.timeS ?? -Infinity)) this.points = this.points.filter((one) => one.timeS < at); // the clock was set back
      const reference = message.bridge ? this.load?.reference ?? null : null;
      const asked_V = message.bridge ? this.load?.boost_reference_V ?? null : null;
      push(this.points, { timeS: at, output: message.output, boost_voltage_V: message.boost_voltage_V, reference, asked_V }, POINTS);
    }

    /** Add what the daemon kept and is not known yet. @param {Past} past */
    remember({ rows, points }) {
      const known = new Set(this.slowRows.map((row) => row.time));
      const all = [...rows.filter((row) => !known.has(row.time)), ...this.slowRows];
      this.slowRows = all.sort((a, b) => timeS(a.time) - timeS(b.time)).slice(-SLOW_ROWS);
      const heard = new Set(this.points.map((point) => Math.round(READINGS_PER_S * point.timeS)));
      const missed = points.filter((point) => !heard.has(Math.round(READINGS_PER_S * point.timeS)));
      this.points = [...missed, ...this.points].sort((a, b) => a.timeS - b.timeS).slice(-POINTS);
      this.slowVersion += 1;
    }

    /** @param {Load} message @param {boolean} retained */
    _takeLoad(message, retained) {
      this.load = message;
      const now = timeS(message.time);
      const last = this.slowRows[this.slowRows.length - 1];
      if (last && now <= timeS(last.time)) {
        if (retained) return; // known
        this.slowRows = this.slowRows.filter((row) => timeS(row.time) < now); // the clock was set back
      }
      push(this.slowRows, message, SLOW_ROWS);
      this.slowVersion += 1;
    }

    /** @param {DriveEvent} message */
    _takeEvent(message) {
      this.eventVersion += 1;
      if (message.kind === COUNT) this.events = this.events.filter((event) => event.kind !== COUNT);
      this.events.unshift(message);
      this.events.length = Math.min(this.events.length, EVENTS);
    }
  }

  /** @template T @param {T[]} rows @param {T} row @param {number} most */
  function push(rows, row, most) {
    rows.push(row);
    if (rows.length > most) rows.splice(0, rows.length - most);
  }

  function nowS() {
    return performance.now() / 1000;
  }

  /** @param {string} text */
  function timeS(text) {
    return Date.parse(text) / 1000;
  }

  /** The cause of a trip without its remedy, which is shown by itself. @param {State} state */
  function cause(state) {
    const trip = state.trip ?? "", remedy = state.last_trip?.remedy;
    return remedy && trip.endsWith(`: ${remedy}`) ? trip.slice(0, -remedy.length - 2) : trip;
  }

  /** How to learn more of a kind of trip. @param {string} kind */
  function explain(kind) {
    return kind && `kind of this trip: adaptdrive explain ${kind}`;
  }

  /** @type {Map<string, Drive>} */
  const all = new Map();

  /** Find a drive, known or not. @param {string} name */
  function named(name) {
    let drive = all.get(name);
    if (!drive) {
      drive = new Drive(name);
      all.set(name, drive);
    }
    return drive;
  }

  /** Take one message of the broker.
   * @param {string} topic @param {Uint8Array} payload @param {boolean} retained */
  function take(topic, payload, retained) {
    const place = Contract.place(topic);
    if (!place) return;
    if (!all.has(place.drive) && all.size >= MOST_DRIVES) return;
    const drive = named(place.drive);
    if (place.kind === "availability") {
      drive.availability = new TextDecoder().decode(payload).slice(0, 20);
      drive.version += 1;
      return;
    }
    if (place.kind === "features") {
      drive.features = Contract.read(place.kind, payload)?.features ?? []; // empty: the device is gone
      return;
    }
    const message = place.kind === "reply" ? null : Contract.read(place.kind, payload);
    if (message) drive.take(place.kind, message, retained);
  }

  /** Whether a drive should be heard now. */
  function expected() {
    return [...all.values()].some((drive) => drive.availability === "online");
  }

  /** Take nothing for live until it is heard again: the broker is gone. */
  function lose() {
    for (const drive of all.values()) {
      drive.lost = true;
      drive.version += 1;
    }
  }

  return { all, named, take, expected, lose, cause, explain, timeS };
})();
/** @typedef {ReturnType<typeof Drives.named>} DriveView */
