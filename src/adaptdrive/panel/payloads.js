"use strict";
// Payloads held to their types: whoever may publish them, the page continues and shows text as text.

const Payloads = (() => {
  const LONGEST_TEXT = 2000;
  const MOST_KEYS = 40;
  const MOST_ROWS = 4000;
  const MOST_FEATURES = 9;
  const LARGEST = 1e15; // no quantity of a drive comes near it, and axes end before numbers do
  const FIRST_MS = 0, LAST_MS = Date.UTC(2200); // a clock that was never set begins in 1970

  /** @param {unknown} value @returns {string} */
  const text = (value) => (typeof value === "string" ? value.slice(0, LONGEST_TEXT) : "");
  /** @param {unknown} value @returns {string|null} */
  const textOrNull = (value) => (typeof value === "string" ? text(value) : null);
  /** @param {unknown} value @returns {number|null} */
  const number = (value) => (typeof value === "number" && Math.abs(value) <= LARGEST ? value : null);
  /** @param {unknown} value @returns {value is Record<string, unknown>} */
  const isObject = (value) => Boolean(value) && typeof value === "object" && !Array.isArray(value);

  /** The entries of an object, each made into what it must be.
   * @template T @param {unknown} value @param {(entry: unknown) => T} make @returns {Record<string, T>} */
  function map(value, make) {
    if (!isObject(value)) return {};
    return Object.fromEntries(Object.entries(value).slice(0, MOST_KEYS).map(([key, entry]) => [text(key), make(entry)]));
  }

  /** @param {unknown} value @returns {Record<string, unknown>} */
  const fields = (value) => (isObject(value) ? value : {});

  /** @param {unknown} value @returns {[number|null, number|null]} */
  function range(value) {
    return Array.isArray(value) ? [number(value[0]), number(value[1])] : [null, null];
  }

  /** @param {unknown} value @returns {Waveform|null} */
  function waveform(value) {
    if (!isObject(value)) return null;
    const { shape, low, high, period_s } = value;
    return { shape: text(shape), low: number(low), high: number(high), period_s: number(period_s) };
  }

  /** @param {unknown} value @returns {Program|null} */
  function program(value) {
    return isObject(value) ? { name: text(value.name), text: text(value.text) } : null;
  }

  /** @param {unknown} value @returns {Trip|null} */
  function trip(value) {
    if (!isObject(value)) return null;
    return { time: text(value.time), kind: text(value.kind), text: text(value.text), remedy: text(value.remedy) };
  }

  /** The unit in which people see the output. @param {unknown} raw @param {string} own unit of the output @returns {Display} */
  function display(raw, own) {
    const found = fields(raw), scale = number(found.scale), offset = number(found.offset);
    return scale !== null && scale > 0 && offset !== null ? { unit: text(found.unit), scale, offset } : { unit: own, scale: 1, offset: 0 };
  }

  /** A value of the output as people see it. @param {number|null} value @param {Display} display */
  const shown = (value, { scale, offset }) => (value === null ? null : scale * value + offset);

  /** @param {Record<string, unknown>} raw @returns {State} */
  function state(raw) {
    const output = fields(raw.output), manipulated = fields(raw.manipulated), reach = fields(raw.reach);
    const own = text(output.unit), seen = display(output.display, own);
    const level = (/** @type {unknown} */ value) => shown(number(value), seen);
    const limits = map(raw.limits, range), wave = waveform(raw.waveform);
    for (const ends of [limits.setpoint, limits.output_trip]) if (ends) [ends[0], ends[1]] = [level(ends[0]), level(ends[1])];
    return {
      state: text(raw.state), mode: text(raw.mode), controller: text(raw.controller),
      reason: text(raw.reason), time: text(raw.time), since: text(raw.since), clock: text(raw.clock),
      stop: textOrNull(raw.stop), trip: textOrNull(raw.trip), trip_kind: text(raw.trip_kind), last_trip: trip(raw.last_trip), enabled: raw.enabled === true,
      setpoint: level(raw.setpoint), pole: number(raw.pole), waveform: wave && { ...wave, low: level(wave.low), high: level(wave.high) },
      output: { name: text(output.name) || "output", unit: own, display: seen },
      manipulated: { name: text(manipulated.name) || "v_bst", unit: textOrNull(manipulated.unit) ?? "V" },
      modes: Array.isArray(raw.modes) ? raw.modes.slice(0, 10).map(text) : ["fixed", "adaptive"],
      limits, reach: [level(reach.low), level(reach.high)], program: program(raw.program),
    };
  }

  /** @param {Record<string, unknown>} raw @returns {Load} */
  function load(raw) {
    return {
      time: text(raw.time), controller: text(raw.controller), reason: text(raw.reason),
      accepted: raw.accepted === true, reference: number(raw.reference), output: number(raw.output),
      boost_reference_V: number(raw.boost_reference_V), applied_V: number(raw.applied_V),
      response_spread: number(raw.response_spread),
      estimates: map(raw.estimates, (one) => ({ value: number(fields(one).value), std: number(fields(one).std) })),
    };
  }

  /** @param {Record<string, unknown>} raw @returns {Fast} */
  function fast(raw) {
    const lateness = fields(raw.lateness_us);
    return {
      time: text(raw.time), output: number(raw.output), boost_voltage_V: number(raw.boost_voltage_V),
      load_power_W: number(raw.load_power_W), line_voltage_V: number(raw.line_voltage_V),
      age_s: number(raw.age_s), ticks: number(raw.ticks), missed: number(raw.missed), held: number(raw.held),
      lateness_us: { p99: number(lateness.p99), max: number(lateness.max) },
      bus: map(raw.bus, number), bridge: fields(raw.command).bridge === true, left_s: number(raw.remaining_s),
      sensors: map(raw.sensors, (one) => ({ up: fields(one).up === true, detail: text(fields(one).detail) })),
    };
  }

  /** @param {Record<string, unknown>} raw @returns {DriveEvent} */
  function event(raw) {
    const remedy = text(raw.remedy), trip_kind = text(raw.trip_kind);
    return { time: text(raw.time), kind: text(raw.kind), severity: text(raw.severity), detail: text(raw.detail), remedy, trip_kind };
  }

  /** @param {Record<string, unknown>} raw @returns {Past} */
  function history(raw) {
    const rows = Array.isArray(raw.rows) ? raw.rows.slice(0, MOST_ROWS).filter(isObject).map(load) : [];
    const readings = Array.isArray(raw.readings) ? raw.readings.slice(0, MOST_ROWS).filter(Array.isArray) : [];
    return { rows: rows.filter(isTimed), points: readings.map(point).filter((one) => Number.isFinite(one.timeS)) };
  }

  /** @param {Record<string, unknown>} raw @returns {Health} */
  function health(raw) {
    const all = row(raw.times_s);
    const kept = all.flatMap((timeS, i) => (timeS !== null && timeS >= 0 && timeS > (all[i - 1] ?? -1) ? [i] : []));
    return {
      time: text(raw.time), quantities: map(raw.quantities, (one) => ({ meaning: text(fields(one).meaning) })),
      times: kept.map((i) => all[i]), courses: map(raw.courses, (one) => kept.map((i) => row(one)[i] ?? null)),
    };
  }

  /** @param {unknown} value @returns {(number|null)[]} */
  function row(value) {
    return Array.isArray(value) ? value.slice(0, MOST_ROWS).map(number) : [];
  }

  /** A reading of the history. @param {unknown[]} raw @returns {Point} */
  function point(raw) {
    const timeS = number(raw[0]) ?? NaN;
    const known = 1000 * timeS >= FIRST_MS && 1000 * timeS <= LAST_MS;
    return { timeS: known ? timeS : NaN, output: number(raw[1]), boost_voltage_V: number(raw[2]), reference: number(raw[3]), asked_V: number(raw[4]) };
  }

  /** @param {Record<string, unknown>} raw @returns {Reply} */
  function reply(raw) {
    return { id: String(number(raw.id) ?? text(raw.id)), accepted: raw.accepted === true, reason: text(raw.reason) };
  }

  /** @param {Record<string, unknown>} raw @returns {Features} */
  function features(raw) {
    const offered = Array.isArray(raw.features) ? raw.features.slice(0, MOST_FEATURES).filter(isObject) : [];
    return { features: offered.map((one) => ({ text: text(one.text), request: numbers(one.request) })) };
  }

  /** The numbers of an object. @param {unknown} value @returns {Record<string, number>} */
  function numbers(value) {
    return Object.fromEntries(Object.entries(map(value, number)).flatMap(([key, one]) => (one === null ? [] : [[key, one]])));
  }

  /** @param {{time: string}} message */
  function isTimed(message) {
    const timeMs = Date.parse(message.time);
    return timeMs >= FIRST_MS && timeMs <= LAST_MS;
  }

  /** @type {Record<string, (raw: Record<string, unknown>) => any>} */
  const MAKERS = { state, load, fast, event, health, history, reply, features };
  const UNTIMED = new Set(["history", "reply", "features"]);

  /** Hold a payload to the types of its topic; null for one without a time that can be read.
   * @param {string} kind @param {Record<string, unknown>} raw @returns {any} */
  function shaped(kind, raw) {
    const message = MAKERS[kind]?.(raw) ?? null;
    return message && (UNTIMED.has(kind) || isTimed(message)) ? message : null;
  }

  return { shaped, text, number, fields, map, display, shown };
})();
