// Newest wins: one value is handled at a time, what comes meanwhile replaces what waits.
export class Newest {
  // `handle(value)`: a promise; `restMs` pass after each
  constructor(handle, restMs = 0) {
    Object.assign(this, { handle, restMs, waiting: null, busy: false });
  }

  async take(value) {
    this.waiting = value;
    if (this.busy) return;
    this.busy = true;
    try {
      while (this.waiting) {
        const next = this.waiting;
        this.waiting = null;
        await this.handle(next);
        if (this.restMs) await new Promise((done) => setTimeout(done, this.restMs));
      }
    } finally {
      this.busy = false; // after a failure too: the next value is handled
    }
  }

  forget() {
    this.waiting = null;
  }
}
