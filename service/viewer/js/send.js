// Sends a pass: session, empty sky, frames, in order. What the network loses is sent again; the service counts each once.
import { mediaType, isVideo } from "./intake.js";

const BORDER_FRAMES = 10; // enough to learn a border from
const RETRY_MS = 700;

export class Sending {
  // plan: {request or session, sky, border, frames}; `changed(this)` after every step;
  // `onProblem(error, file)` resolves to "again", "skip" or "stop"
  constructor(api, plan, { changed, onProblem }) {
    Object.assign(this, { api, plan, changed, onProblem });
    this.step = "session";
    this.done = 0;
    this.total = plan.frames.length;
    this.abort = new AbortController();
    this.started = performance.now();
  }

  // Resolves to the session's id once it is there; the rest goes on, and `finished` resolves at its end.
  async begin() {
    const { api, plan } = this;
    this.session = plan.session ? await api.json(`/v1/sessions/${plan.session.session_id}`)
      : await api.send("/v1/sessions", plan.request);
    this.index = this.session.frames;
    this.here = `/v1/sessions/${this.session.session_id}`;
    this.finished = this.sendAll();
    return this.session.session_id;
  }

  async sendAll() {
    try {
      await this.sendSky();
      this.step = "frames";
      this.started = performance.now();
      for (const file of this.plan.frames) {
        await (isVideo(file) ? this.sendVideo(file) : this.sendFrame(file));
      }
      this.step = "done";
    } catch (error) {
      this.step = "stopped";
      if (error.name !== "AbortError") throw error;
    } finally {
      this.changed(this);
    }
  }

  async sendSky() {
    const { sky, border, frames } = this.plan;
    const files = border ? frames.slice(0, BORDER_FRAMES) : sky;
    this.step = "sky";
    for (const [i, file] of files.entries()) {
      Object.assign(this, { skyDone: i, skyTotal: files.length });
      this.changed(this);
      const query = border ? `?border=${border}` : "";
      await this.persist(file, () => this.put("POST", `${this.here}/background${query}`, file, `sky-${i}`));
    }
  }

  async sendFrame(file) {
    const answer = await this.persist(file, () => this.put("PUT", `${this.here}/frames/${this.index}`, file));
    if (answer) this.index = (await answer.json()).index + 1;
    this.step1();
  }

  async sendVideo(file) {
    const answer = await this.persist(file, () => this.put("POST", `${this.here}/frames`, file, `video-${file.name}`));
    if (!answer) return;
    for await (const line of linesOf(answer.body)) {
      const document = JSON.parse(line);
      if (document.session_id === undefined) await this.onProblem(Object.assign(new Error(document.detail), document), file);
      else this.step1();
      this.total = Math.max(this.total, this.done);
    }
  }

  step1() {
    this.done += 1;
    this.changed(this);
  }

  put(method, path, file, key) {
    const headers = { "Content-Type": mediaType(file), ...(key ? { "Idempotency-Key": key } : {}) };
    return this.api.call(path, { method, body: file, headers, signal: this.abort.signal });
  }

  // Until it is answered: a service that is away or busy is asked again, a refusal is the user's to decide.
  async persist(file, send) {
    for (;;) {
      this.abort.signal.throwIfAborted();
      try {
        const answer = await send();
        this.waiting = false;
        return answer;
      } catch (error) {
        if (error.name === "AbortError") throw error;
        const passing = !error.status || error.status === 429 || error.status === 503;
        if (passing) {
          this.waiting = true;
          this.changed(this);
          await new Promise((wake) => setTimeout(wake, (error.retryAfter ?? 0) * 1000 || RETRY_MS));
          continue;
        }
        const choice = await this.onProblem(error, file);
        if (choice === "skip") return null;
        if (choice === "stop") throw new DOMException("stopped", "AbortError");
      }
    }
  }

  stop() {
    this.abort.abort(new DOMException("stopped", "AbortError"));
  }

  get rate() {
    return this.done / ((performance.now() - this.started) / 1000 || 1);
  }
}

async function* linesOf(body) {
  let rest = "";
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    const lines = (rest + value).split("\n");
    rest = lines.pop();
    yield* lines.filter(Boolean);
  }
  if (rest) yield rest;
}
