"use strict";
// Elements without markup from outside: text is set as text, so that no payload can become a script.

const Dom = (() => {
  /**
   * Make an element.
   * @param {string} tag name, with classes behind dots: "div.card.wide"
   * @param {Record<string, string | boolean | number | EventListener>} [attributes] `on…` adds a listener
   * @param {...(Node | string)} children nodes, or text
   * @returns {HTMLElement}
   */
  function make(tag, attributes = {}, ...children) {
    const [name, ...classes] = tag.split(".");
    const element = document.createElement(name);
    if (classes.length) element.className = classes.join(" ");
    for (const [key, value] of Object.entries(attributes)) {
      if (typeof value === "function") element.addEventListener(key.slice(2), value);
      else if (typeof value === "boolean") element.toggleAttribute(key, value);
      else element.setAttribute(key, String(value));
    }
    element.append(...children);
    return element;
  }

  /** Replace text only where it differs, so that a selection and a screen reader are left alone.
   * @param {Element} element @param {string} text */
  function say(element, text) {
    if (element.textContent !== text) element.textContent = text;
  }

  /** @param {Element} element @param {string} name @param {string} value */
  function mark(element, name, value) {
    if (element.getAttribute(name) !== value) element.setAttribute(name, value);
  }

  /** Write a number with a fixed count of significant digits.
   * @param {unknown} value @param {string} [unit] @param {number} [digits] */
  function number(value, unit = "", digits = 4) {
    if (typeof value !== "number" || !Number.isFinite(value)) return "–";
    const text = Number(value.toPrecision(digits)).toString();
    return unit ? `${text}\u202f${unit}` : text;
  }

  /** Write a measured value with a constant count of digits, so that it does not jump.
   * @param {unknown} value @param {string} unit */
  function measured(value, unit) {
    if (typeof value !== "number" || !Number.isFinite(value)) return "–";
    const text = Math.abs(value) < 1e4 && Math.abs(value) >= 1e-3 ? value.toPrecision(4) : number(value);
    return unit ? `${text}\u202f${unit}` : text;
  }

  /** Write a time span. @param {number} seconds */
  function span(seconds) {
    if (!Number.isFinite(seconds)) return "never";
    if (seconds < 1) return "now";
    if (seconds < 90) return `${Math.round(seconds)} s`;
    if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
    return `${(seconds / 3600).toFixed(1)} h`;
  }

  /** Write a time that is left, to the second. @param {number|null|undefined} seconds */
  function left(seconds) {
    if (seconds == null) return "–";
    const whole = Math.round(seconds), two = (/** @type {number} */ value) => String(Math.floor(value) % 60).padStart(2, "0");
    return `${Math.floor(whole / 3600)}:${two(whole / 60)}:${two(whole)}`;
  }

  /** Write a time of day, in the time zone of the reader. @param {number} timeS seconds since 1970 */
  function clock(timeS) {
    return Number.isFinite(timeS) ? new Date(1000 * timeS).toLocaleTimeString([], { hourCycle: "h23" }) : "–";
  }

  /** Write a day and a time, in the time zone of the reader. @param {number} timeS seconds since 1970 */
  function date(timeS) {
    return Number.isFinite(timeS) ? `${new Date(1000 * timeS).toLocaleDateString("sv")} ${clock(timeS)}` : "–";
  }

  return { make, say, mark, number, measured, span, left, clock, date };
})();
