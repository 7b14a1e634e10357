"use strict";
// Recorded sessions: static files below the page, read with care. recording/overview.py writes them.

/**
 * @typedef {{record: string, timeS: number, text: string}} TripRecord
 * @typedef {{name: string, drive: string, ended: string, startedS: number, endS: number, bytes: number, trips: TripRecord[]}} SessionEntry
 * @typedef {{timeS: number, kind: string, severity: string, detail: string, trip_kind: string}} Note
 * @typedef {{name: string, text: string, unit: string, values: (number|null)[]}} Column
 * @typedef {{times: number[], rowsPerPoint: number, columns: Column[]}} Curves
 * @typedef {{name: string, beganS: number, version: string, damage: string[], notes: Note[],
 *   tables: Record<string, Curves>, files: [string, number][]}} Overview
 */

const Sessions = (() => {
  const MOST_SESSIONS = 5000, MOST_POINTS = 20000, MOST_NOTES = 5000;
  const { text, number, fields, map } = Payloads;
  const NAMES = /** @type {Record<string, string>} */ ({
    command_boost_reference_V: "asked for", load_power_W: "load power", line_voltage_V: "line voltage",
  });

  /** @param {unknown} value @param {number} most @returns {Record<string, unknown>[]} */
  const list = (value, most) => (Array.isArray(value) ? value.slice(0, most).map(fields) : []);
  /** @param {unknown} value */
  const seconds = (value) => Date.parse(text(value)) / 1000;

  /** Where a file is, seen from the page. @param {string} drive @param {string} path */
  function address(drive, path) {
    return `sessions/${drive}/${path.split("/").map(encodeURIComponent).join("/")}`;
  }

  /** @param {string} drive @param {string} path @returns {Promise<unknown>} */
  async function read(drive, path) {
    const url = address(drive, path);
    const answer = await fetch(url, { cache: "no-cache" }).catch(() => null);
    if (!answer) throw new Error(`no answer for ${url}`);
    if (!answer.ok) throw new Error(`status ${answer.status} for ${url}`);
    return answer.json().catch(() => { throw new Error(`${url} is not JSON`); });
  }

  /** The sessions of a drive, the newest first. @param {string} drive @returns {Promise<SessionEntry[]>} */
  async function index(drive) {
    const listed = await read(drive, "index.json"); // the oldest first
    const every = list(Array.isArray(listed) ? listed.slice(-MOST_SESSIONS) : listed, MOST_SESSIONS).map((one) => ({
      name: text(one.name), drive: text(one.drive), ended: text(one.ended),
      startedS: seconds(one.started), endS: seconds(one.end), bytes: number(one.bytes) ?? 0,
      trips: list(one.trips, MOST_NOTES).map((trip) => ({ record: text(trip.record), timeS: seconds(trip.time), text: text(trip.text) })),
    }));
    return every.filter((one) => one.drive === drive && one.name).sort((a, b) => b.startedS - a.startedS);
  }

  /** One session, or the record of a trip. @param {string} drive @param {string} name @returns {Promise<Overview>} */
  async function overview(drive, name) {
    const raw = fields(await read(drive, `${name}/overview.json`));
    const shaped = Object.entries(map(raw.tables, curves));
    const ticks = shaped.find(([table]) => table === "ticks")?.[1].columns ?? [];
    const unit = (/** @type {string} */ of) => ticks.find((one) => one.name === of)?.unit ?? "";
    for (const [table, { columns }] of shaped) columns.forEach((one, _, all) => label(one, table, all, text(raw.given), unit));
    const display = Payloads.display(raw.display, unit("output"));
    for (const one of ticks) if (one.name === "output" || one.name === "reference") {
      one.unit = display.unit;
      one.values = one.values.map((value) => Payloads.shown(value, display));
    }
    return {
      name, beganS: seconds(raw.began), version: text(raw.version), tables: Object.fromEntries(shaped),
      damage: Array.isArray(raw.damage) ? raw.damage.slice(0, 20).map(text) : [],
      notes: list(raw.notes, MOST_NOTES).map((one) => ({
        timeS: number(one.time_s) ?? 0, kind: text(one.kind), severity: text(one.severity), detail: text(one.detail), trip_kind: text(one.trip_kind),
      })),
      files: Object.entries(fields(raw.files)).map(([file, bytes]) => [file, number(bytes) ?? 0]),
    };
  }

  /** @param {unknown} raw @returns {Curves} */
  function curves(raw) {
    const { time_s, rows_per_point, columns } = fields(raw);
    const times = Array.isArray(time_s) ? time_s.slice(0, MOST_POINTS).map((one) => number(one) ?? 0) : [];
    return { times, rowsPerPoint: number(rows_per_point) ?? 1, columns: Object.entries(map(columns, fields)).map(([name, one]) => ({
      name, text: name, unit: text(one.unit), values: times.map((_, i) => number(Array.isArray(one.values) ? one.values[i] : null)),
    })) };
  }

  /** Name a column for people; the unit of an estimate is in its name.
   * @param {Column} column @param {string} table @param {Column[]} all @param {string} given @param {(of: string) => string} unit */
  function label(column, table, all, given, unit) {
    column.text = NAMES[column.name] ?? (column.name === "boost_voltage_V" ? given : column.name);
    if (table !== "slow") return;
    Object.assign(column, Contract.named(column.name, all.map((one) => one.name), unit("output"), unit("boost_voltage_V")));
  }

  /** The points of a table as text with commas. @param {Overview} session @param {Curves} curves */
  function csv(session, { times, columns }) {
    const quoted = (/** @type {string} */ cell) => `"${cell.replaceAll('"', '""')}"`;
    const head = [`time since ${new Date(1000 * session.beganS).toISOString()} (s)`, ...columns.map((one) => (one.unit ? `${one.name} (${one.unit})` : one.name))];
    const rows = times.map((timeS, i) => [timeS, ...columns.map((one) => one.values[i] ?? "")].join(","));
    return `${[head.map(quoted).join(","), ...rows].join("\n")}\n`;
  }

  return { address, index, overview, csv };
})();
