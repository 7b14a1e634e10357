"use strict";
// One drive: what is, how it came, and what can be done.

const DrivePage = (() => {
  const NEAR = 0.1; // share of a trip's limit
  const LATEST = 3; // events that are in sight at once
  /** @param {HTMLElement} parent @param {DriveView} drive */
  function open(parent, drive) {
    const answer = Dom.make("p.answer", { "aria-live": "polite" });
    const title = Dom.make("h1", {}, drive.name);
    const state = Dom.make("span.chip");
    const open = Dom.make("strong.unconfirmed");
    const age = Dom.make("span.age");
    const stop = Controls.stop(drive, answer, () => bar);
    const now = present();
    const bar = Dom.make("header.bar", {}, Dom.make("a", { href: "#", "aria-label": "all drives" }, "‹ drives"), title, state, open, age, Dom.make("a", { href: `#${drive.name}/sessions` }, "sessions"), stop);
    const plotted = Dom.make("section.plots", { "aria-label": "plots" });
    const latest = Dom.make("ol.latest", { "aria-label": "latest events" });
    const events = Dom.make("ol.events");
    const controls = Controls.panel(drive, answer);
    const alarm = banner(controls.reset);
    parent.append(
      bar,
      alarm.root,
      latest,
      Dom.make("div.columns", {}, Dom.make("div.left", {}, now.root, now.details), plotted, controls.root),
      Dom.make("section", {}, Dom.make("h2", {}, "Events"), events),
    );
    const plots = Plots.open(plotted, drive), health = HealthPlot.open(plotted, drive);
    Link.askHistory(drive.name);
    let seen = -1;
    const built = drive.build;

    function draw() {
      drawState(drive, state, age);
      alarm.draw(drive);
      Dom.say(open, drive.openStop && `${drive.openStop}: the bridge is not reported off`);
      parent.classList.toggle("stale", !drive.live);
      now.draw(drive);
      controls.draw();
      plots.draw();
      health.draw();
      if (seen === drive.eventVersion) return;
      seen = drive.eventVersion;
      latest.replaceChildren(...drive.events.slice(0, LATEST).map((one) => eventRow(one, drive.name)));
      events.replaceChildren(...drive.events.slice(0, 30).map((one) => eventRow(one, drive.name)));
    }

    /** @param {KeyboardEvent} key */
    function press(key) {
      if (key.key.toLowerCase() !== "s" || key.ctrlKey || key.metaKey || key.altKey || takesLetters(key.target)) return;
      key.preventDefault(); // some browsers write the letter into a field of a number
      Controls.ask(drive, answer, bar, "disable");
    }
    document.addEventListener("keydown", press);
    return { draw, outdated: () => drive.build !== built, end() { document.removeEventListener("keydown", press); plots.end(); health.end(); } };
  }

  /** Whether a letter that is typed there means something else. @param {EventTarget|null} target */
  function takesLetters(target) {
    if (target instanceof HTMLInputElement) return target.type !== "number";
    return target instanceof HTMLSelectElement || target instanceof HTMLTextAreaElement;
  }

  /** @param {DriveView} drive @param {HTMLElement} chip @param {HTMLElement} age */
  function drawState(drive, chip, age) {
    Dom.say(chip, drive.shown);
    Dom.mark(chip, "data-state", drive.shown);
    Dom.say(age, drive.ageText);
  }

  /** A trip: when, why, what to do, and the button that ends it. @param {HTMLElement} reset */
  function banner(reset) {
    const cause = Dom.make("strong"), kind = Dom.make("small.kind"), advice = Dom.make("p"), record = Dom.make("a", {}, "record of this trip");
    const root = Dom.make("div.alarm", { role: "alert", hidden: true }, Dom.make("div", {}, cause, kind, advice, record), reset);
    return { root, draw(/** @type {DriveView} */ { name, state }) {
      root.hidden = !state?.trip;
      if (!state?.trip) return;
      const { time, remedy } = state.last_trip ?? { time: state.since, remedy: "" };
      Dom.say(cause, `Trip, ${Dom.date(Drives.timeS(time))}: ${Drives.cause(state)}`);
      Dom.say(kind, state.trip_kind);
      Dom.mark(kind, "title", Drives.explain(state.trip_kind));
      Dom.mark(record, "href", `#${name}/sessions/@${time}`);
      Dom.say(advice, remedy && `What to do: ${remedy}`);
    } };
  }

  /** What is now: large numbers, each with unit, limits and age. */
  function present() {
    const output = Dom.make("p.large");
    const name = Dom.make("h2");
    const bar = Dom.make("div.range", { "aria-hidden": "true" }, Dom.make("i.mark.value"), Dom.make("i.mark.wanted"), Dom.make("small"), Dom.make("small"));
    const first = Dom.make("dl.values"), rest = Dom.make("dl.values");
    const root = Dom.make("section.now", {}, name, output, bar, first);
    const details = Dom.make("section.details", {}, Dom.make("h2", {}, "Measurements and estimates"), rest);
    return { root, details, draw: (/** @type {DriveView} */ drive) => drawPresent(drive, { output, name, bar, first, rest }) };
  }

  /** @param {DriveView} drive @param {Record<"output"|"name"|"bar"|"first"|"rest", HTMLElement>} parts */
  function drawPresent(drive, parts) {
    const { state, fast, load } = drive;
    const value = fast?.output ?? load?.output;
    Dom.say(parts.name, drive.outputName);
    Dom.say(parts.output, Dom.measured(value, drive.unit));
    drawRange(parts.bar, state?.limits?.setpoint, value, load?.reference ?? state?.setpoint);
    const lateness = fast?.lateness_us;
    drawRows(parts.first, [
      ["reference", Dom.number(load?.reference ?? state?.setpoint, drive.unit), wave(state)],
      ["reachable", limitText(state?.reach, drive.unit).replace("limits ", "") || "–", ""],
      ["controller in force", state?.controller ?? "–", state?.reason || `asked for: ${state?.mode ?? "–"}`],
      ...programRow(state?.program, fast?.left_s),
    ]);
    const { name: given, unit } = drive.given;
    drawRows(parts.rest, [
      [`${given} asked for`, Dom.number(load?.boost_reference_V, unit), limitText(state?.limits?.boost_V, unit)],
      [given, Dom.number(fast?.boost_voltage_V, unit), limitText(state?.limits?.boost_trip_V, unit)],
      ["load power", Dom.number(fast?.load_power_W, "W"), limitText(state?.limits?.power_W, "W")],
      ["line", Dom.number(fast?.line_voltage_V, "V"), ""],
      marginRow(drive.outputName, value, state?.limits?.output_trip, drive.unit),
      marginRow(given, fast?.boost_voltage_V, state?.limits?.boost_trip_V, unit),
      marginRow("load power", fast?.load_power_W, state?.limits?.power_W, "W"),
      ["estimate", load ? (load.accepted ? "accepted" : "refused") : "–", load?.reason ?? ""],
      ...Object.entries(load?.estimates ?? {}).map(([name, one], _, all) => estimateRow(name, one, all.map(([each]) => each), drive.ownUnit, unit)),
      ["response to a step", load?.response_spread == null ? "–" : `± ${Dom.number(100 * load.response_spread, "%", 2)}`, "by what the accepted estimates leave open"],
      ["pole", Dom.number(state?.pole), `per slow period; ${limitText(state?.limits?.pole, "")}`],
      ["lateness of a tick", milliseconds(lateness?.p99), lateness ? `99 %; longest ${milliseconds(lateness.max)}` : ""],
      ["ticks", Dom.number(fast?.ticks, "", 9), fast ? `${Dom.number(fast.missed)} missed, ${Dom.number(fast.held)} held` : ""],
      ["refused frames", fast ? String(refused(fast.bus)) : "–", fast ? `of ${fast.bus.received ?? 0}` : ""],
      ...Object.entries(fast?.sensors ?? {}).map(([name, one]) => [`sensors ${name}`, one.up ? "up" : "down", one.detail]),
      ["clock", state?.clock ?? "–", Number.isFinite(drive.clockS) ? Dom.clock(drive.clockS) : ""],
    ]);
  }

  /** The program that runs, or has run last. @param {Program|null|undefined} program @param {number|null|undefined} leftS */
  function programRow(program, leftS) {
    if (!program) return [];
    return [[`program ${program.name}`, leftS == null ? "–" : `${Dom.left(leftS)} left`, program.text]];
  }

  /** How far a quantity is from its trip; marked where less than a tenth of the limit is left.
   * @param {string} name @param {number|null|undefined} value
   * @param {[number|null, number|null]|undefined} limits @param {string} unit */
  function marginRow(name, value, limits, unit) {
    const [low, high] = limits ?? [null, null];
    const known = value != null && (low != null || high != null);
    const left = known ? Math.min((high ?? Infinity) - value, value - (low ?? -Infinity)) : null;
    const near = left != null && left < NEAR * Math.max(Math.abs(low ?? 0), Math.abs(high ?? 0));
    return [`${name} to trip`, Dom.number(left, unit, 3), limitText(limits, unit).replace("limits ", "within "), near ? "near" : ""];
  }

  /** @param {string} name @param {Estimate} one @param {string[]} names @param {string} outputUnit
   * @param {string} givenUnit */
  function estimateRow(name, one, names, outputUnit, givenUnit) {
    const { text, unit } = Contract.named(name, names, outputUnit, givenUnit);
    const doubt = one.std == null ? "uncertainty unknown" : `± ${Dom.number(2 * one.std, unit, 2)} (2 σ)`;
    const known = name === "input_offset" || !(2 * (one.std ?? 0) >= Math.abs(one.value ?? Infinity));
    return [text, known ? Dom.number(one.value, unit) : "not known", doubt];
  }

  /** @param {number|null|undefined} us */
  function milliseconds(us) {
    return Dom.number(us == null ? null : us / 1000, "ms", 2);
  }

  /** @param {HTMLElement} list @param {string[][]} rows */
  function drawRows(list, rows) {
    while (list.children.length > rows.length) list.lastElementChild?.remove();
    rows.forEach(([name, value, remark, mark], i) => {
      if (!list.children[i]) list.append(Dom.make("div", {}, Dom.make("dt"), Dom.make("dd"), Dom.make("dd")));
      const [dt, dd, beside] = list.children[i].children;
      Dom.say(dt, name);
      Dom.say(dd, value);
      Dom.mark(dd, "data-mark", mark ?? "");
      Dom.say(beside, remark);
    });
  }

  /** A range from end to end, with its limits. @param {HTMLElement} bar @param {[number|null, number|null]|undefined} range
   * @param {number|null|undefined} value @param {number|null|undefined} wanted */
  function drawRange(bar, range, value, wanted) {
    const [low, high] = range ?? [null, null];
    bar.hidden = low == null || high == null;
    if (low == null || high == null) return;
    const at = (/** @type {number|null|undefined} */ x) => `${Math.min(100, Math.max(0, (100 * ((x ?? low) - low)) / (high - low)))}%`;
    /** @type {HTMLElement} */ (bar.children[0]).style.left = at(value);
    /** @type {HTMLElement} */ (bar.children[1]).style.left = at(wanted);
    [low, high].forEach((end, i) => Dom.say(bar.children[2 + i], Dom.number(end)));
  }

  /** @param {State|null} state */
  function wave(state) {
    const own = state?.waveform;
    return own ? `${own.shape} ${Dom.number(own.low)} to ${Dom.number(own.high, state?.output?.display.unit)}, period ${Dom.number(own.period_s, "s")}` : limitText(state?.limits?.setpoint, state?.output?.display.unit ?? "");
  }

  /** @param {[number|null, number|null]|undefined} range @param {string} unit */
  function limitText(range, unit) {
    if (!range || (range[0] == null && range[1] == null)) return "";
    if (range[0] == null) return `at most ${Dom.number(range[1], unit)}`;
    if (range[1] == null) return `at least ${Dom.number(range[0], unit)}`;
    return `limits ${Dom.number(range[0])}…${Dom.number(range[1], unit)}`;
  }

  /** @param {Record<string, number|null>} bus */
  function refused(bus) {
    const kinds = ["wrong_length", "wrong_checksum", "counter_stuck", "out_of_range", "exceptions"];
    return kinds.reduce((sum, kind) => sum + (bus[kind] ?? 0), 0);
  }

  /** @param {DriveEvent} event @param {string} drive */
  function eventRow(event, drive) {
    const remedy = event.remedy && !event.detail.includes(event.remedy) ? Dom.make("small", {}, event.remedy) : "";
    const kind = event.trip_kind ? Dom.make("small.kind", { title: Drives.explain(event.trip_kind) }, event.trip_kind) : "";
    return Dom.make("li", { "data-severity": event.severity }, Dom.make("time", {}, Dom.clock(Drives.timeS(event.time))), Dom.make("b", {}, event.kind), event.detail, kind, remedy, ...(event.trip_kind ? [Dom.make("a", { href: `#${drive}/sessions/@${event.time}` }, "its record")] : []));
  }

  return { open };
})();
