// The dialog of a new track: files in, a model, empty sky, moving parts; then everything is sent.
import { ACCEPT_MESH, describe, dropped, isVideo, modelFiles, sort } from "./intake.js";
import { problemText } from "./notices.js";
import { Others } from "./others.js";
import { element } from "./readout.js";
import { titleOf } from "./sessions.js";
import { telescope } from "./telescope.js";

const DEFAULT_FIRST = 5, MANY_JOINTS = 6;

export class CreateDialog {
  // `start(plan)` sends it; `truth(file)` takes a truth that came without a pass, and says whether it could
  constructor(dialog, api, start, truth) {
    Object.assign(this, { dialog, api, start, truth });
    this.form = dialog.querySelector("form");
    this.fields = this.form.elements;
    this.problem = dialog.querySelector(".problem");
    this.others = new Others(dialog.querySelector(".others"));
    this.fields.mesh.accept = ACCEPT_MESH;
    this.fields.folder.addEventListener("change", () => this.take(this.fields.folder.files));
    this.fields.files.addEventListener("change", () => this.take(this.fields.files.files));
    this.fields.mesh.addEventListener("change", () => this.takeModel(modelFiles([...this.fields.mesh.files])));
    this.fields.model.addEventListener("change", () => this.showModel());
    this.form.addEventListener("input", () => this.refresh());
    this.form.addEventListener("submit", (event) => { event.preventDefault(); this.submit(); });
    dialog.querySelector(".close").addEventListener("click", () => dialog.close());
    this.acceptDrops();
    this.clear();
  }

  clear() {
    this.form.reset();
    this.found = { sky: [], frames: [], ignored: 0 };
    this.models = [];
    this.tell(null);
    this.refresh();
  }

  // For a new session, or to send more frames to one that is there.
  async open(session = null) {
    if (this.dialog.open || document.body.classList.contains("reader")) return;
    this.session = session;
    this.dialog.querySelector("h2").textContent = session ? `Frames for ${titleOf(session)}` : "New track";
    for (const part of this.dialog.querySelectorAll(".of-new")) part.hidden = Boolean(session);
    this.dialog.querySelector(".later").hidden = session?.state === "ready";
    this.refresh();
    this.dialog.showModal();
    if (session) return;
    try {
      this.models = (await this.api.json("/v1/models?limit=200")).models.reverse();
    } catch (error) {
      this.tell(error);
    }
    this.listModels(this.fields.model.value);
  }

  // Anywhere on the page: files that are dropped open the dialog.
  acceptDrops() {
    addEventListener("dragover", (event) => {
      event.preventDefault();
      document.body.classList.add("dropping");
    });
    addEventListener("dragleave", (event) => {
      if (!event.relatedTarget) document.body.classList.remove("dropping");
    });
    addEventListener("drop", async (event) => {
      event.preventDefault();
      document.body.classList.remove("dropping");
      const files = await dropped(event.dataTransfer);
      const { model, sky, frames, truth } = sort(files);
      if (truth && ![model, sky, frames].flat().length && !this.dialog.open && this.truth(truth)) return;
      if (!this.dialog.open) await this.open();
      this.take(files);
    });
  }

  async take(files) {
    const found = sort(files);
    if (found.frames.length || found.sky.length) this.found = found;
    if (!this.fields.name.value && found.frames.length) {
      const path = found.frames[0].path || found.frames[0].webkitRelativePath || "";
      this.fields.name.value = path.includes("/") ? path.split("/")[0] : "";
    }
    this.chooseSky();
    await this.preview();
    if (!this.session) await this.takeModel(found.model);
  }

  chooseSky() {
    const { sky, frames } = this.found;
    const moving = frames.some(isVideo);
    this.fields.sky.value = sky.length ? "files" : !this.session ? "auto" : moving ? "border" : "first";
    this.fields.first.max = Math.max(frames.length - 1, 1);
    this.fields.first.value = Math.min(DEFAULT_FIRST, Math.max(frames.length - 1, 1));
    this.refresh();
  }

  async preview() {
    const picture = this.dialog.querySelector(".preview");
    const file = this.found.frames[0];
    picture.hidden = true;
    if (!file?.type.match(/png|jpeg/)) return;
    URL.revokeObjectURL(picture.src);
    picture.src = URL.createObjectURL(file);
    picture.hidden = await picture.decode().then(() => false, () => true); // 16 bits or broken: the service will tell
  }

  async takeModel([file, ...meshes]) {
    if (!file) return;
    const form = new FormData();
    form.append("file", file);
    for (const mesh of meshes) form.append("meshes", mesh);
    this.busy(`Reading ${file.name}…`);
    try {
      const model = await this.api.json("/v1/models", { method: "POST", body: form });
      this.models = [model, ...this.models.filter((known) => known.model_id !== model.model_id)];
      this.listModels(model.model_id);
      this.tell(null);
    } catch (error) {
      this.tell(error);
      this.showModel();
    }
  }

  listModels(chosen) {
    const options = this.models.map((model) => new Option(model.name, model.model_id));
    this.fields.model.replaceChildren(new Option(options.length ? "Choose…" : "None uploaded yet", ""), ...options);
    this.fields.model.value = this.models.some((model) => model.model_id === chosen) ? chosen : "";
    this.showModel();
  }

  get model() {
    return this.models.find((model) => model.model_id === this.fields.model.value);
  }

  showModel() {
    const { model } = this;
    const joints = model?.joints ?? [];
    this.busy(!model ? "" : [
      `${model.faces.toLocaleString("en")} faces`, `${model.parts.length} ${model.parts.length === 1 ? "part" : "parts"}`,
      `${model.size.map((s) => Number(s.toPrecision(3))).join(" × ")} units`, ...model.warnings].join(" · "));
    const box = this.dialog.querySelector(".joints");
    box.querySelector("div").replaceChildren(...joints.map((joint) => {
      const label = element("label"), input = element("input");
      Object.assign(input, { type: "checkbox", name: "joint", value: joint.name, checked: joints.length <= MANY_JOINTS });
      label.append(input, ` ${joint.name} `, element("small", `${joint.min} to ${joint.max}${joint.kind === "revolute" ? "°" : ""}`));
      return label;
    }));
    this.others.show(this.models, model);
    this.refresh();
  }

  busy(text) {
    this.dialog.querySelector(".model-facts").textContent = text;
  }

  refresh() {
    const { sky, frames, truth, ignored } = this.found, { fields } = this;
    const tracked = this.tracked();
    const known = this.dialog.querySelector(".known");
    known.hidden = !this.session?.frames || frames.length <= this.session.frames;
    known.querySelector("span").textContent = `The first ${this.session?.frames} are tracked already: leave them out`;
    this.dialog.querySelector(".frame-facts").textContent =
      frames.length ? describe(frames) + (truth ? ` · with ${truth.name}` : "") + (ignored ? ` · ${ignored} other ${ignored === 1 ? "file" : "files"} left out` : "") : "";
    this.dialog.querySelector(".sky-facts").textContent = sky.length ? describe(sky) : "no folder called background or sky";
    fields.sky[0].disabled = !sky.length;
    fields.sky[1].disabled = frames.length < 2 || frames.some(isVideo);
    fields.sky[2].disabled = Boolean(this.session); // it was decided when the session began
    for (const part of this.dialog.querySelectorAll(".later")) part.disabled = !frames.length;
    const compares = this.others.ids.length > 0;
    this.dialog.querySelector(".joints").hidden = compares || !this.model?.joints.length;
    this.dialog.querySelector(".all-joints").hidden = !compares;
    this.dialog.querySelector(".up-from").textContent = fields.mount.value === "altaz" ? "zenith" : "north";
    const missing = !frames.length ? "Choose the frames"
      : !this.model && !this.session ? "Choose the spacecraft's model" : null;
    const button = fields.start;
    button.disabled = Boolean(missing);
    const videos = tracked.filter(isVideo).length;
    button.textContent = missing ?? (videos ? `Track ${videos === 1 ? tracked[0].name : `${videos} videos`}` : `Track ${tracked.length} ${tracked.length === 1 ? "frame" : "frames"}`);
  }

  tell(error) {
    this.problem.hidden = !error;
    this.problem.replaceChildren(error ? problemText(error) : "");
  }

  // The frames to track: not those that serve as empty sky, or that the session has.
  tracked() {
    const { fields, found: { frames }, session } = this;
    if (session?.state === "ready") {
      const has = session.frames < frames.length && fields.known.checked ? session.frames : 0;
      return frames.slice(has);
    }
    return fields.sky.value === "first" ? frames.slice(Number(fields.first.value)) : frames;
  }

  plan() {
    const { fields, found, session } = this;
    const first = fields.sky.value === "first" ? found.frames.slice(0, Number(fields.first.value)) : [];
    const sky = fields.sky.value === "files" ? found.sky : first;
    const border = fields.sky.value === "border" ? fields.border.valueAsNumber : null;
    const truth = found.truth && { file: found.truth, first: first.length };
    if (session?.state === "ready") return { session, sky: [], border: null, frames: this.tracked(), truth };
    if (session) return { session, sky, border, frames: this.tracked(), truth };
    return { request: this.request(), sky, border, frames: this.tracked(), truth };
  }

  request() {
    const { fields } = this;
    const numbers = { particles: fields.particles.valueAsNumber, seed: fields.seed.valueAsNumber };
    const filter = Object.fromEntries(Object.entries(numbers).filter(([, value]) => Number.isFinite(value)));
    const others = this.others.ids;
    const ticked = [...this.dialog.querySelectorAll(".joints input:checked")].map((input) => input.value);
    const joints = !others.length ? ticked : fields.all_joints.checked ? "all" : [];
    const rate = fields.rate.valueAsNumber;
    return {
      ...(others.length ? { model_ids: [this.model.model_id, ...others] } : { model_id: this.model.model_id }),
      ...(fields.name.value.trim() ? { name: fields.name.value.trim() } : {}),
      ...(joints.length ? { joints: { free: joints } } : {}),
      ...(fields.sky.value === "auto" ? { background: "auto" } : {}),
      filter: { preset: fields.preset.value, ...filter },
      ...(rate > 0 ? { motion: { frame_interval_s: 1 / rate } } : {}),
      ...telescope(fields),
    };
  }

  async submit() {
    this.fields.start.disabled = true;
    try {
      await this.start(this.plan());
      this.dialog.close();
      this.clear();
    } catch (error) {
      this.tell(error);
      this.fields.start.disabled = false;
    }
  }
}
