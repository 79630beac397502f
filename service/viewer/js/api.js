// Calls to the service. A refusal becomes a Problem, which says what the problem document says.
const KEY = "skypose.key"; // docs/security.md

export class Problem extends Error {
  constructor(status, body) {
    super(body.detail || body.title || `the service answered ${status}`);
    Object.assign(this, { status, title: body.title || "Refused", type: body.type, field: body.field, body });
  }
}

export class Offline extends Error {
  constructor() {
    super("the service does not answer");
    this.title = "Not connected";
  }
}

export class Api {
  // `askKey(problem)` resolves to a key, or null where the user gave none.
  constructor(askKey) {
    this.askKey = askKey;
    this.asking = null;
    this.declined = false; // the user gave no key: not asked again for every call that is refused
  }

  get key() {
    return sessionStorage.getItem(KEY);
  }

  async call(path, { method = "GET", body, headers = {}, signal } = {}) {
    for (;;) {
      const sent = this.key;
      const authorization = sent ? { Authorization: `Bearer ${sent}` } : {};
      const answer = await this.fetch(path, { method, body, signal, headers: { ...headers, ...authorization } });
      if (answer.ok) return answer;
      const problem = new Problem(answer.status, await readProblem(answer));
      problem.retryAfter = Number(answer.headers.get("Retry-After")) || null;
      if (answer.status !== 401) throw problem;
      if (sent === this.key && (this.declined || !(await this.newKey(problem)))) throw problem;
    }
  }

  async fetch(path, options) {
    try {
      const answer = await fetch(path, options);
      this.reached = true;
      return answer;
    } catch (error) {
      if (error.name === "AbortError") throw error;
      this.reached = false;
      throw new Offline();
    }
  }

  // However many calls are refused at once, the user is asked once.
  async newKey(problem) {
    this.asking ??= this.askKey(problem).finally(() => { this.asking = null; });
    const key = await this.asking;
    this.declined = !key;
    if (key) sessionStorage.setItem(KEY, key);
    return Boolean(key);
  }

  forgetKey() {
    sessionStorage.removeItem(KEY);
  }

  async json(path, options) {
    return (await this.call(path, options)).json();
  }

  async blob(path) {
    return (await this.call(path)).blob();
  }

  async bytes(path) {
    return (await this.call(path)).arrayBuffer();
  }

  send(path, body) {
    return this.json(path, { method: "POST", body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });
  }
}

async function readProblem(answer) {
  if (!(answer.headers.get("Content-Type") || "").includes("json")) return { title: answer.statusText };
  return answer.json();
}
