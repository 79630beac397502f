// Numbers of the estimate that is shown, and its modes as a list to choose from.
import { modeColour, STATUS } from "./colours.js";

const degrees = (value, spread) => `${value.toFixed(2)} ± ${spread.toFixed(2)}°`;

export class Readout {
  constructor(element, choose) {
    this.numbers = element.querySelector("dl");
    this.modes = element.querySelector(".modes");
    this.models = element.querySelector(".models");
    this.choose = choose;
    this.chosen = -1;
  }

  reset() {
    this.chosen = -1;
    this.numbers.replaceChildren();
    this.modes.replaceChildren();
    this.models.replaceChildren();
  }

  // `kinds`: joint name -> kind; `nameOf`: model id -> name
  show(estimate, kinds, nameOf) {
    const spread = estimate.modes[0]?.spread ?? estimate.spread;
    fill(this.numbers, rows(estimate, spread, kinds).map(([name, value]) => {
      const pair = element("div");
      pair.append(element("dt", name), element("dd", value));
      pair.title = value;
      return pair;
    }));
    this.showModes(estimate.modes);
    fill(this.models, (estimate.models ?? []).map((model) => {
      const item = element("li", `${nameOf(model.model_id)} `);
      item.append(bar(model.probability, modeColour(0)), percent(model.probability));
      return item;
    }));
    this.models.parentElement.hidden = !estimate.models;
  }

  // Items are kept from frame to frame, so that a click between two of them is not lost.
  showModes(modes) {
    while (this.modes.children.length > modes.length) this.modes.lastChild.remove();
    while (this.modes.children.length < modes.length) this.modes.append(this.modeItem(this.modes.children.length));
    modes.forEach((mode, rank) => {
      const button = this.modes.children[rank].firstChild;
      const { yaw_deg: yaw, pitch_deg: pitch, roll_deg: roll } = mode.pose;
      button.setAttribute("aria-pressed", String(rank === this.chosen));
      button.querySelector("progress").value = mode.weight;
      button.querySelector(".share").textContent = percent(mode.weight);
      button.querySelector("small").textContent =
        `${yaw.toFixed(1)}°, ${pitch.toFixed(1)}°, ${roll.toFixed(1)}°  ± ${mode.spread.orientation_deg.toFixed(1)}°`;
    });
  }

  modeItem(rank) {
    const item = element("li"), button = element("button");
    button.type = "button";
    const share = element("span");
    share.className = "share";
    button.append(bar(0, modeColour(rank)), share, element("small"));
    button.addEventListener("click", () => this.choose(this.chosen === rank ? -1 : rank));
    item.append(button);
    return item;
  }
}

function rows(estimate, spread, kinds) {
  const { best } = estimate;
  const unit = (name) => (kinds[name] === "prismatic" ? "" : "°");
  return [
    ["Yaw", degrees(best.yaw_deg, spread.yaw_deg)],
    ["Pitch", degrees(best.pitch_deg, spread.pitch_deg)],
    ["Roll", degrees(best.roll_deg, spread.roll_deg)],
    ["Position", `${best.x_px.toFixed(1)}, ${best.y_px.toFixed(1)} ± ${Math.max(spread.x_px, spread.y_px).toFixed(1)} px`],
    ["Scale", `${best.scale_px.toPrecision(4)} ± ${spread.scale_px.toPrecision(2)} px/unit`],
    ...Object.entries(best.joints).map(([name, value]) => [name, name in spread.joints
      ? `${value.toFixed(2)} ± ${spread.joints[name].toFixed(2)}${unit(name)}` : `${value.toFixed(2)}${unit(name)}, fixed`]),
    ...rates(estimate.rates),
    ["Particles", `${estimate.particles}, effective ${estimate.ess.toFixed(0)}`],
    ["Time", `${(estimate.timing_ms.total ?? 0).toFixed(1)} ms`],
    ["Scorer", estimate.scorer],
  ];
}

function rates(found) {
  if (!found) return [];
  const { x, y, z } = found.angular_velocity_deg_s, s = found.spread_deg_s;
  return [["Turning", `${Math.hypot(x, y, z).toFixed(2)} ± ${Math.hypot(s.x, s.y, s.z).toFixed(2)} °/s`]];
}

export function badge(status) {
  const mark = element("span", STATUS[status]?.says ?? status);
  mark.className = `badge ${status}`;
  return mark;
}

function bar(value, colour) {
  const progress = element("progress");
  progress.value = value;
  progress.style.setProperty("--colour", colour);
  progress.setAttribute("aria-hidden", "true"); // the share beside it says the same
  return progress;
}

export function element(tag, text) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  return made;
}

const fill = (parent, children) => parent.replaceChildren(...children);
const percent = (share) => `${(100 * share).toFixed(share < 0.095 ? 1 : 0)} %`;
