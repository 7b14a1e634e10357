"use strict";
// The way in: a user of the broker. The browser keeps the account for this tab until the tab is closed.

const Login = (() => {
  const KEPT = "account";
  const HIDDEN_MS = 700; // no form while a broker without users, or the kept account, may still answer

  /** @typedef {{url: string, username: string, password: string}} Account */

  /** @param {HTMLElement} parent @param {() => void} done */
  function open(parent, done) {
    const broker = input("text", "broker", usualBroker());
    const user = input("text", "user", "", "username");
    const password = input("password", "password", "", "current-password");
    const problem = Dom.make("p.answer", { role: "alert" });
    const form = Dom.make("form.login", { hidden: true, onsubmit: async (event) => {
      event.preventDefault();
      Dom.mark(problem, "data-kind", "sent");
      Dom.say(problem, "connecting…");
      try {
        const account = { url: broker.field.value, username: user.field.value, password: password.field.value };
        await Link.open(account);
        keep({ ...account, page: usualBroker() });
        done();
      } catch (error) {
        Dom.mark(problem, "data-kind", "refused");
        Dom.say(problem, `the broker refuses: ${error instanceof Error ? error.message : error}`);
      }
    } }, Dom.make("h1", {}, "adaptdrive"), broker.row, user.row, password.row,
    Dom.make("button", { type: "submit" }, "Log in"), problem);
    const show = () => {
      if (!form.hidden || !form.isConnected) return;
      form.hidden = false;
      user.field.focus();
    };
    parent.append(form);
    Link.watch(() => { if (!Link.online && Link.problem && form.isConnected) Dom.say(problem, Link.problem); });
    const first = firstAccount();
    if (!first) return show();
    window.setTimeout(show, HIDDEN_MS);
    Link.open(first).then(done, () => { Dom.say(problem, ""); show(); });
  }

  /** The account of this tab, else none, which a broker without users takes; null where another user is asked for.
   * @returns {Account|null} */
  function firstAccount() {
    const anonymous = { url: usualBroker(), username: "", password: "" };
    const kept = sessionStorage.getItem(KEPT);
    if (kept === "") return null;
    const account = kept ? JSON.parse(kept) : anonymous;
    return kept && account.page !== usualBroker() ? anonymous : account;
  }

  /** @param {Account & {page: string}} account with the broker that the page proposed */
  function keep(account) {
    sessionStorage.setItem(KEPT, JSON.stringify(account));
  }

  /** Ask for another user. */
  function change() {
    sessionStorage.setItem(KEPT, "");
    location.reload();
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

  return { open, change };
})();
