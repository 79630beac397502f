// Wires the page: one chosen session, its stream and history, and the views of one estimate at a time.
import { Api } from "./api.js";
import { CloudView } from "./cloud.js";
import { Comparison } from "./comparison.js";
import { CreateDialog } from "./create.js";
import { FrameTools } from "./tools.js";
import { FrameView } from "./frame.js";
import { ModelView } from "./model.js";
import { askKey, tellProblem } from "./notices.js";
import { Plots } from "./plots.js";
import { Readout } from "./readout.js";
import { SessionList } from "./sessions.js";
import { Shortcuts } from "./shortcuts.js";
import { SkyView } from "./sky.js";
import { SpinView } from "./spin.js";
import { Timeline } from "./timeline.js";
import { Video } from "./video.js";
import { Watch } from "./watch.js";
import { addHeading } from "./heading.js";
import { follow } from "./progress.js";

const $ = (id) => document.getElementById(id);
const api = new Api(askKey);
const frame = new FrameView($("frame"), api, (wide) => $("views").classList.toggle("wide-frame", wide));
const tools = new FrameTools($("frame"), frame);
const model = new ModelView($("model"));
const cloud = new CloudView($("cloud"), api);
const readout = new Readout($("readout"), (rank) => watch.inspect(rank));
const spin = new SpinView(document.querySelector("#readout .spin"), api);
const plots = new Plots($("plots"), {
  goTo: (time) => watch.goToTime(time),
  says: (text) => { $("pointed").textContent = text; },
  zoomed: (whether) => { $("whole").hidden = !whether; },
});
const timeline = new Timeline($("timeline"), { goTo: (index) => watch.goTo(index), live: () => watch.goLive() });
const video = new Video($("frame").querySelector(".video"), frame, timeline);
const heading = addHeading(api, { deleted: () => forget() });
const watch = new Watch(api, { frame, model, cloud, sky: new SkyView($("sky")), readout, plots, timeline, heading });
const comparison = new Comparison(api, $("compare"), $("truth-file"), {
  changed: (reference) => watch.compare(reference),
  named: (other) => address(list.chosen, other),
});
const list = new SessionList($("sessions"), api, {
  choose: (session) => open(session),
  changed: (sessions) => arrange(sessions),
});
const create = new CreateDialog($("create"), api, async (plan) => {
  const sent = await follow(api, plan);
  if (plan.truth) await comparison.take(plan.truth.file, sent, plan.truth.first);
  await list.refresh();
  const session = list.sessions.find((item) => item.session_id === sent);
  if (session) open(session);
}, (file) => {
  if (watch.session) comparison.take(file);
  return Boolean(watch.session);
});

let absent = null; // the id of a link that led nowhere

function open(session) {
  present("session");
  const [named, other] = linked();
  list.chosen = session.session_id;
  list.draw();
  watch.open(session);
  spin.open(session);
  const beside = named === session.session_id ? other : undefined;
  address(session.session_id, beside);
  comparison.open(session, beside);
}

// The address names the session, and the one that it is compared with.
function address(id, other) {
  history.replaceState(null, "", other ? `#${id}&with=${other}` : `#${id}`);
}

// One of: how to begin, a session, or that a link leads nowhere.
function present(section) {
  for (const id of ["welcome", "session", "missing"]) $(id).hidden = id !== section;
}

const linked = () => location.hash.slice(1).split("&with=").map((id) => id || undefined);

// After every look at the list: the session that is chosen or that the address names; else the newest.
function arrange(sessions) {
  comparison.offer(sessions);
  const id = list.chosen ?? linked()[0];
  const known = sessions.find((session) => session.session_id === id);
  if (known) take(known);
  else if (id) seek(id);
  else if (sessions.length) open(sessions[0]);
  else {
    watch.close();
    present("welcome");
  }
}

function take(session) {
  if (session.session_id === list.chosen) watch.update(session);
  else open(session);
}

// A session that the list does not reach back to, or that is not there: no other is shown in its place.
async function seek(id) {
  if (id === absent) return;
  try {
    take(await api.json(`/v1/sessions/${encodeURIComponent(id)}`));
  } catch (error) {
    if (error.status !== 404 && error.status !== 422) throw error;
    absent = id;
    list.chosen = null;
    watch.close();
    $("missing").querySelector("code").textContent = id;
    present("missing");
  }
}

function forget() {
  list.chosen = absent = null;
  history.replaceState(null, "", location.pathname);
  return list.refresh();
}

function redLight() {
  const on = document.body.classList.toggle("red");
  $("night").setAttribute("aria-pressed", String(on));
  localStorage.setItem("skypose.red", on ? "1" : "");
}

function neighbour(by) {
  const session = list.neighbour(by);
  if (session && session.session_id !== list.chosen) open(session);
}

new Shortcuts([
  ["play or pause the pass", { " ": () => timeline.toggle() }],
  ["one frame back, one on", { ArrowLeft: () => timeline.step(-1), ArrowRight: () => timeline.step(1) }],
  ["ten frames back, ten on", { "Shift+ArrowLeft": () => timeline.step(-10), "Shift+ArrowRight": () => timeline.step(10) }],
  ["first frame, last frame", { Home: () => timeline.step(-Infinity), End: () => timeline.step(Infinity) }],
  ["back to live", { l: () => timeline.goLive() }],
  ["next session, the one before", { j: () => neighbour(1), k: () => neighbour(-1) }],
  ["plots: the whole pass, nearer, farther", { "+": () => plots.zoom(), "-": () => plots.zoom(0.5), 0: () => plots.choose(null) }],
  ["new track", { n: () => create.open() }],
  ["outline of the best pose on or off", { o: () => tools.toggle("outlines") }],
  ["other modes on or off", { m: () => tools.toggle("modes") }],
  ["zoom to the object", { z: () => tools.toggle("zoom") }],
  ["the model’s image and what it leaves over", { d: () => tools.toggle("model") }],
  ["less contrast, more", { "[": () => tools.brighter(-0.5), "]": () => tools.brighter(0.5) }],
  ["next colours", { c: () => tools.nextColours() }],
  ["save what is seen of the frame", { s: () => tools.save() }],
  ["a video of the whole pass; again: stop there", { e: () => video.toggle() }],
  ["set the views back", { v: () => { model.resetView(); cloud.resetView(); } }],
  ["red light", { r: redLight }],
  ["this help", { "?": () => $("help").showModal() }],
], $("help"));

$("more").addEventListener("click", () => create.open(watch.session));
for (const id of ["new", "welcome-new"]) $(id).addEventListener("click", () => create.open());
$("missing").querySelector("button").addEventListener("click", forget);
addEventListener("hashchange", () => {
  list.chosen = absent = null;
  list.refresh();
});
$("night").addEventListener("click", redLight);
$("help-button").addEventListener("click", () => $("help").showModal());
$("help").querySelector(".close").addEventListener("click", () => $("help").close());
$("window").addEventListener("change", (event) => {
  plots.seconds = Number(event.target.value) || null;
  plots.choose(null);
});
$("whole").addEventListener("click", () => plots.choose(null));
if (localStorage.getItem("skypose.red")) redLight();
addEventListener("unhandledrejection", (event) => {
  event.preventDefault();
  tellProblem(event.reason);
});

// Who we are: a reader is offered nothing that would be refused.
async function identify() {
  try {
    const me = await api.json("/v1/me");
    document.body.classList.toggle("reader", me.role === "read");
    $("key-button").hidden = !api.key;
    $("key-button").title = `${me.role} of ${me.tenant}`;
  } catch (error) {
    if (error.status !== 401) throw error;
    $("key-button").hidden = false;
    $("key-button").textContent = "Enter a key";
  }
}

$("key-button").addEventListener("click", () => {
  api.forgetKey();
  location.reload();
});
await identify().catch(tellProblem);
await watch.prepare();
list.run();
