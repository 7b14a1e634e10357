"use strict";
// All drives of the broker: a trip rises to the top; what is stale fades and shows since when.

const SitePage = (() => {
  const HEADS = ["drive", "state", "output", "course", "set-point", "controller", "since", "data", "stop"];
  const COURSE_S = 120;
  const ORDER = ["tripped", "stopping", "running", "manual", "starting", "standby"];

  /** @param {HTMLElement} parent */
  function open(parent) {
    const rows = Dom.make("tbody");
    const answer = Dom.make("p.answer", { "aria-live": "polite" });
    const bar = Dom.make("header.bar", {}, Dom.make("h1", {}, "Drives"), Dom.make("button.quiet", { type: "button", onclick: () => Login.change() }, "Other user"));
    const hint = Dom.make("p.hint", {}, "No drive has been heard on this broker yet.");
    parent.append(
      bar,
      Dom.make("div.scroll", {}, Dom.make("table.site", {}, Dom.make("thead", {}, Dom.make("tr", {}, ...HEADS.map((h) => Dom.make("th", { scope: "col" }, h)))), rows)),
      hint,
    );
    /** @type {Map<string, HTMLElement>} */ const known = new Map();

    function draw() {
      const drives = [...Drives.all.values()].filter((drive) => drive.state || drive.availability !== "unknown");
      drives.sort((a, b) => rank(a) - rank(b) || a.name.localeCompare(b.name));
      hint.hidden = drives.length > 0;
      drives.forEach((drive, i) => {
        let row = known.get(drive.name);
        if (!row) {
          row = newRow(drive, Controls.stop(drive, answer, () => bar));
          known.set(drive.name, row);
        }
        fill(row, drive);
        if (rows.children[i] !== row) rows.insertBefore(row, rows.children[i] ?? null);
      });
    }
    return { draw, outdated: () => false, end() {} };
  }

  /** @param {DriveView} drive */
  function rank(drive) {
    if (drive.availability !== "online") return 1;
    const at = ORDER.indexOf(drive.state?.state ?? "");
    return at < 0 ? ORDER.length : at === 0 ? 0 : at + 1;
  }

  /** A row whose whole area is the link to its drive, but for its stop.
   * @param {DriveView} drive @param {HTMLElement} stop */
  function newRow(drive, stop) {
    const link = Dom.make("a.whole", { href: `#${drive.name}` }, drive.name);
    const cells = HEADS.slice(1).map((head) => Dom.make("td", { "data-head": head }));
    cells[2].append(Dom.make("canvas.course", { width: 120, height: 28, role: "img", "aria-label": "output of the last two minutes" }));
    cells[cells.length - 1].append(stop);
    return Dom.make("tr", {}, Dom.make("th", { scope: "row" }, link), ...cells);
  }

  /** @param {HTMLElement} row @param {DriveView} drive */
  function fill(row, drive) {
    const cells = [...row.children].slice(1);
    const state = drive.state;
    const shown = drive.openStop ? `${drive.shown}, ${drive.openStop}` : drive.shown;
    /** @type {(string|null)[]} */ const texts = [
      state?.trip && drive.availability === "online" ? `${shown}: ${Drives.cause(state)}` : shown,
      Dom.measured(drive.fast?.output ?? drive.load?.output, drive.unit),
      null,
      state?.waveform ? `${state.waveform.shape} wave` : Dom.number(state?.setpoint, drive.unit),
      state ? (state.controller === state.mode ? state.controller : `${state.controller} (asked for ${state.mode})`) : "–",
      Dom.date(Drives.timeS(state?.since ?? state?.time ?? "")),
      drive.ageText,
    ];
    texts.forEach((text, i) => { if (text !== null) Dom.say(cells[i], text); });
    drawCourse(/** @type {HTMLCanvasElement} */ (cells[2].firstElementChild), drive.points);
    Dom.mark(cells[0], "data-state", drive.shown);
    const link = /** @type {HTMLElement} */ (row.querySelector(".whole"));
    Dom.mark(link, "title", drive.shown === "tripped" ? Drives.explain(state?.trip_kind ?? "") : "");
    row.classList.toggle("stale", !drive.live);
  }

  /** Draw the output of the last minutes, without an axis. @param {HTMLCanvasElement} canvas @param {Point[]} points */
  function drawCourse(canvas, points) {
    const pen = canvas.getContext("2d");
    const end = points[points.length - 1]?.timeS ?? 0;
    const shown = points.filter((one) => one.output !== null && one.timeS >= end - COURSE_S);
    if (!pen || shown.length < 2) return;
    const values = shown.map((one) => one.output ?? 0);
    const low = Math.min(...values), high = Math.max(...values), span = Math.max(high - low, 0.02 * Math.abs(high), 1e-9);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.strokeStyle = getComputedStyle(canvas).color;
    pen.lineWidth = 1.5;
    pen.beginPath();
    for (const one of shown) {
      const x = canvas.width * (1 - (end - one.timeS) / COURSE_S);
      pen.lineTo(x, 2 + (canvas.height - 4) * (0.5 - ((one.output ?? 0) - (low + high) / 2) / span));
    }
    pen.stroke();
  }

  return { open };
})();
