// Title, status and connection of the watched session; save and delete.
import { download } from "./download.js";
import { ask, tellProblem } from "./notices.js";
import { badge, element } from "./readout.js";
import { titleOf } from "./sessions.js";

const $ = (id) => document.getElementById(id);

export function addHeading(api, { deleted }) {
  let session = null, model = "", arrived = 0, ofFrame = []; // ofFrame: warnings of the frame that is shown

  $("export").addEventListener("change", async (event) => {
    const format = event.target.value;
    event.target.value = "";
    try {
      await save(api, session.session_id, format);
    } catch (error) {
      tellProblem(error);
    }
  });
  $("delete").addEventListener("click", async () => {
    const doomed = session;
    const says = element("p", `${titleOf(doomed)} and its ${doomed.frames} frames will be gone for good.`);
    const sure = await ask("Delete this session?", says, [[false, "Keep it"], [true, "Delete", "danger"]], false);
    if (!sure) return;
    try {
      await api.call(`/v1/sessions/${doomed.session_id}`, { method: "DELETE" });
    } catch (error) {
      tellProblem(error);
    }
    deleted();
  });

  const warn = () => {
    const texts = [...session.warnings, ...ofFrame];
    if (texts.join() === [...$("warnings").children].map((line) => line.textContent).join()) return;
    $("warnings").replaceChildren(...texts.map((text) => element("li", text)));
  };

  const update = (now) => {
    session = now;
    $("title").textContent = titleOf(now);
    if (now.state !== "ready") $("status").replaceChildren(badge("waiting"));
    if (now.state !== "ready") $("status").firstChild.textContent = "Needs empty sky";
    warn();
    document.title = `${titleOf(now)} · skypose`;
  };

  return {
    update,
    open(now) {
      model = "";
      ofFrame = [];
      $("status").replaceChildren();
      $("moment").textContent = now.frames ? "" : "Waiting for the first frame.";
      update(now);
    },
    setModel(found) {
      model = found.name;
    },
    show(estimate) {
      arrived = performance.now();
      if ($("status").firstChild?.className !== `badge ${estimate.status}`) $("status").replaceChildren(badge(estimate.status));
      ofFrame = estimate.warnings ?? [];
      warn();
      $("moment").textContent = `${model ? `${model} · ` : ""}frame ${estimate.index} · ${when(estimate.time)}`;
    },
    // The lamp in the page's head, and the mark over everything that may not be the newest.
    link(stream, shown, past) {
      const lamp = $("link"), stale = Boolean(stream?.stale);
      const seconds = Math.round((stream?.silentMs ?? 0) / 1000);
      const state = !stream ? (api.reached ? "live" : "lost") : stale ? "lost" : stream.state;
      lamp.className = state;
      const says = !stream ? { live: "ready", lost: "not connected" }[state] : { live: past ? "live, looking at the past" : quiet(shown, arrived), lost: "reconnecting",
        connecting: "connecting", ended: "ended" }[state] ?? "";
      const text = lamp.querySelector(".text");
      if (text.textContent !== says) text.textContent = says;
      $("session").classList.toggle("stale", stale);
      $("stale").hidden = !stale;
      const [alert, age] = $("stale").children; // the alert is read out once, not every second
      if (Boolean(alert.textContent) !== stale) alert.textContent = stale ? "Stale: what you see may be old." : "";
      age.textContent = `Nothing heard from the service for ${seconds} s.`;
    },
  };
}

function quiet(shown, arrived) {
  const seconds = Math.floor((performance.now() - arrived) / 1000);
  return !shown || seconds < 5 ? "live" : "live, no new frame";
}

function when(time) {
  return `${time.slice(0, 10)} ${time.slice(11, 23).replace("Z", "")} UTC`;
}

async function save(api, id, format) {
  const answer = await api.call(`/v1/sessions/${id}/${format === "report" ? "report" : `export?format=${format}`}`);
  const named = /filename="([^"]+)"/.exec(answer.headers.get("Content-Disposition") ?? "");
  download(await answer.blob(), named?.[1] ?? `${id}.${format}`);
}
