"use strict";
// All drives of the broker: a trip rises to the top; what is stale fades and shows since when.

const SitePage = (() => {
  const HEADS = ["drive", "state", "output", "set-point", "controller", "since", "data"];
  const ORDER = ["tripped", "stopping", "running", "manual", "starting", "standby"];

  /** @param {HTMLElement} parent */
  function open(parent) {
    const rows = Dom.make("tbody");
    const hint = Dom.make("p.hint", {}, "No drive has been heard on this broker yet.");
    parent.append(
      Dom.make("header.bar", {}, Dom.make("h1", {}, "Drives")),
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
          row = newRow(drive.name);
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

  /** @param {string} name */
  function newRow(name) {
    const link = Dom.make("a", { href: `#${name}` }, name);
    return Dom.make("tr", {}, Dom.make("th", { scope: "row" }, link), ...HEADS.slice(1).map((head) => Dom.make("td", { "data-head": head })));
  }

  /** @param {HTMLElement} row @param {DriveView} drive */
  function fill(row, drive) {
    const cells = [...row.children].slice(1);
    const state = drive.state;
    const shown = drive.openStop ? `${drive.shown}, ${drive.openStop}` : drive.shown;
    const texts = [
      state?.trip && drive.availability === "online" ? `${shown}: ${Drives.cause(state)}` : shown,
      Dom.measured(drive.fast?.output ?? drive.load?.output, drive.unit),
      state?.waveform ? `${state.waveform.shape} wave` : Dom.number(state?.setpoint, drive.unit),
      state ? (state.controller === state.mode ? state.controller : `${state.controller} (asked for ${state.mode})`) : "–",
      since(state?.since ?? state?.time ?? ""),
      drive.ageText,
    ];
    texts.forEach((text, i) => Dom.say(cells[i], text));
    Dom.mark(cells[0], "data-state", drive.shown);
    row.classList.toggle("stale", !drive.live);
  }

  /** A time to the second. @param {string} time */
  function since(time) {
    return time ? `${time.replace("T", " ").slice(0, 19)} UTC` : "–";
  }

  return { open };
})();
