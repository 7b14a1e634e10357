"use strict";
// One recorded session, or two over each other: curves, events, summary, files.

const SessionView = (() => {
  const STEPS_S = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400, 43200, 86400, 604800];
  const SHORTEST_S = 0.05;
  const NEAR_S = 30; // around an event that was chosen
  const MOST_MARKS = 60, MOST_ROWS = 200;
  const SAME_S = 2; // a trip and its record
  const PAIRS = [["output", "reference"], ["boost_voltage_V", "command_boost_reference_V"]]; // one plot for each, as they share a unit
  const LINES = [
    [{ colour: "--series-1" }, { colour: "--series-2", step: true, dash: [6, 4] }],
    [{ colour: "--text", width: 1 }, { colour: "--text-soft", width: 1, step: true, dash: [2, 3] }],
  ];

  /** @typedef {{entry: SessionEntry, data: Overview, zeroS: number}} Shown */

  /** A time since the beginning. @param {number} timeS */
  function since(timeS) {
    const whole = Math.trunc(Math.abs(timeS)), sign = timeS < 0 ? "−" : "";
    if (whole < 600) return `${Number(timeS.toFixed(3))}\u202fs`;
    const parts = [[Math.floor(whole / 3600), "h"], [Math.floor(whole / 60) % 60, "min"], [whole % 60, "s"]];
    return sign + parts.slice(whole < 3600 ? 1 : 0).map((part) => part.join("\u202f")).join(" ");
  }

  /** The same at marks of an axis. @param {number} timeS @param {number} stepS */
  function marked(timeS, stepS) {
    const [unit, sizeS] = stepS >= 7200 ? ["h", 3600] : stepS >= 60 ? ["min", 60] : ["s", 1];
    return `${Number((timeS / Number(sizeS)).toFixed(3))}\u202f${unit}`;
  }

  const AXIS = {
    incrs: STEPS_S, shortestS: SHORTEST_S, say: since,
    values: (/** @type {any} */ _, /** @type {number[]} */ times, /** @type {number} */ __, /** @type {number} */ ___, /** @type {number} */ step) => times.map((one) => marked(one, step)),
  };

  /** @param {HTMLElement} parent @param {DriveView} drive @param {Shown[]} shown @param {number} [focusS] seconds since 1970 */
  function open(parent, drive, shown, focusS = NaN) {
    const plotted = Dom.make("section.plots", { "aria-label": "plots" });
    const key = Dom.make("p.hint.key", { "aria-live": "polite" });
    const events = Dom.make("ol.events");
    const listed = Dom.make("section.details.recorded", { tabindex: 0, "aria-label": "events" }, Dom.make("h2", {}, "Events"), events);
    const facts = shown.map((one, i) => summary(drive, one, shown.length > 1 ? i + 1 : 0));
    const bar = Dom.make("div.spans", { role: "group", "aria-label": "time shown" });
    parent.append(Dom.make("div.columns", {}, Dom.make("div.left", {}, ...facts), plotted, listed));
    let whole = extent(shown), window = whole;
    const owner = { marks: /** @type {Mark[]} */ ([]), axis: AXIS, zoom: (/** @type {{from: number, to: number}|null} */ to) => { window = to ?? whole; draw(); } };
    const move = (/** @type {number} */ by, /** @type {number} */ scale) => () => {
      const middle = (window.from + window.to) / 2 + by * (window.to - window.from), half = Math.max(SHORTEST_S, scale * (window.to - window.from)) / 2;
      owner.zoom({ from: middle - half, to: middle + half });
    };
    /** @type {[string, string, () => void][]} */ const moves = [["◂", "earlier", move(-0.5, 1)], ["+", "zoom in", move(0, 0.5)], ["−", "zoom out", move(0, 2)], ["▸", "later", move(0.5, 1)]];
    bar.append(...moves.map(([sign, name, act]) => Dom.make("button", { type: "button", title: name, "aria-label": name, onclick: act }, sign)), Dom.make("button", { type: "button", onclick: () => owner.zoom(null) }, "Show all"), Dom.make("small.hint", {}, "drag to zoom"));
    plotted.append(bar, key);
    const plots = shown.some(({ data }) => Object.values(data.tables).some((one) => one.times.length)) ? make(plotted, shown, owner) : [];
    if (!plots.length) plotted.append(Dom.make("p.hint", {}, "No curves yet: the daemon writes them each hour, at its end, and 10 s after a trip into the record of that."));
    for (const { frame } of plots) frame.querySelector(".u-over")?.addEventListener("mousemove", (event) => hover(/** @type {MouseEvent} */ (event)));
    const at = focusS - shown[0].data.beganS;
    if (at >= whole.from && at <= whole.to) window = near(at);

    /** The events, each with its session and time on the axis. */
    function notes() {
      return shown.flatMap((one, i) => one.data.notes.map((note) => ({ note, one, i, timeS: note.timeS - one.zeroS }))).sort((a, b) => a.timeS - b.timeS);
    }

    /** @param {MouseEvent} event */
    function hover(event) {
      const over = /** @type {HTMLElement} */ (event.currentTarget), spanS = window.to - window.from;
      const timeS = window.from + (event.offsetX / over.clientWidth) * spanS;
      const found = notes().filter((one) => Math.abs(one.timeS - timeS) < 0.01 * spanS).slice(0, 4);
      Dom.say(key, found.map(({ note, timeS: when }) => `${since(when)} ${note.kind}: ${note.detail}`).join("   "));
    }

    function draw() {
      const inside = notes().filter((one) => one.timeS >= window.from && one.timeS <= window.to);
      const some = inside.filter(({ note }) => note.kind === "command" || note.severity !== "info" || note.kind === "state");
      const drawn = some.length > MOST_MARKS ? some.filter(({ note }) => note.trip_kind) : some;
      owner.marks = drawn.slice(0, MOST_MARKS).map(({ note, timeS }) => ({ timeS, text: note.detail, kind: note.trip_kind ? "trip" : note.severity === "info" ? "command" : "load" }));
      for (const plot of plots) plot.draw(window);
      events.replaceChildren(...inside.slice(0, MOST_ROWS).map(row));
      if (inside.length > MOST_ROWS) events.append(Dom.make("li", {}, `${inside.length - MOST_ROWS} more: zoom in`));
    }

    /** @param {{note: Note, one: Shown, i: number, timeS: number}} found */
    function row({ note, one, i, timeS }) {
      const two = shown.length > 1;
      const record = note.trip_kind ? one.entry.trips.find((trip) => !one.data.name.endsWith(trip.record) && Math.abs(trip.timeS - one.data.beganS - note.timeS) < SAME_S) : undefined;
      return Dom.make("li", { "data-severity": note.severity },
        Dom.make("button.quiet", { type: "button", title: `${Dom.date(one.data.beganS + note.timeS)}: zoom to it`, onclick: () => owner.zoom(near(timeS)) }, `${two ? `${i + 1}: ` : ""}${since(timeS)}`),
        Dom.make("b", {}, note.kind), note.detail,
        ...(record ? [Dom.make("a", { href: link(drive, [`${one.entry.name}/${record.record}`]) }, "record of the trip")] : []),
        ...(two ? [Dom.make("button.quiet", { type: "button", title: "let this event be 0 s of its session", onclick: () => align(one, note.timeS) }, "0\u202fs here")] : []));
    }

    /** @param {Shown} one @param {number} zeroS */
    function align(one, zeroS) {
      one.zeroS = zeroS;
      window = whole = extent(shown);
      draw();
    }

    draw();
    return { end() { for (const plot of plots) plot.end(); } };
  }

  /** @param {number} timeS */
  function near(timeS) {
    return { from: timeS - NEAR_S, to: timeS + NEAR_S };
  }

  /** The address of sessions over each other. @param {DriveView} drive @param {string[]} names */
  function link(drive, names) {
    return `#${drive.name}/sessions/${names.map((one) => one.split("/").map(encodeURIComponent).join("/")).join("+")}`;
  }

  /** @param {Shown[]} shown */
  function extent(shown) {
    const ends = shown.flatMap(({ data, zeroS }) => Object.values(data.tables).filter((one) => one.times.length).flatMap(({ times }) => [times[0] - zeroS, times[times.length - 1] - zeroS]));
    const from = Math.min(...ends), to = Math.max(...ends);
    return to > from ? { from, to } : { from: 0, to: 1 };
  }

  /** The plots of all columns; two sessions share a plot where both have its column.
   * @param {HTMLElement} parent @param {Shown[]} shown @param {any} owner */
  function make(parent, shown, owner) {
    /** @type {{table: string, names: string[]}[]} */ const wanted = PAIRS.map((names) => ({ table: "ticks", names }));
    for (const { data } of shown) for (const [table, { columns }] of Object.entries(data.tables).sort(([a], [b]) => Number(b === "ticks") - Number(a === "ticks"))) {
      for (const { name } of columns) if (!wanted.some((one) => one.table === table && one.names.includes(name))) wanted.push({ table, names: [name] });
    }
    return wanted.flatMap(({ table, names }) => {
      const lines = shown.flatMap((one, i) => names.flatMap((name, place) => {
        const column = one.data.tables[table]?.columns.find((each) => each.name === name);
        return column?.values.some((value) => value !== null) ? [{ one, i, column, style: LINES[i][place] }] : [];
      }));
      if (!lines.length) return [];
      const { text, unit } = lines[0].column;
      const title = `${table === "slow" ? "estimate: " : ""}${[text, unit].filter(Boolean).join(", ")}`;
      const chart = Plots.plot(parent, title, lines.map(({ i, column, style }) => ({ ...style, label: shown.length > 1 ? `${i + 1}: ${column.text}` : column.text })), owner);
      return [{ ...chart, draw: (/** @type {{from: number, to: number}} */ window) => chart.show(joined(shown, lines, table), window) }];
    });
  }

  /** @param {Shown[]} shown @param {{one: Shown, column: Column}[]} lines @param {string} table */
  function joined(shown, lines, table) {
    const parts = shown.flatMap((one) => {
      const own = lines.filter((line) => line.one === one).map(({ column }) => column.values);
      return own.length ? [[one.data.tables[table].times.map((timeS) => timeS - one.zeroS), ...own]] : [];
    });
    return parts.length > 1 ? uPlot.join(parts) : parts[0];
  }

  /** @param {DriveView} drive @param {Shown} one @param {number} place */
  function summary(drive, { entry, data }, place) {
    const [from, to] = [extent([{ entry, data, zeroS: 0 }])].flatMap((each) => [each.from, each.to]);
    const ticks = data.tables.ticks;
    const isTrip = data.name.includes("/");
    const rows = [
      ["first tick", Dom.date(data.beganS)], ["recorded", since(to - from)],
      ["end", isTrip ? "record of a trip" : ending(entry)],
      ["trips", String(entry.trips.length)],
      ["points", ticks && ticks.rowsPerPoint > 1 ? `least and most of ${2 * ticks.rowsPerPoint} ticks` : "each tick"],
      ["recorded by", `adaptdrive ${data.version}`],
    ];
    const trips = entry.trips.filter(({ record }) => !data.name.endsWith(record));
    const size = data.files.reduce((sum, [, bytes]) => sum + bytes, 0);
    return Dom.make("section.details.session", {}, Dom.make("h2", {}, `${place ? `${place}: ` : ""}${data.name}`),
      ...data.damage.map((text) => Dom.make("p.answer", { "data-kind": "refused" }, `not in this view: ${text}`)),
      Dom.make("dl.values", {}, ...rows.map(([name, text]) => Dom.make("div", {}, Dom.make("dt", {}, name), Dom.make("dd", {}, text)))),
      ...(isTrip ? [Dom.make("p", {}, Dom.make("a", { href: link(drive, [entry.name]) }, "the whole session"))] : []),
      ...trips.map((trip) => Dom.make("p", {}, Dom.make("a", { href: link(drive, [`${entry.name}/${trip.record}`]) }, `record of ${Dom.date(trip.timeS)}`), ` ${trip.text}`)),
      Dom.make("div.row", {}, ...Object.entries(data.tables).map(([table, curves]) => Dom.make("button", { type: "button", onclick: () => save(`${data.name.replace("/", "-")}-${table}.csv`, Sessions.csv(data, curves)) }, `CSV: ${table}`))),
      Dom.make("details", {}, Dom.make("summary", {}, `Parquet, every row: ${Dom.number(size / 1e6, "MB", 3)}`),
        ...data.files.map(([file, bytes]) => Dom.make("p", {}, Dom.make("a", { href: Sessions.address(drive.name, `${data.name}/${file}`), download: `${data.name.replace("/", "-")}-${file}` }, file), ` ${Dom.number(bytes / 1e6, "MB", 3)}`))),
      Dom.make("p.hint", {}, "CSV has the points of the plots; every row: ", Dom.make("code", {}, `adaptdrive export ${data.name} --to csv`)));
  }

  /** How a session ended, in words. @param {SessionEntry} entry */
  function ending(entry) {
    return /** @type {Record<string, string>} */ ({ open: "not ended", cut: "cut: daemon killed" })[entry.ended] ?? entry.ended;
  }

  /** Keep a text as a file. @param {string} name @param {string} content */
  function save(name, content) {
    const url = URL.createObjectURL(new Blob([content], { type: "text/csv" }));
    Dom.make("a", { href: url, download: name }).click();
    window.setTimeout(() => URL.revokeObjectURL(url), 10_000);
  }

  return { open, link, ending };
})();
