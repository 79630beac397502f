// Shows how far the sending of a pass is, and asks the user about what the service refuses.
import { ask, problemText, tellProblem } from "./notices.js";
import { Sending } from "./send.js";

const $ = (id) => document.getElementById(id);

// Begins to send; resolves to the session's id as soon as it is there.
export async function follow(api, plan) {
  const sending = new Sending(api, plan, { changed: show, onProblem: decide });
  const id = await sending.begin();
  const leave = (event) => event.preventDefault();
  addEventListener("beforeunload", leave);
  $("sending").querySelector("button").onclick = () => sending.stop();
  sending.finished.catch(tellProblem).finally(() => removeEventListener("beforeunload", leave));
  return id;
}

function show(sending) {
  const bar = $("sending"), progress = bar.querySelector("progress");
  const over = sending.step === "done" || sending.step === "stopped";
  bar.hidden = over;
  bar.querySelector("b").textContent = sending.waiting ? "Waiting for the service" : sending.step === "sky" ? "Empty sky" : "Frames";
  bar.querySelector("span").textContent = sending.step === "sky" ? `${sending.skyDone} of ${sending.skyTotal}`
    : `${sending.done} of ${sending.total} · ${sending.rate.toFixed(1)} per second`;
  progress.value = sending.step === "sky" ? sending.skyDone / sending.skyTotal : sending.done / Math.max(sending.total, 1);
}

async function decide(error, file) {
  const content = problemText(error);
  content.append(document.createElement("small"));
  content.lastChild.textContent = file.name;
  return ask("The service refused a file", content,
    [["stop", "Stop"], ["skip", "Leave it out"], ["again", "Try again", "primary"]], "stop");
}
