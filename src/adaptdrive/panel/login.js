"use strict";
// The way in: a user of the broker. The password stays in this page and is never stored.

const Login = (() => {
  /** @param {HTMLElement} parent @param {() => void} done */
  function open(parent, done) {
    const broker = input("text", "broker", usualBroker());
    const user = input("text", "user", "", "username");
    const password = input("password", "password", "", "current-password");
    const problem = Dom.make("p.answer", { role: "alert" });
    const form = Dom.make("form.login", { onsubmit: async (event) => {
      event.preventDefault();
      Dom.mark(problem, "data-kind", "sent");
      Dom.say(problem, "connecting…");
      try {
        await Link.open({ url: broker.field.value, username: user.field.value, password: password.field.value });
        done();
      } catch (error) {
        Dom.mark(problem, "data-kind", "refused");
        Dom.say(problem, `the broker refuses: ${error instanceof Error ? error.message : error}`);
      }
    } }, Dom.make("h1", {}, "adaptdrive"), broker.row, user.row, password.row,
    Dom.make("p.hint", {}, "On a broker without users, such as that of the demonstration, leave user and password empty."),
    Dom.make("button", { type: "submit" }, "Log in"), problem);
    parent.append(form);
    Link.watch(() => { if (!Link.online && Link.problem && form.isConnected) Dom.say(problem, Link.problem); });
    (user.field.value ? password : user).field.focus();
  }

  /** @param {string} type @param {string} label @param {string} value @param {string} [complete] */
  function input(type, label, value, complete = "off") {
    const field = /** @type {HTMLInputElement} */ (Dom.make("input", { type, value, autocomplete: complete, spellcheck: "false" }));
    return { field, row: Dom.make("label", {}, label, field) };
  }

  /** The broker that served this page, or the one that the address names: ?broker=ws://… */
  function usualBroker() {
    const named = new URLSearchParams(location.search).get("broker");
    if (named && /^wss?:\/\//.test(named)) return named;
    return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host || "127.0.0.1:8083"}/mqtt`;
  }

  return { open };
})();
