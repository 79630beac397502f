// The list of sessions, newest first, asked for every few seconds.
import { badge, element } from "./readout.js";

const EVERY_MS = 3000, PAGE = 200, MOST_PAGES = 5, FILTER_FROM = 8;

export class SessionList {
  // `choose(session)` on a click, `changed(sessions)` after every answer
  constructor(nav, api, { choose, changed }) {
    Object.assign(this, { api, choose, changed });
    this.list = nav.querySelector("ul");
    this.filter = nav.querySelector("input");
    this.filter.addEventListener("input", () => this.draw());
    this.sessions = [];
    this.start = `/v1/sessions?limit=${PAGE}`; // of what is read: the API begins with the oldest
    this.chosen = null;
  }

  async run() {
    for (;;) {
      if (!document.hidden) await this.refresh();
      await new Promise((wake) => setTimeout(wake, EVERY_MS));
    }
  }

  async refresh() {
    try {
      this.sessions = await this.newest();
    } catch (error) {
      console.info("sessions:", error.message); // the stream's mark says that the service is away
      return;
    }
    this.draw();
    this.changed(this.sessions);
  }

  // Of the last pages. All are passed the first time, and not again.
  async newest() {
    let pages = [], url = this.start;
    while (url) {
      const { sessions, next } = await this.api.json(url);
      pages = [...pages, { url, sessions }].slice(-MOST_PAGES);
      url = next;
    }
    this.start = pages[0].url;
    return pages.flatMap((page) => page.sessions).reverse();
  }

  draw() {
    this.filter.hidden = this.sessions.length < FILTER_FROM;
    const wanted = this.filter.value.trim().toLowerCase();
    const seen = this.sessions.filter((session) => titleOf(session).toLowerCase().includes(wanted));
    const state = JSON.stringify([this.chosen, seen.map((s) => [s.session_id, s.status, s.state, s.frames, s.name])]);
    if (state === this.state) return; // nothing new: a button under the pointer stays
    this.state = state;
    const focused = document.activeElement?.dataset?.session;
    this.list.replaceChildren(...seen.map((session) => this.item(session)));
    this.reveal();
    if (focused) this.list.querySelector(`[data-session="${focused}"]`)?.focus();
  }

  // On a phone the list is a row: the chosen one is brought into it, once, and the page stays where it is.
  reveal() {
    const { list } = this, chosen = list.querySelector("[aria-current]");
    if (!chosen || this.revealed === this.chosen) return;
    this.revealed = this.chosen;
    list.scrollLeft += chosen.getBoundingClientRect().left - list.getBoundingClientRect().left;
  }

  item(session) {
    const button = element("button"), item = element("li");
    button.type = "button";
    button.dataset.session = session.session_id;
    if (session.session_id === this.chosen) button.setAttribute("aria-current", "true");
    button.append(element("span", titleOf(session)), statusOf(session), element("small", told(session)));
    button.addEventListener("click", () => this.choose(session));
    item.append(button);
    return item;
  }

  // The session `by` places further down the list.
  neighbour(by) {
    const at = this.sessions.findIndex((session) => session.session_id === this.chosen);
    return this.sessions[Math.min(Math.max(at + by, 0), this.sessions.length - 1)];
  }
}

export const titleOf = (session) => session.name || session.session_id.slice(0, 8);

function statusOf(session) {
  if (session.state !== "ready") {
    const mark = badge("waiting");
    mark.textContent = "Needs sky";
    return mark;
  }
  return session.status ? badge(session.status) : badge("ready");
}

function told(session) {
  const when = new Date(session.updated_at);
  const today = when.toDateString() === new Date().toDateString();
  const time = today ? when.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" }) : when.toLocaleDateString();
  return `${session.frames} ${session.frames === 1 ? "frame" : "frames"} · ${time}`;
}
