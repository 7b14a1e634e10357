"use strict";
// What can be asked of a drive. A control shows what the daemon answered and never moves by itself.

const Controls = (() => {
  const CONFIRM_S = 5;
  const LEVELS = new Set(["setpoint", "waveform"]); // in the unit in which the output is shown
  const TURNS = [["Pause", "pause"], ["Resume", "resume"], ["Skip step", "skip"], ["End program", "stop"]];

  /** Ask, and show "sent", then the answer, after the control that asked.
   * @param {DriveView} drive @param {HTMLElement} answer @param {Element} place
   * @param {string} verb @param {unknown} [value] */
  async function ask(drive, answer, place, verb, value) {
    const unit = LEVELS.has(verb) ? drive.typedIn : undefined;
    const asked = value === undefined ? verb : [verb, typeof value === "object" ? "…" : value, unit].filter((one) => one !== undefined).join(" ");
    await report(answer, place, asked, () => Link.ask(drive.name, verb, value, unit));
  }

  /** @param {HTMLElement} answer @param {Element} place @param {string} asked @param {() => ReturnType<typeof Link.ask>} send */
  async function report(answer, place, asked, send) {
    if (place.nextElementSibling !== answer) place.after(answer);
    Dom.mark(answer, "data-kind", "sent");
    Dom.say(answer, `${asked}: sending…`);
    const { accepted, text } = await send();
    Dom.mark(answer, "data-kind", accepted ? "accepted" : "refused");
    Dom.say(answer, `${asked}: ${text}`);
    return accepted;
  }

  /** Take away an answer that is about an older value. @param {HTMLElement} answer */
  function settle(answer) {
    if (answer.dataset.kind !== "sent") Dom.say(answer, "");
  }

  /** A stop: one action, in any state.
   * @param {DriveView} drive @param {HTMLElement} answer @param {() => Element} place before the answer */
  function stop(drive, answer, place) {
    return Dom.make("button.stop", {
      type: "button", title: "Stop the drive (key: s)", onclick: () => ask(drive, answer, place(), "disable"),
    }, "STOP");
  }

  /** Keep an Enter that is held from clicking again and again. @param {Event} event */
  function ignoreRepeats(event) {
    const { key, repeat } = /** @type {KeyboardEvent} */ (event);
    if (key === "Enter" && repeat) event.preventDefault();
  }

  /** A button that needs a second press by itself, for everything that energises.
   * @param {string} text @param {(button: Element) => void} act */
  function twice(text, act) {
    let timer = 0;
    const reset = () => { clearTimeout(timer); timer = 0; Dom.say(button, text); button.classList.remove("armed"); };
    const press = (/** @type {Event} */ event) => {
      if (/** @type {MouseEvent} */ (event).detail > 1) return; // the second click of a double click
      if (timer) { reset(); act(button); return; }
      Dom.say(button, `${text}: press again`);
      button.classList.add("armed");
      timer = window.setTimeout(reset, 1000 * CONFIRM_S);
    };
    const button = Dom.make("button", { type: "button", onclick: press, onkeydown: ignoreRepeats }, text);
    return button;
  }

  /** @param {string} label @param {Record<string, string>} [attributes] */
  function field(label, attributes = {}) {
    const input = /** @type {HTMLInputElement} */ (Dom.make("input", { type: "number", step: "any", inputmode: "decimal", ...attributes }));
    return { input, row: Dom.make("label", {}, label, input) };
  }

  /** @param {string} text @param {(form: Element) => void} act */
  function form(text, act, /** @type {HTMLElement[]} */ ...rows) {
    const own = Dom.make("form", { onsubmit: (event) => { event.preventDefault(); act(own); } }, ...rows, Dom.make("button", { type: "submit" }, text));
    return own;
  }

  /** A plain button in a row, after which its answer is shown.
   * @param {string} text @param {(row: Element) => void} act @param {Record<string, string>} [attributes] */
  function button(text, act, attributes = {}) {
    const own = Dom.make("button", { type: "button", onclick: () => act(rowOf(own)), ...attributes }, text);
    return own;
  }

  /** The row of buttons or the banner that a button is in, or the button itself. @param {Element} own */
  function rowOf(own) {
    return own.closest(".row, .alarm") ?? own;
  }

  /** All controls of a drive.
   * @param {DriveView} drive @param {HTMLElement} answer */
  function panel(drive, answer) {
    const send = (/** @type {Element} */ place, /** @type {string} */ verb, /** @type {unknown} */ value) => ask(drive, answer, place, verb, value);
    const unit = () => (drive.unit ? `, ${drive.unit}` : "");
    const setpoint = field(`set-point${unit()}`);
    const low = field(`low${unit()}`), high = field(`high${unit()}`), period = field("period, s");
    const shape = /** @type {HTMLSelectElement} */ (Dom.make("select", { "aria-label": "shape" },
      ...["square", "sine", "triangle"].map((name) => Dom.make("option", {}, name))));
    const voltage = field([drive.given.name, drive.given.unit].filter(Boolean).join(", "));
    const pole = field("pole, per slow period", { min: "0", max: "1" });
    const modes = drive.state?.modes ?? ["fixed", "adaptive"];
    const reset = button("Reset trip", (place) => send(place, "reset", undefined));
    const choose = modes.map((name) => button(name, (place) => send(place, "mode", name), { "data-mode": name }));
    const body = Dom.make("div.controls", {},
      Dom.make("div.row", {}, twice("Enable", (own) => send(rowOf(own), "enable", undefined))),
      Dom.make("div.row", { role: "group", "aria-label": "controller" }, ...choose),
      form("Set", (place) => send(place, "setpoint", setpoint.input.valueAsNumber), setpoint.row),
      Dom.make("details", {}, Dom.make("summary", {}, "Waveform"),
        form("Start", (place) => send(place, "waveform", { shape: shape.value, low: low.input.valueAsNumber, high: high.input.valueAsNumber, period_s: period.input.valueAsNumber }),
          Dom.make("label", {}, "shape", shape), low.row, high.row, period.row),
        button("Hold the present value", (place) => send(place, "waveform", "off"))),
      Dom.make("details", {}, Dom.make("summary", {}, "Program"),
        Dom.make("div.row", {}, ...TURNS.map(([text, turn]) => button(text, (place) => send(place, "program", turn))))),
      Dom.make("details", {}, Dom.make("summary", {}, `${drive.given.name === "boost voltage" ? "Voltage" : drive.given.name} by hand, in mode manual`), form("Set", (place) => send(place, "voltage", voltage.input.valueAsNumber), voltage.row)),
      Dom.make("details", {}, Dom.make("summary", {}, "Pole"), form("Set", (place) => send(place, "pole", pole.input.valueAsNumber), pole.row)),
    );
    const viewer = Dom.make("p.viewer", { hidden: true });
    const root = Dom.make("section.side", {}, Dom.make("h2", {}, "Operate"), viewer, body, simulated(drive, answer), answer);
    root.addEventListener("input", () => settle(answer));
    const rights = seeRights(drive, viewer, body, reset);
    return {
      root,
      reset,
      draw() {
        rights();
        for (const button of choose) Dom.mark(button, "aria-pressed", String(button.dataset.mode === drive.state?.mode));
        const limits = drive.state?.limits ?? {};
        bound(setpoint.input, limits.setpoint);
        bound(low.input, limits.setpoint);
        bound(high.input, limits.setpoint);
        bound(pole.input, limits.pole);
        bound(voltage.input, limits.boost_V);
      },
    };
  }

  /** Show what the user may do, asked again until the drive answers.
   * @param {DriveView} drive @param {HTMLElement} viewer @param {...HTMLElement} parts of those who may command */
  function seeRights(drive, viewer, ...parts) {
    let known = false, asking = false;
    return async () => {
      if (known || asking) return;
      asking = true;
      const obstacle = await Link.obstacle(drive.name);
      asking = false;
      known = obstacle !== null && obstacle !== Link.UNANSWERED;
      viewer.hidden = obstacle === "";
      for (const part of parts) part.hidden = Boolean(obstacle);
      Dom.say(viewer, obstacle ?? "The daemon does not answer.");
    };
  }

  /** What only a simulated device can do, as it offers it.
   * @param {DriveView} drive @param {HTMLElement} answer */
  function simulated(drive, answer) {
    const act = async (/** @type {Element} */ place, /** @type {Feature} */ { text, request }) => {
      if (await report(answer, place, text, () => Link.disturb(drive.name, request))) drive.mark("load", text);
    };
    const buttons = drive.features.map((one) => button(one.text.replaceAll(/(\d) (?=\S)/g, "$1\u00a0"), (place) => act(place, one))); // a number stays with its unit
    const heading = Dom.make("h2", {}, "Simulated plant");
    return Dom.make("div.simulated", { hidden: buttons.length === 0 }, heading, Dom.make("div.row", {}, ...buttons));
  }

  /** @param {HTMLInputElement} input @param {[number|null, number|null]} [range] */
  function bound(input, range) {
    if (!range) return;
    if (range[0] != null) Dom.mark(input, "min", String(range[0]));
    if (range[1] != null) Dom.mark(input, "max", String(range[1]));
    Dom.mark(input, "placeholder", `${Dom.number(range[0])}…${Dom.number(range[1])}`);
  }

  return { panel, stop, ask };
})();
