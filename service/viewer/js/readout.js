// Numbers of the estimate that is shown, and its modes as a list to choose from.
import { modeColour, STATUS } from "./colours.js";

import { angleBetween } from "./rotation.js";
import { skyRows } from "./sky_readout.js";

const degrees = (value, spread) => `${value.toFixed(2)} ± ${spread.toFixed(2)}°`;

export class Readout {
  constructor(element, choose) {
    this.numbers = element.querySelector("dl");
    this.sky = element.querySelector(".sky dl");
    this.modes = element.querySelector(".modes");
    this.models = element.querySelector(".models");
    this.choose = choose;
    this.chosen = -1;
  }

  reset() {
    this.chosen = -1;
    this.reference = null;
    this.numbers.replaceChildren();
    this.sky.replaceChildren();
    this.modes.replaceChildren();
    this.models.replaceChildren();
  }

  // `kinds`: joint name -> kind; `nameOf`: model id -> name
  show(estimate, kinds, nameOf) {
    const spread = estimate.modes[0]?.spread ?? estimate.spread;
    this.kinds = kinds;
    fill(this.numbers, [...rows(estimate, spread, kinds), ...this.compared(estimate)].map(pair));
    const sky = skyRows(estimate);
    fill(this.sky, sky.map(pair));
    this.sky.parentElement.hidden = !sky.length;
    this.showModes(estimate.modes);
    fill(this.models, (estimate.models ?? []).map((model) => {
      const item = element("li", `${nameOf(model.model_id)} `);
      item.append(bar(model.probability, modeColour(0)), percent(model.probability));
      return item;
    }));
    this.models.parentElement.hidden = !estimate.models;
  }

  // How far it is from what it is compared with.
  compared({ index, best }) {
    const other = this.reference?.rowOf(index);
    return other ? [[`Angle to ${this.reference.name}`, `${angleBetween(best.orientation, other.orientation).toFixed(2)}°`]] : [];
  }

  // Items are kept from frame to frame, so that a click between two of them is not lost.
  showModes(modes) {
    while (this.modes.children.length > modes.length) this.modes.lastChild.remove();
    while (this.modes.children.length < modes.length) this.modes.append(this.modeItem(this.modes.children.length));
    const texts = modeTexts(modes, this.kinds);
    modes.forEach((mode, rank) => {
      const button = this.modes.children[rank].firstChild;
      button.setAttribute("aria-pressed", String(rank === this.chosen));
      button.querySelector("progress").value = mode.weight;
      button.querySelector(".share").textContent = percent(mode.weight);
      button.querySelector("small").textContent = texts[rank];
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

export function pair([name, value]) {
  const item = element("div");
  item.append(element("dt", name), element("dd", value));
  item.title = value;
  return item;
}

const unitOf = (kinds, name) => (kinds[name] === "prismatic" ? "" : "°");

// One line per mode: its angles, and the joints in which the modes differ.
export function modeTexts(modes, kinds) {
  const jointOf = (mode, name) => `${name} ${mode.pose.joints[name].toFixed(1)}${unitOf(kinds, name)}`;
  const differ = Object.keys(modes[0]?.pose.joints ?? {}).filter(
    (name) => new Set(modes.map((mode) => jointOf(mode, name))).size > 1);
  return modes.map((mode) => {
    const angles = [mode.pose.yaw_deg, mode.pose.pitch_deg, mode.pose.roll_deg].map((angle) => `${angle.toFixed(1)}°`);
    const told = `${angles.join(", ")} ± ${mode.spread.orientation_deg.toFixed(1)}°`;
    return [told, ...differ.map((name) => jointOf(mode, name))].join(" · ");
  });
}

function rows(estimate, spread, kinds) {
  const { best } = estimate;
  const unit = (name) => unitOf(kinds, name);
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
