// The live stream of a session: what comes before it, then a WebSocket that resumes after the last event it gave. It
// knows when what is shown is stale.
import { Offline } from "./api.js";

const FIRST_WAIT_MS = 300, LONGEST_WAIT_MS = 5000;

export class Stream {
  // handlers: estimate(document), problem(error), state(); `begin()` gives the event to go on after, and is asked again
  // until it does, and where events are missing; `ticket()` gives the query that opens the socket
  constructor(sessionId, { begin, ticket, heartbeatS, ...handlers }) {
    Object.assign(this, { sessionId, begin, ticket, handlers, seq: null, told: new Set() });
    this.silenceMs = 2.5 * heartbeatS * 1000;
    this.wait = FIRST_WAIT_MS;
    this.state = "connecting";
    this.heard = performance.now();
    this.wake = () => { if (this.state === "lost") this.retry(0); };
    addEventListener("online", this.wake);
    this.connect();
  }

  get silentMs() {
    return performance.now() - this.heard;
  }

  // Nothing that is shown can be trusted to be the newest.
  get stale() {
    return this.state !== "ended" && (this.state === "lost" || this.silentMs > this.silenceMs);
  }

  async connect() {
    this.timer = null;
    let query;
    try {
      this.seq ??= await this.begin();
      if (this.closed) return;
      query = await this.ticket(this.sessionId);
    } catch (error) {
      if (error.status === 404 && this.seq !== null) return this.finish();
      return this.lose(error);
    }
    if (this.closed) return;
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const path = `/v1/sessions/${this.sessionId}/stream?after=${this.seq}${query}`;
    const socket = new WebSocket(`${scheme}://${location.host}${path}`);
    this.socket = socket;
    socket.onopen = () => { this.hear("live"); this.wait = FIRST_WAIT_MS; };
    socket.onmessage = (event) => this.take(JSON.parse(event.data));
    socket.onclose = () => { if (socket === this.socket) this.lose(); };
  }

  take(message) {
    this.hear("live");
    if (message.type === "resync-required") return this.restart();
    if (message.type === "end" && message.reason !== "shutdown") this.finish();
    else if (message.type === "estimate") this.handlers.estimate(message.estimate);
    this.seq = message.seq;
  }

  hear(state) {
    this.heard = performance.now();
    this.become(state);
  }

  // Too slow: events are missing, which `begin` reads.
  restart() {
    const { socket } = this;
    this.seq = this.socket = null;
    socket.close();
    this.connect();
  }

  // The mark of staleness says that the service is away; anything else that stands in the way is told, once.
  lose(error = null) {
    if (this.closed || this.state === "ended") return;
    if (error && !isAway(error) && !this.told.has(error.message)) {
      this.told.add(error.message);
      this.handlers.problem(error);
    }
    this.become("lost");
    this.retry(this.wait);
    this.wait = Math.min(this.wait * 2, LONGEST_WAIT_MS);
  }

  retry(waitMs) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.connect(), waitMs);
  }

  finish() {
    this.become("ended");
    this.close();
  }

  become(state) {
    if (this.state === state) return;
    this.state = state;
    this.handlers.state();
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
    removeEventListener("online", this.wake);
    const { socket } = this;
    if (socket?.readyState === WebSocket.CONNECTING) socket.onopen = () => socket.close(); // the browser would complain
    else socket?.close();
  }
}

function isAway(error) {
  return error instanceof Offline || error.status >= 500;
}
