// What the watched session is compared with: another session, frame by frame, or a truth that was dropped.
import { History } from "./history.js";
import { tellProblem } from "./notices.js";
import { titleOf } from "./sessions.js";
import { readTruth } from "./truth.js";

const TRUTH = "truth", FILE = "file";

export class Comparison {
  // `changed(reference or null)`: {id, name, rowOf(index), poseOf(index)}; `named(id)` goes into the address
  constructor(api, select, input, { changed, named }) {
    Object.assign(this, { api, select, input, changed, named, session: null, sessions: [], truths: new Map() });
    select.addEventListener("change", () => this.chosen(select.value));
    input.addEventListener("change", () => input.files[0] && this.take(input.files[0]));
  }

  // For the session that is opened now; `other`: the one that the address names beside it.
  open(session, other) {
    this.session = session;
    this.other = other;
    this.offer(this.sessions);
    this.apply(other ?? (this.truths.has(session.session_id) ? TRUTH : ""));
  }

  offer(sessions) {
    this.sessions = sessions;
    const id = this.session?.session_id, options = [new Option("nothing", "")];
    if (this.truths.has(id)) options.push(new Option("the truth", TRUTH));
    options.push(new Option("a truth.csv…", FILE));
    const others = sessions.filter((one) => one.session_id !== id);
    options.push(...others.map((one) => new Option(titleOf(one), one.session_id)));
    const key = options.map((option) => option.value + option.text).join();
    if (key === this.key) return; // an open list stays
    this.key = key;
    this.select.replaceChildren(...options);
    this.select.value = this.current ?? "";
  }

  chosen(value) {
    if (value === FILE) {
      this.select.value = this.current ?? "";
      this.input.click();
      return;
    }
    this.named(value === TRUTH ? "" : value);
    this.apply(value);
  }

  async apply(value) {
    this.current = value;
    this.select.value = value;
    const { session } = this;
    let reference = null;
    try {
      if (value === TRUTH) reference = this.truths.get(session.session_id);
      else if (value) reference = await this.load(value);
    } catch (error) {
      tellProblem(error);
    }
    if (this.current === value && this.session === session) this.changed(reference);
  }

  async load(id) {
    const other = await this.api.json(`/v1/sessions/${encodeURIComponent(id)}`);
    const history = new History(this.api, id);
    await history.load(other.frames);
    const alike = other.model_id !== null && other.model_id === this.session.model_id;
    return { id, name: titleOf(other), rowOf: (index) => history.row(index),
      poseOf: (index) => (alike ? history.documents.get(index)?.best : undefined) };
  }

  // A truth for a session, the watched one by default; `first`: its line that is the session's frame 0.
  async take(file, id = this.session?.session_id, first = 0) {
    try {
      this.truths.set(id, readTruth(await file.text(), first));
    } catch (error) {
      tellProblem(error);
      return;
    }
    this.input.value = "";
    if (id !== this.session?.session_id) return;
    this.offer(this.sessions);
    this.chosen(TRUTH);
  }
}
