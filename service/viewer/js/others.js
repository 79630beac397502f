// Which other models the object may be: ticked, a session is begun that compares them.
import { element } from "./readout.js";

const MOST = 15; // beside the chosen one: a session compares at most sixteen

export class Others {
  constructor(box) {
    this.box = box;
    this.list = box.querySelector(".list");
    box.addEventListener("input", () => this.limit());
  }

  // The models but the chosen one; what was ticked stays so.
  show(models, chosen) {
    const ticked = new Set(this.ids);
    const others = chosen ? models.filter((model) => model !== chosen) : [];
    this.box.hidden = !others.length;
    this.list.replaceChildren(...others.map((model) => {
      const label = element("label"), input = element("input");
      Object.assign(input, { type: "checkbox", value: model.model_id, checked: ticked.has(model.model_id) });
      label.append(input, ` ${model.name}`);
      return label;
    }));
    this.limit();
  }

  get ids() {
    return [...this.list.querySelectorAll("input:checked")].map((input) => input.value);
  }

  limit() {
    const full = this.ids.length >= MOST;
    for (const input of this.list.querySelectorAll("input")) input.disabled = full && !input.checked;
  }
}
