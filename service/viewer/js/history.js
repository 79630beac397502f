// What the page knows of a pass: one small row per frame for the plots, and the newest documents in full.
const PAGE = 500, AT_FIRST = 2000, MOST_ROWS = 20_000, MOST_DOCUMENTS = 600, MOST_MODES = 8;

export class History {
  constructor(api, sessionId) {
    Object.assign(this, { api, sessionId });
    this.rows = []; // by index, without gaps
    this.documents = new Map();
  }

  get first() { return this.rows[0]?.index ?? 0; }
  get last() { return this.rows.at(-1)?.index ?? -1; }
  row(index) { return this.rows[index - this.first]; }

  // True where it was new. Events come again after a resume; a gap means that older ones were dropped.
  add(estimate) {
    if (estimate.index <= this.last) return false;
    if (estimate.index > this.last + 1) this.rows = [];
    this.rows.push(rowOf(estimate));
    if (this.rows.length > MOST_ROWS) this.rows.splice(0, this.rows.length - MOST_ROWS);
    this.keep(estimate);
    return true;
  }

  keep(estimate) {
    this.documents.set(estimate.index, estimate);
    if (this.documents.size > MOST_DOCUMENTS) this.documents.delete(this.documents.keys().next().value);
  }

  // The newest frames of a session that has `frames` so far, of which some may be known.
  async load(frames) {
    let after = Math.max(this.last, frames - 1 - AT_FIRST);
    while (after < frames - 1) {
      const found = await this.page(after, PAGE);
      if (!found.length) return;
      found.forEach((estimate) => this.add(estimate));
      after = found.at(-1).index;
    }
  }

  // Go back until frame `index` is among the rows. Resolves to whether anything was added.
  async reachBack(index) {
    if (this.reaching || !this.rows.length || index >= this.first) return false;
    this.reaching = true;
    try {
      while (index < this.first && this.rows.length + PAGE <= MOST_ROWS) {
        const before = this.first;
        const found = await this.page(Math.max(-1, before - PAGE - 1), Math.min(PAGE, before));
        this.rows = found.map(rowOf).concat(this.rows);
      }
    } finally {
      this.reaching = false;
    }
    return true;
  }

  async page(after, limit) {
    const here = `/v1/sessions/${this.sessionId}/estimates?after=${after}&limit=${limit}`;
    return (await this.api.json(here)).estimates;
  }

  async estimate(index) {
    const known = this.documents.get(index);
    if (known) return known;
    const found = await this.api.json(`/v1/sessions/${this.sessionId}/estimates/${index}`);
    this.keep(found);
    return found;
  }
}

// Values of a pose in one flat object, by the names of the plots.
export function values(pose) {
  const flat = { yaw: pose.yaw_deg, pitch: pose.pitch_deg, roll: pose.roll_deg, x: pose.x_px, y: pose.y_px,
    scale: pose.scale_px };
  for (const [name, value] of Object.entries(pose.joints)) flat[`joint:${name}`] = value;
  return flat;
}

function deviations(spread) {
  const flat = { yaw: spread.yaw_deg, pitch: spread.pitch_deg, roll: spread.roll_deg, x: spread.x_px, y: spread.y_px,
    scale: spread.scale_px };
  for (const [name, value] of Object.entries(spread.joints)) flat[`joint:${name}`] = value;
  return flat;
}

// Where it stands in the sky, and whether the Sun reaches it there.
function placeOf({ orbit, light }) {
  return { azimuth: orbit.azimuth_deg, elevation: orbit.elevation_deg, range: orbit.range_km, lit: light?.sunlit ?? null };
}

export function rowOf(estimate) {
  return {
    index: estimate.index,
    time: Date.parse(estimate.time) / 1000,
    status: estimate.status,
    orientation: estimate.best.orientation,
    best: values(estimate.best),
    modes: estimate.modes.slice(0, MOST_MODES).map((mode) => (
      { weight: mode.weight, at: values(mode.pose), spread: deviations(mode.spread) })),
    accuracy: estimate.modes[0]?.spread.orientation_deg ?? estimate.spread.orientation_deg,
    ess: estimate.ess,
    particles: estimate.particles,
    probabilities: estimate.probabilities ?? undefined,
    fit: estimate.fit ?? undefined,
    place: estimate.orbit ? placeOf(estimate) : undefined,
    latency: estimate.timing_ms.total ?? 0,
  };
}
