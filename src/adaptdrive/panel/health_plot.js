"use strict";
// The load over the weeks, in per cent of its first days: a small plot, and what it means.

const HealthPlot = (() => {
  const HEIGHT = 130;
  const COLOURS = ["--series-1", "--series-2", "--text-soft"];

  /** @param {HTMLElement} parent @param {DriveView} drive */
  function open(parent, drive) {
    const frame = Dom.make("div"), meaning = Dom.make("p.hint");
    const root = Dom.make("figure.plot", { hidden: true }, Dom.make("figcaption", {}, "health: change since the first days, %"), frame, meaning);
    parent.append(root);
    /** @type {any} */ let chart = null;
    /** @type {Health|null} */ let drawn = null;
    const resize = new ResizeObserver(() => chart?.setSize({ width: Math.max(200, frame.clientWidth), height: HEIGHT }));
    resize.observe(frame);

    function draw() {
      const health = drive.health;
      if (!health || health === drawn) return;
      drawn = health;
      const names = Object.keys(health.courses);
      root.hidden = names.length === 0;
      if (root.hidden) return;
      chart?.destroy();
      chart = new uPlot(options(names, frame.clientWidth), [health.times, ...names.map((name) => health.courses[name])], frame);
      Dom.say(meaning, Object.values(health.quantities).map((one) => one.meaning).filter(Boolean).join("; "));
    }
    return { draw, end() { resize.disconnect(); chart?.destroy(); } };
  }

  /** @param {string[]} names @param {number} width */
  function options(names, width) {
    const colour = (/** @type {string} */ name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    const axis = { stroke: colour("--text-soft"), grid: { stroke: colour("--line"), width: 1 } };
    const line = (/** @type {string} */ name, /** @type {number} */ i) => ({
      label: name.replaceAll("_", " "), stroke: colour(COLOURS[i % COLOURS.length]), width: 1.5, spanGaps: true,
      points: { show: true, size: 3 }, value: (/** @type {any} */ _, /** @type {number|null} */ value) => Dom.number(value, "%", 3),
    });
    return { width: Math.max(200, width), height: HEIGHT, cursor: { drag: { x: false, y: false } }, axes: [axis, axis], series: [{}, ...names.map(line)] };
  }

  return { open };
})();
