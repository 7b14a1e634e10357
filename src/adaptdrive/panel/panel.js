"use strict";
// The page: log in, then the site or one drive, as the address says.

(() => {
  const REDRAW_MS = 250;
  const root = /** @type {HTMLElement} */ (document.getElementById("panel"));
  const notice = Dom.make("div.notice", { role: "status", hidden: true });
  const body = Dom.make("div");
  /** @type {{draw: () => void, outdated: () => boolean, end: () => void} | null} */ let page = null;

  function show() {
    page?.end();
    body.replaceChildren();
    body.className = "";
    const [name, view, ...rest] = location.hash.slice(1).split("/"); // no name of a drive has a letter that an address encodes
    document.title = name ? `${name} · adaptdrive` : "adaptdrive";
    if (name && view === "sessions") page = SessionsPage.open(body, Drives.named(name), rest.join("/"));
    else page = name ? DrivePage.open(body, Drives.named(name)) : SitePage.open(body);
    page.draw();
  }

  function draw() {
    notice.hidden = Link.online;
    Dom.say(notice, `The broker cannot be reached${Link.problem ? `: ${Link.problem}` : ""}. What is shown is old.`);
    if (document.hidden) return; // a page in the background keeps its messages and draws nothing
    if (page?.outdated()) show();
    else page?.draw();
  }

  Login.open(root, () => {
    root.replaceChildren(notice, body);
    show();
    window.addEventListener("hashchange", show);
    window.setInterval(draw, REDRAW_MS);
    document.addEventListener("visibilitychange", draw);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", show); // plots keep their colours
  });
})();
