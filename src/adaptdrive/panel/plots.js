"use strict";
// Time plots of one drive on one axis: the drive's own clock.

const Plots = (() => {
  const HEIGHT = 170;
  const HOUR_S = 3600;
  const SPANS_S = [300, 1200, HOUR_S];

  /** @param {string} name */
  function colour(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  }

  /** @param {{label: string, colour: string, dash?: number[], width?: number, step?: boolean, band?: boolean}} line */
  function series(line) {
    return {
      label: line.label,
      stroke: line.band ? "transparent" : colour(line.colour),
      width: line.width ?? 1.5,
      dash: line.dash,
      points: { show: false },
      paths: line.step ? uPlot.paths.stepped({ align: 1 }) : undefined,
    };
  }

  /** @param {any} _ @param {number[]} times */
  function clock(_, times) {
    return times.map((time) => new Date(1000 * time).toISOString().slice(11, 19));
  }

  /** As many digits as tell two marks of an axis apart.
   * @param {any} _ @param {number[]} marks @param {number} __ @param {number} ___ @param {number} step */
  function digits(_, marks, __, ___, step) {
    let places = 0; // as many as the step has: 0.25 needs two
    while (places < 9 && Math.abs(step * 10 ** places - Math.round(step * 10 ** places)) > 1e-6) places += 1;
    return marks.map((mark) => mark.toFixed(places));
  }

  /** Make one plot.
   * @param {HTMLElement} parent @param {string} title @param {any[]} lines @param {any[]} [bands] */
  function plot(parent, title, lines, bands = []) {
    const frame = Dom.make("figure.plot", {}, Dom.make("figcaption", {}, title));
    parent.append(frame);
    const axis = () => ({ stroke: colour("--text-soft"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "11px system-ui", size: 58, values: digits });
    const chart = new uPlot({
      width: 300, height: HEIGHT,
      cursor: { sync: { key: "drive" }, points: { size: 5 } },
      legend: { show: bands.length === 0, live: false },
      axes: [{ ...axis(), size: 26, space: 70, values: clock }, axis()],
      series: [{ label: "time" }, ...lines.map(series)],
      bands,
    }, lines.map(() => []).concat([[]]), frame);
    frame.querySelector(".u-legend")?.setAttribute("role", "presentation"); // a table without data
    const resize = new ResizeObserver(() => {
      chart.setSize({ width: Math.max(200, frame.clientWidth), height: HEIGHT });
    });
    resize.observe(frame);
    return { chart, frame, end() { resize.disconnect(); chart.destroy(); } };
  }

  /** The plots of a drive page.
   * @param {HTMLElement} parent @param {DriveView} drive */
  function open(parent, drive) {
    let spanS = SPANS_S[0];
    const bar = Dom.make("div.spans", { role: "group", "aria-label": "time shown" });
    for (const choice of SPANS_S) {
      bar.append(Dom.make("button", { type: "button", onclick: () => { spanS = choice; drawn = -1; marks(); } }, `${choice / 60} min`));
    }
    const marks = () => [...bar.children].forEach((button, i) => Dom.mark(button, "aria-pressed", String(SPANS_S[i] === spanS)));
    marks();
    parent.append(bar);
    const unit = drive.unit ? `, ${drive.unit}` : "";
    const output = plot(parent, `${drive.outputName}${unit}`, [
      { label: "reference", colour: "--series-2", step: true, dash: [6, 4] },
      { label: drive.outputName, colour: "--series-1" },
    ]);
    const voltage = plot(parent, "boost voltage, V", [
      { label: "V_c asked for", colour: "--series-2", step: true, dash: [6, 4] },
      { label: "applied", colour: "--series-1" },
    ]);
    const strip = Dom.make("canvas.strip", { "aria-label": "controller in force and verdict over time" });
    parent.append(Dom.make("figure.plot", {}, Dom.make("figcaption", {}, "controller in force: adaptive blue, fixed grey; amber below where the estimate is refused"), strip));
    /** @type {Map<string, ReturnType<typeof plot>>} */ const estimates = new Map();
    let drawn = -1;

    function draw() {
      if (drawn === drive.slowVersion) return;
      drawn = drive.slowVersion;
      const rows = recent(drive.slowRows, spanS);
      const time = rows.map((row) => Drives.timeS(row.time));
      output.chart.setData([time, rows.map((r) => r.reference), rows.map((r) => r.output)]);
      voltage.chart.setData([time, rows.map((r) => r.boost_reference_V), rows.map((r) => r.applied_V)]);
      for (const name of Object.keys(drive.load?.estimates ?? {})) drawEstimate(name, rows, time);
      drawStrip(/** @type {HTMLCanvasElement} */ (strip), rows, time);
    }

    /** @param {string} name @param {Load[]} rows @param {number[]} time */
    function drawEstimate(name, rows, time) {
      let own = estimates.get(name);
      if (!own) {
        const { text, unit } = Contract.named(name, Object.keys(drive.load?.estimates ?? {}), drive.unit);
        own = plot(parent, `estimate: ${text}${unit ? `, ${unit}` : ""}, ± 2 σ`, [
          { label: "high", colour: "--series-1", band: true },
          { label: "low", colour: "--series-1", band: true },
          { label: name, colour: "--series-1" },
        ], [{ series: [1, 2], fill: colour("--band") }]);
        estimates.set(name, own);
      }
      const at = (/** @type {Load} */ row, /** @type {number} */ sigmas) => {
        const one = row.estimates?.[name];
        if (one?.value == null) return null;
        return sigmas && one.std == null ? null : one.value + sigmas * (one.std ?? 0);
      };
      own.chart.setData([time, rows.map((r) => at(r, 2)), rows.map((r) => at(r, -2)), rows.map((r) => at(r, 0))]);
    }

    return {
      draw,
      end() {
        for (const one of [output, voltage, ...estimates.values()]) one.end();
      },
    };
  }

  /** @param {Load[]} rows @param {number} spanS */
  function recent(rows, spanS) {
    if (!rows.length) return rows;
    const from = Drives.timeS(rows[rows.length - 1].time) - spanS;
    return rows.filter((row) => Drives.timeS(row.time) >= from);
  }

  /** @param {HTMLCanvasElement} canvas @param {Load[]} rows @param {number[]} time */
  function drawStrip(canvas, rows, time) {
    const width = (canvas.width = canvas.clientWidth || 300);
    const height = (canvas.height = 26);
    const pen = canvas.getContext("2d");
    if (!pen || time.length < 2) return;
    const from = time[0];
    const scale = width / (time[time.length - 1] - from);
    const colours = { adaptive: colour("--series-1"), fixed: colour("--line"), refused: colour("--warn") };
    for (let i = 1; i < rows.length; i += 1) {
      const x = (time[i - 1] - from) * scale;
      const w = Math.ceil((time[i] - time[i - 1]) * scale) + 1;
      pen.fillStyle = rows[i].controller === "adaptive" ? colours.adaptive : colours.fixed;
      pen.fillRect(x, 0, w, 16);
      if (!rows[i].accepted) {
        pen.fillStyle = colours.refused;
        pen.fillRect(x, 19, w, 6);
      }
    }
  }

  return { open };
})();
