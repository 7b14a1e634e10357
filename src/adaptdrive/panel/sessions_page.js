"use strict";
// The sessions of one drive: the list, and the way to one of them, to two, or to that of a time.

const SessionsPage = (() => {
  const HEADS = ["start", "duration", "end", "trips", "size", "overlay"];
  const AT_ONCE = 100;
  const MOST_TRIPS = 3;
  const SAME_S = 2;

  /** @param {HTMLElement} parent @param {DriveView} drive @param {string} what names with + between them, or @TIME; empty for the list */
  function open(parent, drive, what) {
    const answer = Dom.make("p.answer", { "aria-live": "polite" }, "reading…");
    const state = Dom.make("span.chip");
    const back = what ? { href: `#${drive.name}/sessions`, text: "‹ sessions" } : { href: `#${drive.name}`, text: `‹ ${drive.name}` };
    const bar = Dom.make("header.bar", {}, Dom.make("a", { href: back.href }, back.text), Dom.make("h1", {}, `${drive.name}: ${what ? "session" : "sessions"}`), state, Controls.stop(drive, answer, () => bar));
    const body = Dom.make("div");
    parent.append(bar, answer, body);
    let ended = false;
    /** @type {{end: () => void} | null} */ let view = null;
    load(drive, what).then((make) => {
      if (ended) return;
      Dom.say(answer, "");
      view = make(body);
    }, (problem) => { if (!ended) refuse(body, answer, drive, problem); });
    function draw() {
      Dom.say(state, drive.shown);
      Dom.mark(state, "data-state", drive.shown);
    }
    return { draw, outdated: () => false, end() { ended = true; view?.end(); } };
  }

  /** Read what is to be shown; return what shows it.
   * @param {DriveView} drive @param {string} what @returns {Promise<(parent: HTMLElement) => {end: () => void} | null>} */
  async function load(drive, what) {
    const every = await Sessions.index(drive.name).catch(({ message }) => { throw new Unreachable(message); });
    if (!what) return (parent) => list(parent, drive, every);
    const focusS = what.startsWith("@") ? Date.parse(what.slice(1)) / 1000 : NaN;
    const names = what.startsWith("@") ? [at(every, focusS)] : what.split("+").slice(0, 2).map(decodeURIComponent);
    const shown = await Promise.all(names.map(async (name) => {
      const entry = every.find((one) => one.name === name.split("/")[0]);
      if (!entry) throw new Error(`${name} is not among the sessions: it was removed`);
      return { entry, data: await Sessions.overview(drive.name, name), zeroS: 0 };
    }));
    return (parent) => SessionView.open(parent, drive, shown, focusS);
  }

  /** The record of a trip, else the session, of a time. @param {SessionEntry[]} every @param {number} timeS */
  function at(every, timeS) {
    const found = every.find((one) => one.startedS <= timeS + SAME_S);
    if (!found) throw new Error(`no session of ${Dom.date(timeS)} is listed`);
    const trip = found.trips.find((one) => Math.abs(one.timeS - timeS) < SAME_S);
    return trip ? `${found.name}/${trip.record}` : found.name;
  }

  class Unreachable extends Error {}

  /** Say what could not be read, and what to do. @param {HTMLElement} parent @param {HTMLElement} answer @param {DriveView} drive @param {Error} problem */
  function refuse(parent, answer, drive, problem) {
    Dom.mark(answer, "data-kind", "refused");
    Dom.say(answer, problem instanceof Unreachable ? `The sessions of ${drive.name} are not reachable: ${problem.message}.` : `${problem.message}.`);
    if (!(problem instanceof Unreachable)) return;
    parent.append(Dom.make("section", {}, Dom.make("p", {}, "The list begins when the first session ends, an hour of it is over, or 10 s after its first trip. If it is there, the server of this page lacks the folder:"), Dom.make("ul", {},
      Dom.make("li", {}, "at a desk: ", Dom.make("code", {}, "adaptdrive panel --sessions FOLDER")),
      Dom.make("li", {}, "elsewhere: the folder, readable by the server, as ", Dom.make("code", {}, `sessions/${drive.name}`), " next to this page; docs/deployment.md has the commands"))));
  }

  /** @param {HTMLElement} parent @param {DriveView} drive @param {SessionEntry[]} every */
  function list(parent, drive, every) {
    /** @type {HTMLInputElement[]} */ const chosen = [];
    const overlay = Dom.make("button", { type: "button", disabled: true, onclick: () => { location.hash = SessionView.link(drive, chosen.map((one) => one.value)); } }, "Overlay two");
    const rows = Dom.make("tbody");
    const more = Dom.make("button", { type: "button", onclick: () => add() }, "Show older ones");
    const choose = (/** @type {Event} */ event) => {
      const box = /** @type {HTMLInputElement} */ (event.target);
      if (box.checked) chosen.push(box);
      else chosen.splice(chosen.indexOf(box), 1);
      if (chosen.length > 2) Object.assign(chosen.shift() ?? box, { checked: false });
      overlay.toggleAttribute("disabled", chosen.length < 2);
    };
    function add() {
      rows.append(...every.slice(rows.children.length, rows.children.length + AT_ONCE).map((one) => row(drive, one, choose)));
      more.hidden = rows.children.length >= every.length;
    }
    add();
    parent.append(Dom.make("div.spans", {}, overlay, Dom.make("small.hint", {}, `${every.length} sessions`)),
      Dom.make("table.site.sessions", {}, Dom.make("thead", {}, Dom.make("tr", {}, ...HEADS.map((head) => Dom.make("th", { scope: "col" }, head)))), rows), more);
    return null;
  }

  /** @param {DriveView} drive @param {SessionEntry} one @param {(event: Event) => void} choose */
  function row(drive, one, choose) {
    const start = Dom.date(one.startedS);
    const trips = one.trips.slice(-MOST_TRIPS).map((trip) => Dom.make("a.trip", { href: SessionView.link(drive, [`${one.name}/${trip.record}`]), title: trip.text }, `▲ ${Dom.clock(trip.timeS)}`));
    const duration = one.endS - one.startedS;
    const cells = [
      Number.isFinite(duration) ? Dom.span(duration) : "–", SessionView.ending(one), one.trips.length ? `${one.trips.length}: ` : "none", Dom.number(one.bytes / 1e6, "MB", 3),
    ].map((text, i) => Dom.make("td", { "data-head": HEADS[i + 1] }, text));
    cells[2].append(...trips);
    const box = Dom.make("input", { type: "checkbox", value: one.name, "aria-label": `overlay the session of ${start}`, onchange: choose });
    return Dom.make("tr", {}, Dom.make("th", { scope: "row" }, Dom.make("a.whole", { href: SessionView.link(drive, [one.name]) }, start)), ...cells, Dom.make("td", { "data-head": HEADS[5] }, box));
  }

  return { open };
})();
