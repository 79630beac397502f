// The session that is watched: history first, then the stream; live, or at a frame of the past.
import { loadBody } from "./body.js";
import { History } from "./history.js";
import { tellProblem } from "./notices.js";
import { nearestRow } from "./plots.js";
import { sunOnScreen } from "./rotation.js";
import { Stream } from "./stream.js";

const USUAL_HEARTBEAT_S = 15, TRAIL_ROWS = 600;

export class Watch {
  constructor(api, views) {
    Object.assign(this, { api, views, session: null, cursor: null, rank: -1, names: new Map() });
    this.heartbeatS = USUAL_HEARTBEAT_S;
    setInterval(() => this.tick(), 500);
  }

  // How often the service's stream is heard from, at least; without that the page works too.
  async prepare() {
    try {
      this.heartbeatS = (await this.api.json("/v1/system")).settings?.stream_heartbeat_s ?? USUAL_HEARTBEAT_S;
    } catch (error) {
      console.info("system:", error.message);
    }
  }

  open(session) {
    this.close();
    Object.assign(this, { session, cursor: null, rank: -1, kinds: {}, frames: session.frames, reference: null });
    const { views } = this;
    views.frame.reset(session);
    views.model.reset();
    views.cloud.reset(session);
    views.readout.reset();
    views.plots.show([], null, true);
    views.timeline.stop();
    views.timeline.show({ index: 0, count: 0, live: true, rows: [] });
    views.heading.open(session);
    delete document.documentElement.dataset.shown;
    const mine = this.history = new History(this.api, session.session_id);
    this.stream = new Stream(session.session_id, {
      heartbeatS: this.heartbeatS,
      begin: () => this.begin(session, mine),
      ticket: (id) => this.ticket(id),
      estimate: (estimate) => this.take(estimate),
      problem: tellProblem,
      state: () => this.tick(),
    });
  }

  // Model and history, before the stream, or what of it was missed. Resolves to the event after which the stream goes on.
  async begin(session, mine) {
    if (!mine.rows.length) {
      this.modelId = null;
      await this.setModel(session.model_id ?? session.model_ids[0]);
    }
    if (this.history !== mine) return null;
    this.stream.hear("connecting");
    const now = await this.api.json(`/v1/sessions/${session.session_id}`); // its last_seq, before its history is read
    await mine.load(now.frames);
    if (this.history !== mine) return null;
    this.stream.hear("connecting");
    this.frames = Math.max(this.frames, now.frames);
    this.showGrown();
    for (const id of session.model_ids ?? []) this.learnName(id).catch(tellProblem);
    return now.last_seq;
  }

  // A browser cannot send its key with a WebSocket: a ticket stands for it, once. The first call finds out whether a
  // key is wanted, and whether the session is still there.
  async ticket(id) {
    await this.api.json(`/v1/sessions/${id}`);
    if (!this.api.key) return "";
    const { ticket } = await this.api.json("/v1/tickets", { method: "POST" });
    return `&ticket=${encodeURIComponent(ticket)}`;
  }

  // Estimates are counted as they come, and drawn once per animation frame: the newest of them.
  take(estimate) {
    if (!this.history.add(estimate)) return;
    this.frames = Math.max(this.frames, estimate.index + 1);
    if (this.drawing) return;
    this.drawing = true;
    requestAnimationFrame(() => {
      this.drawing = false;
      this.showGrown();
    });
  }

  showGrown() {
    if (!this.history?.rows.length) return;
    if (this.cursor === null) this.showNewest();
    else this.showPast();
  }

  showNewest() {
    const newest = this.history.documents.get(this.history.last);
    if (newest) this.show(newest);
  }

  // The past stays on the screen; only what grows is drawn.
  showPast() {
    this.views.timeline.show(this.position());
    this.views.plots.show(this.history.rows, this.history.row(this.cursor) ?? null, false);
  }

  position() {
    const { history, cursor, frames, shown } = this;
    return { index: cursor ?? history.last, count: Math.max(frames, history.last + 1), live: cursor === null,
      rows: history.rows, estimate: shown };
  }

  show(estimate) {
    const { views } = this;
    this.shown = estimate;
    const ranked = estimate.models?.[0]?.model_id;
    if (ranked && ranked !== this.modelId) this.setModel(ranked).catch(tellProblem);
    views.frame.show(estimate);
    views.cloud.show(estimate);
    views.cloud.setTrail(this.trail(estimate.index));
    this.showPose();
    views.readout.show(estimate, this.kinds, (id) => this.names.get(id) ?? id.slice(0, 8));
    views.timeline.show(this.position());
    const joints = Object.keys(estimate.spread.joints).map((name) => ({ name, kind: this.kinds[name] ?? "revolute" }));
    views.plots.build(joints, Boolean(estimate.probabilities), this.reference);
    views.plots.show(this.history.rows, this.history.row(estimate.index) ?? null, this.cursor === null);
    const row = this.history.row(estimate.index);
    views.sky.show(row?.place, this.trail(estimate.index).map((one) => one.place).filter(Boolean), row?.time, this.session.camera);
    document.getElementById("views").classList.toggle("with-sky", Boolean(row?.place));
    views.heading.show(estimate);
    document.documentElement.dataset.shown = estimate.index; // for tests, and for whoever scripts the page
  }

  trail(index) {
    const last = index - this.history.first;
    return this.history.rows.slice(Math.max(0, last - TRAIL_ROWS), last + 1);
  }

  showPose() {
    const mode = this.shown?.modes[this.rank];
    if (this.shown) {
      const sunlit = this.shown.light?.sunlit ?? null;
      this.views.model.show(mode?.pose ?? this.shown.best, { sun: sunOnScreen(this.shown, this.session), sunlit });
    }
    document.querySelector("#model .shown-mode").textContent =
      mode ? `mode ${this.rank + 1}, ${(100 * mode.weight).toFixed(0)} %` : "best pose";
  }

  // What it is compared with (comparison.js), or null.
  compare(reference) {
    this.reference = reference;
    this.views.frame.compare(reference);
    this.views.readout.reference = reference;
    if (this.shown && this.history) this.show(this.shown);
  }

  // Look at one mode (-1: the best pose) in the model's view, and mark its outline.
  inspect(rank) {
    this.rank = rank;
    this.views.readout.chosen = rank;
    this.views.frame.highlight(rank);
    this.showPose();
    if (this.shown) this.views.readout.showModes(this.shown.modes);
  }

  async goTo(index) {
    const { history: mine } = this;
    if (!mine?.rows.length) return;
    this.cursor = index;
    this.showPast();
    if (mine.rows.length && index < mine.first) mine.reachBack(index).then((more) => more && this.showPast(), tellProblem);
    try {
      const estimate = await mine.estimate(index);
      if (this.history === mine && this.cursor === index) this.show(estimate);
    } catch (error) {
      tellProblem(error);
    }
  }

  goToTime(time) {
    const { rows } = this.history;
    const nearest = rows[nearestRow(rows, time)];
    if (!nearest) return;
    this.views.timeline.stop();
    this.goTo(nearest.index);
  }

  goLive() {
    this.cursor = null;
    if (this.history?.rows.length) this.showNewest();
  }

  async setModel(id) {
    this.modelId = id;
    const body = await loadBody(this.api, id);
    if (this.modelId !== id) return;
    this.names.set(id, body.model.name);
    this.kinds = Object.fromEntries(body.model.joints.map((joint) => [joint.name, joint.kind]));
    for (const view of ["frame", "model", "cloud"]) this.views[view].setBody(body);
    this.views.heading.setModel(body.model);
  }

  async learnName(id) {
    this.names.set(id, (await this.api.json(`/v1/models/${id}`)).name);
  }

  // A fresh look at the session from the list.
  update(session) {
    this.session = session;
    this.views.heading.update(session);
  }

  tick() {
    this.views.heading.link(this.stream, this.history?.rows.length ? this.shown : null, this.cursor !== null);
  }

  close() {
    this.stream?.close();
    this.stream = this.history = this.session = this.shown = null;
  }
}
