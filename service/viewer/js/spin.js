// How the object turned over the pass: worked out when asked for, from all frames so far.
import { element, pair } from "./readout.js";

export class SpinView {
  constructor(element, api) {
    this.element = element;
    this.api = api;
    this.list = element.querySelector("dl");
    this.button = element.querySelector("button");
    this.button.addEventListener("click", () => this.ask());
  }

  open(session) {
    this.session = session;
    this.list.replaceChildren();
    this.button.disabled = false;
  }

  async ask() {
    const { session } = this;
    this.button.disabled = true;
    try {
      const found = await this.api.json(`/v1/sessions/${session.session_id}/motion`);
      if (session === this.session) this.list.replaceChildren(...spinRows(found).map(pair));
    } catch (error) {
      if (session === this.session) this.list.replaceChildren(pair(["Not known", error.message]));
    } finally {
      if (session === this.session) this.button.disabled = false;
    }
  }
}

const LAWS = { constant_rate: "turns at a constant rate", tumbling: "tumbles freely" };
const share = (p) => `${(100 * p).toFixed(p > 0.99 && p < 1 ? 1 : 0)} %`;
const axis = ({ x, y, z }) => [x, y, z].map((value) => value.toFixed(3)).join(", ");

function modeText({ mode, probabilities, offset_deg, sigma_deg, body_axis }) {
  const off = offset_deg === null ? "" : `, ${body_axis}, ${offset_deg.toFixed(2)} ± ${sigma_deg.toFixed(2)}° off`;
  return `${mode.replace("_", " ")}, ${share(probabilities[mode])}${off}`;
}

function jointText({ law, probabilities, value_deg, offset_deg, sigma_deg }) {
  const at = value_deg ?? offset_deg;
  const where = at === null ? "" : `, ${at.toFixed(2)} ± ${sigma_deg.toFixed(2)}°${law === "still" ? "" : " from the Sun"}`;
  return `${law.replace("_", " ")}, ${share(probabilities[law])}${where}`;
}

// [[name, value]…] of an answer of `…/motion`.
export function spinRows(found) {
  const against = found.relative_to === "GCRF" ? "" : " against the camera";
  const rows = [
    ["It", `${LAWS[found.model]}, ${share(found.probabilities[found.model])}`],
    ["Rate", `${found.rate_deg_s.toFixed(4)} ± ${found.rate_sigma_deg_s.toFixed(4)} °/s${against}`],
    ["Period", found.period_s === null ? "no turning seen" : `${found.period_s.toPrecision(5)} ± ${found.period_sigma_s.toPrecision(2)} s`],
    ["Axis in the body", `${axis(found.axis_body)} ± ${found.axis_body_sigma_deg.toFixed(2)}°`],
  ];
  if (found.axis_gcrf) rows.push(["Axis in GCRF", `${axis(found.axis_gcrf)} ± ${found.axis_gcrf_sigma_deg.toFixed(2)}°`]);
  if (found.attitude_mode) rows.push(["Attitude mode", modeText(found.attitude_mode)]);
  for (const joint of found.joints) rows.push([`Joint ${joint.name}`, jointText(joint)]);
  if (found.inertia) {
    const told = found.inertia.ratios.map((ratio, k) => `${ratio.toFixed(3)} ± ${found.inertia.ratios_sigma[k].toFixed(3)}`);
    rows.push(["Moments of inertia over the greatest", told.join(", ")]);
  }
  rows.push(["Frames", `${found.frames.used} of ${found.frames.stored}, ${share(found.frames.explained)} of these explained`]);
  return [...rows, ...found.warnings.map((warning) => ["Note", warning])];
}
