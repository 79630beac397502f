// The keyboard: one table, from which the help is made too.
import { element } from "./readout.js";

const NAMES = { " ": "Space", ArrowLeft: "←", ArrowRight: "→", "Shift+ArrowLeft": "Shift ←", "Shift+ArrowRight": "Shift →" };

export class Shortcuts {
  // table: [[what it does, {key: action, …}]…]; a key is event.key, arrows with Shift have "Shift+" before them
  constructor(table, help) {
    this.actions = new Map(table.flatMap(([, keys]) => Object.entries(keys)));
    help.querySelector("dl").replaceChildren(...table.flatMap(([says, keys]) => {
      const term = element("dt");
      term.append(...Object.keys(keys).map((key) => element("kbd", NAMES[key] ?? (key.length === 1 ? key.toUpperCase() : key))));
      return [term, element("dd", says)];
    }));
    addEventListener("keydown", (event) => this.press(event));
  }

  press(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const { target, key } = event;
    const typing = target.matches?.("input:not([type=range]), select, textarea");
    const pressing = target.matches?.("button, a, summary") && (key === " " || key === "Enter");
    if (typing || pressing) return;
    const shifted = key.startsWith("Arrow") && event.shiftKey;
    const action = this.actions.get(shifted ? `Shift+${key}` : key.length === 1 ? key.toLowerCase() : key);
    if (!action) return;
    event.preventDefault();
    action();
  }
}
