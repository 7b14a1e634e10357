"use strict";
// Time plots of one drive on one axis: the drive's own clock, shown in the time zone of the reader.

const Plots = (() => {
  const HEIGHT = 170;
  const HOUR_S = 3600;
  const SPANS_S = [300, 1200, HOUR_S];
  const SHORTEST_ZOOM_S = 1;
  const RESTING = 0.02, NARROW = 0.25; // shares of the limits: between them an axis shows only what the values cover
  const STEPS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, HOUR_S]; // between two marks of the time axis
  const SYNC = "drive";

  /** @typedef {{from: number, to: number}} Window */
  /** @typedef {{incrs: number[], values: (...of: any[]) => string[], say: (timeS: number) => string, shortestS: number}} TimeAxis */

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
      value: (/** @type {any} */ _, /** @type {number|null} */ value) => Dom.number(value),
    };
  }

  /** @param {any} _ @param {number[]} times */
  function clock(_, times) {
    return times.map(Dom.clock);
  }

  /** What an axis shows: its limits from end to end, or where values move within a small part of them, that part.
   * @param {() => [number|null, number|null]|undefined} limits */
  function reach(limits) {
    return (/** @type {any} */ _, /** @type {number|null} */ low, /** @type {number|null} */ high) => {
      const [least, most] = limits() ?? [null, null];
      const whole = least != null && most != null && most > least ? most - least : null;
      if (low == null || high == null) return whole ? [least, most] : [0, 1];
      const moved = high - low;
      if (whole && (moved < RESTING * whole || moved > NARROW * whole)) return [Math.min(low, least ?? low), Math.max(high, most ?? high)];
      return moved > 0 ? uPlot.rangeNum(low, high, 0.1, true) : [low - (Math.abs(low) || 1) / 10, high + (Math.abs(high) || 1) / 10];
    };
  }

  /** @type {TimeAxis} */ const CLOCK = { incrs: STEPS_S, values: clock, say: Dom.clock, shortestS: SHORTEST_ZOOM_S };

  /** As many digits as tell two marks of an axis apart.
   * @param {any} _ @param {number[]} marks @param {number} __ @param {number} ___ @param {number} step */
  function digits(_, marks, __, ___, step) {
    let places = 0; // as many as the step has: 0.25 needs two
    while (places < 9 && Math.abs(step * 10 ** places - Math.round(step * 10 ** places)) > 1e-6) places += 1;
    return marks.map((mark) => mark.toFixed(places));
  }

  const SHAPES = /** @type {Record<string, {colour: string, dash: number[], sign: string}>} */ ({
    trip: { colour: "--alarm", dash: [], sign: "▼" },
    load: { colour: "--series-2", dash: [2, 3], sign: "◆" },
    command: { colour: "--text-soft", dash: [5, 4], sign: "▸" },
  });

  /** Draw a line and a sign for each mark. @param {any} chart @param {Mark[]} marks */
  function drawMarks(chart, marks) {
    const { ctx, bbox } = chart;
    ctx.save();
    ctx.font = `${11 * devicePixelRatio}px system-ui`;
    for (const { timeS, kind } of marks) {
      const x = chart.valToPos(timeS, "x", true);
      if (x < bbox.left || x > bbox.left + bbox.width) continue;
      const shape = SHAPES[kind] ?? SHAPES.command;
      ctx.strokeStyle = ctx.fillStyle = colour(shape.colour);
      ctx.setLineDash(shape.dash);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
      ctx.fillText(shape.sign, x + 2, bbox.top + 11 * devicePixelRatio);
    }
    ctx.restore();
  }

  /** Make one plot.
   * @param {HTMLElement} parent @param {string} title @param {any[]} lines
   * @param {{marks: Mark[], zoom: (window: Window|null) => void, axis?: TimeAxis}} owner
   * @param {() => [number|null, number|null]|undefined} [limits] @param {any[]} [bands] */
  function plot(parent, title, lines, owner, limits = () => undefined, bands = []) {
    const frame = Dom.make("figure.plot", {}, Dom.make("figcaption", {}, title));
    parent.append(frame);
    const { incrs, values, say, shortestS } = owner.axis ?? CLOCK;
    const axis = () => ({ stroke: colour("--text-soft"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "11px system-ui", size: 58, values: digits });
    const chart = new uPlot({
      width: 300, height: HEIGHT,
      cursor: { sync: { key: SYNC }, points: { size: 5 }, drag: { x: true, y: false, setScale: false } },
      legend: { live: true },
      axes: [{ ...axis(), size: 26, space: 70, incrs, values }, { ...axis(), space: 16 }],
      scales: { y: { range: reach(limits) } },
      series: [{ label: "time", value: (/** @type {any} */ _, /** @type {number|null} */ at) => (at == null ? "–" : say(at)) }, ...lines.map(series)],
      bands,
      hooks: {
        draw: [(/** @type {any} */ own) => drawMarks(own, owner.marks)],
        setSelect: [(/** @type {any} */ own) => {
          const { left, width } = own.select;
          if (width < 4) return;
          const from = own.posToVal(left, "x"), to = own.posToVal(left + width, "x");
          own.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
          if (to - from >= shortestS) owner.zoom({ from, to });
        }],
      },
    }, lines.map(() => []).concat([[]]), frame);
    chart.over.addEventListener("dblclick", () => owner.zoom(null));
    frame.querySelector(".u-legend")?.setAttribute("role", "presentation"); // values under the mouse, not a table of data
    const resize = new ResizeObserver(() => {
      chart.setSize({ width: Math.max(200, frame.clientWidth), height: HEIGHT });
    });
    resize.observe(frame);
    return {
      frame,
      /** @param {any[]} data @param {Window} window */
      show(data, window) {
        chart.batch(() => { chart.setData(data); chart.setScale("x", { min: window.from, max: window.to }); });
      },
      end() { resize.disconnect(); chart.destroy(); },
    };
  }

  /** The plots of a drive page.
   * @param {HTMLElement} parent @param {DriveView} drive */
  function open(parent, drive) {
    let spanS = SPANS_S[0];
    /** @type {Window|null} */ let zoomed = null;
    const owner = { marks: drive.marks, zoom(/** @type {Window|null} */ window) { zoomed = window; redraw(); } };
    const bar = Dom.make("div.spans", { role: "group", "aria-label": "time shown" });
    for (const choice of SPANS_S) {
      bar.append(Dom.make("button", { type: "button", onclick: () => { spanS = choice; owner.zoom(null); } }, `${choice / 60} min`));
    }
    const back = Dom.make("button", { type: "button", hidden: true, onclick: () => owner.zoom(null) }, "Show all");
    bar.append(back, Dom.make("small.hint", {}, "drag to zoom"));
    parent.append(bar);
    const unit = drive.unit ? `, ${drive.unit}` : "";
    const output = plot(parent, `${drive.outputName}${unit}`, [
      { label: "reference", colour: "--series-2", step: true, dash: [6, 4] },
      { label: drive.outputName, colour: "--series-1" },
    ], owner, () => drive.state?.limits.setpoint);
    const given = drive.given;
    const voltage = plot(parent, [given.name, given.unit].filter(Boolean).join(", "), [
      { label: "asked for", colour: "--series-2", step: true, dash: [6, 4] },
      { label: "applied", colour: "--series-1" },
    ], owner, () => drive.state?.limits.boost_V);
    const strip = Dom.make("canvas.strip", { "aria-label": "controller in force and verdict over time" });
    parent.append(Dom.make("figure.plot", {}, Dom.make("figcaption", {}, "controller in force: adaptive tall and blue, fixed low and grey; dots below where the estimate is refused"), strip));
    const key = Dom.make("p.hint.key");
    parent.append(key);
    /** @type {Map<string, ReturnType<typeof plot>>} */ const estimates = new Map();
    let drawn = "";

    function redraw() {
      drawn = "";
      [...bar.children].slice(0, SPANS_S.length).forEach((button, i) => Dom.mark(button, "aria-pressed", String(!zoomed && SPANS_S[i] === spanS)));
      back.hidden = !zoomed;
      draw();
    }

    function draw() {
      const version = `${drive.version} ${drive.slowVersion} ${parent.clientWidth}`; // a strip is as wide as the plots
      if (drawn === version) return;
      drawn = version;
      const points = course(drive);
      const newest = Math.max(points[points.length - 1]?.timeS ?? -Infinity, -Infinity);
      if (!Number.isFinite(newest)) return;
      const window = zoomed ?? { from: newest - spanS, to: newest };
      const shown = within(points, window);
      const time = shown.map((one) => one.timeS);
      output.show([time, shown.map((one) => one.reference), shown.map((one) => one.output)], window);
      voltage.show([time, shown.map((one) => one.asked_V), shown.map((one) => one.boost_voltage_V)], window);
      const rows = within(drive.slowRows.map((row) => ({ ...row, timeS: Drives.timeS(row.time) })), window);
      for (const name of Object.keys(drive.load?.estimates ?? {})) drawEstimate(name, rows, window);
      const inner = /** @type {HTMLElement} */ (output.frame.querySelector(".u-over"));
      drawStrip(/** @type {HTMLCanvasElement} */ (strip), rows, window, inner);
      Dom.say(key, drive.marks.filter((one) => one.timeS >= window.from && one.timeS <= window.to).slice(-6)
        .map((one) => `${(SHAPES[one.kind] ?? SHAPES.command).sign}\u00a0${Dom.clock(one.timeS)}\u00a0${one.text}`).join("   "));
    }

    /** @param {string} name @param {(Load & {timeS: number})[]} rows @param {Window} window */
    function drawEstimate(name, rows, window) {
      let own = estimates.get(name);
      if (!own) {
        const { text, unit } = Contract.named(name, Object.keys(drive.load?.estimates ?? {}), drive.ownUnit, drive.given.unit);
        own = plot(parent, `estimate: ${text}${unit ? `, ${unit}` : ""}, ± 2 σ`, [
          { label: "high", colour: "--series-1", band: true },
          { label: "low", colour: "--series-1", band: true },
          { label: text, colour: "--series-1" },
        ], owner, undefined, [{ series: [1, 2], fill: colour("--band") }]);
        estimates.set(name, own);
      }
      const at = (/** @type {Load} */ row, /** @type {number} */ sigmas) => {
        const one = row.estimates?.[name];
        if (one?.value == null) return null;
        return sigmas && one.std == null ? null : one.value + sigmas * (one.std ?? 0);
      };
      own.show([rows.map((r) => r.timeS), rows.map((r) => at(r, 2)), rows.map((r) => at(r, -2)), rows.map((r) => at(r, 0))], window);
    }

    redraw();
    return {
      draw,
      end() {
        for (const one of [output, voltage, ...estimates.values()]) one.end();
      },
    };
  }

  /** The slow steps of before the first reading, then the readings. @param {DriveView} drive @returns {Point[]} */
  function course(drive) {
    const first = drive.points[0]?.timeS ?? Infinity;
    const slow = drive.slowRows.filter((row) => Drives.timeS(row.time) < first).map((row) => ({
      timeS: Drives.timeS(row.time), output: row.output, reference: row.reference,
      boost_voltage_V: row.applied_V, asked_V: row.boost_reference_V,
    }));
    return [...slow, ...drive.points];
  }

  /** What lies in a window, and one more on each side. @template {{timeS: number}} T @param {T[]} rows @param {Window} window */
  function within(rows, { from, to }) {
    let first = rows.findIndex((row) => row.timeS >= from);
    if (first < 0) first = rows.length;
    let last = rows.length;
    while (last > first && rows[last - 1].timeS > to) last -= 1;
    return rows.slice(Math.max(0, first - 1), last + 1);
  }

  /** Draw the controller in force and the verdicts at the same times as the plot above.
   * @param {HTMLCanvasElement} canvas @param {(Load & {timeS: number})[]} rows @param {Window} window
   * @param {HTMLElement} inner area of the plot above */
  function drawStrip(canvas, rows, window, inner) {
    const width = (canvas.width = inner.clientWidth || 300);
    canvas.style.width = `${width}px`;
    canvas.style.marginLeft = `${inner.offsetLeft}px`;
    canvas.height = 26;
    const pen = canvas.getContext("2d");
    if (!pen || rows.length < 2) return;
    const scale = width / (window.to - window.from);
    for (let i = 1; i < rows.length; i += 1) {
      const x = (rows[i - 1].timeS - window.from) * scale;
      const w = Math.ceil((rows[i].timeS - rows[i - 1].timeS) * scale) + 1;
      const adaptive = rows[i].controller === "adaptive";
      pen.fillStyle = colour(adaptive ? "--series-1" : "--text-soft");
      pen.fillRect(x, adaptive ? 0 : 10, w, adaptive ? 16 : 6);
      if (rows[i].accepted) continue;
      pen.fillStyle = colour("--warn");
      for (let dot = x; dot < x + w; dot += 8) pen.fillRect(dot, 20, 4, 4);
    }
  }

  return { open, reach, plot };
})();
