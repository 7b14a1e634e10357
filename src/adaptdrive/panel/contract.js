"use strict";
// The MQTT contract of the daemon: topics, and payloads read with care. docs/mqtt.md defines it.

/**
 * @typedef {{unit: string, scale: number, offset: number}} Display
 * @typedef {{value: number|null, std: number|null}} Estimate
 * @typedef {{time: string, kind: string, text: string, remedy: string}} Trip
 * @typedef {{shape: string, low: number|null, high: number|null, period_s: number|null}} Waveform
 * @typedef {{name: string, text: string}} Program
 * @typedef {{
 *   state: string, mode: string, controller: string, reason: string, enabled: boolean,
 *   setpoint: number|null, waveform: Waveform|null, pole: number|null, trip: string|null, trip_kind: string,
 *   stop: string|null, time: string, since: string, last_trip: Trip|null, clock: string,
 *   output: {name: string, unit: string, display: Display}, manipulated: {name: string, unit: string}, modes: string[],
 *   limits: Record<string, [number|null, number|null]>, reach: [number|null, number|null], program: Program|null
 * }} State
 * @typedef {{
 *   time: string, reference: number|null, output: number|null, boost_reference_V: number|null,
 *   applied_V: number|null, estimates: Record<string, Estimate>, accepted: boolean, response_spread: number|null,
 *   controller: string, reason: string
 * }} Load
 * @typedef {{
 *   time: string, output: number|null, boost_voltage_V: number|null, load_power_W: number|null,
 *   line_voltage_V: number|null, ticks: number|null, missed: number|null, held: number|null,
 *   age_s: number|null, lateness_us: {p99: number|null, max: number|null}, bus: Record<string, number|null>,
 *   sensors: Record<string, {up: boolean, detail: string}>, bridge: boolean, left_s: number|null
 * }} Fast
 * @typedef {{time: string, kind: string, severity: string, detail: string, remedy: string, trip_kind: string}} DriveEvent
 * @typedef {{timeS: number, output: number|null, boost_voltage_V: number|null, reference: number|null, asked_V: number|null}} Point
 * @typedef {{time: string, quantities: Record<string, {meaning: string}>, times: (number|null)[], courses: Record<string, (number|null)[]>}} Health
 * @typedef {{timeS: number, kind: string, text: string}} Mark
 * @typedef {{rows: Load[], points: Point[]}} Past
 * @typedef {{id: string, accepted: boolean, reason: string}} Reply
 * @typedef {{text: string, request: Record<string, number>}} Feature
 * @typedef {{features: Feature[]}} Features
 */

const Contract = (() => {
  const ROOT = "adaptdrive";
  const SIMULATOR = "adaptdrive-sim"; // topics of a simulated device, not of its daemon
  const LARGEST = 1 << 20; // bytes: no payload of a drive comes near it
  const KINDS = new Map([
    ["availability", "availability"],
    ["state", "state"],
    ["telemetry/load", "load"],
    ["telemetry/drive", "fast"],
    ["health", "health"],
    ["event", "event"],
    ["reply", "reply"],
    ["history", "history"],
  ]);

  const SIMULATED = new Map([["truth", "features"], ["reply", "reply"]]);

  const SUBSCRIPTIONS = [
    ...[...KINDS.keys()].filter((tail) => tail !== "history").map((tail) => `${ROOT}/+/${tail}`),
    ...[...SIMULATED.keys()].map((tail) => `${SIMULATOR}/+/${tail}`),
  ];

  /** Split a topic; null for one that is not of the contract.
   * @param {string} topic @returns {{drive: string, kind: string} | null} */
  function place(topic) {
    const [root, drive, ...tail] = topic.split("/");
    const kind = (root === ROOT ? KINDS : root === SIMULATOR ? SIMULATED : null)?.get(tail.join("/"));
    if (!kind || !/^[A-Za-z0-9_-]{1,64}$/.test(drive)) return null;
    return { drive, kind };
  }

  /** Read a payload; null for what is no JSON object, or has no time.
   * @param {string} kind @param {Uint8Array} payload */
  function read(kind, payload) {
    if (payload.length > LARGEST) return null;
    try {
      const document = JSON.parse(new TextDecoder().decode(payload));
      return document && typeof document === "object" ? Payloads.shaped(kind, document) : null;
    } catch {
      return null;
    }
  }

  /** @param {string} drive @param {string} verb */
  function command(drive, verb) {
    return `${ROOT}/${drive}/command/${verb}`;
  }

  /** Where a simulated device is disturbed. @param {string} drive */
  function disturb(drive) {
    return `${SIMULATOR}/${drive}/disturb`;
  }

  /** Where the last hour is asked for, and where it is answered. @param {string} drive */
  function history(drive) {
    return { ask: `${ROOT}/${drive}/ask/history`, answer: `${ROOT}/${drive}/history` };
  }

  /** The name of an estimate without its unit, and the unit as it is written; that of an offset is
   * the unit of the load's input, that of a gain is so much of the output for each unit of that.
   * @param {string} name @param {string[]} names of all estimates @param {string} outputUnit
   * @param {string} givenUnit of what the drive gives */
  function named(name, names, outputUnit, givenUnit) {
    const one = outputUnit.includes("/") ? `(${outputUnit})` : outputUnit || "1";
    if (name === "gain") return { text: name, unit: givenUnit ? `${one}/${givenUnit}` : outputUnit };
    if (name === "input_offset") return { text: "input offset", unit: names.includes("resistance_K_per_W") ? "W" : givenUnit };
    const match = /^(.+?)_((?:s|V|A|W|K|S|J|F|Ohm|rad)\d?(?:_per_(?:s|V|A|W|K)\d?)?)$/.exec(name);
    if (!match) return { text: name, unit: "" };
    return { text: match[1].replaceAll("_", " "), unit: match[2].replace("_per_", "/").replace("2", "²").replace("Ohm", "Ω") };
  }

  return { SUBSCRIPTIONS, place, read, command, disturb, history, named };
})();
