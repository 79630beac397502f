// The live view of one session: pose from the WebSocket, overlay image of the newest estimate.
const $ = (id) => document.getElementById(id);
let socket = null, chosen = null, seq = 0, drawing = false, wanted = null;

async function refreshSessions() {
  const found = await (await fetch("/v1/sessions?limit=200")).json();
  $("sessions").replaceChildren(...found.sessions.reverse().map((session) => {
    const button = document.createElement("button");
    button.textContent = session.name || session.session_id.slice(0, 8);
    button.setAttribute("aria-pressed", String(session.session_id === chosen));
    const note = document.createElement("small");
    note.textContent = `${session.status || session.state}, ${session.frames} frames`;
    button.append(note);
    button.onclick = () => choose(session.session_id, session.last_seq);
    const item = document.createElement("li");
    item.append(button);
    return item;
  }));
  if (!chosen && found.sessions.length) choose(found.sessions[0].session_id, found.sessions[0].last_seq);
}

function choose(id, last) {
  chosen = id;
  seq = Math.max(0, last - 1);
  if (socket) socket.close();
  $("overlay").hidden = true;
  $("pose").replaceChildren();
  $("empty").hidden = false;
  $("empty").textContent = "Waiting for the first estimate.";
  connect(id);
}

function connect(id) {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const mine = new WebSocket(`${scheme}://${location.host}/v1/sessions/${id}/stream?after=${seq}`);
  socket = mine;
  mine.onopen = () => { $("link").textContent = "live"; };
  mine.onmessage = (event) => {
    const message = JSON.parse(event.data);
    seq = message.seq;
    if (message.type === "estimate") show(message.estimate);
    if (message.type === "end") $("link").textContent = `ended: ${message.reason}`;
  };
  mine.onclose = () => {
    if (socket !== mine || chosen !== id) return;
    $("link").textContent = "stale: reconnecting";
    setTimeout(() => { if (chosen === id) connect(id); }, 1000);
  };
}

function show(estimate) {
  const best = estimate.best, spread = estimate.spread;
  const rows = {
    frame: `${estimate.index}  ${estimate.time}`,
    status: estimate.status,
    yaw: `${best.yaw_deg.toFixed(2)} ± ${spread.yaw_deg.toFixed(2)}°`,
    pitch: `${best.pitch_deg.toFixed(2)} ± ${spread.pitch_deg.toFixed(2)}°`,
    roll: `${best.roll_deg.toFixed(2)} ± ${spread.roll_deg.toFixed(2)}°`,
    position: `${best.x_px.toFixed(1)}, ${best.y_px.toFixed(1)} px`,
    scale: `${best.scale_px.toFixed(3)} px per unit`,
    modes: estimate.modes.map((mode) => `${(100 * mode.weight).toFixed(0)} %`).join(", "),
    particles: `${estimate.particles}, effective ${estimate.ess.toFixed(0)}`,
    time: `${(estimate.timing_ms.total ?? 0).toFixed(1)} ms`,
  };
  for (const [name, value] of Object.entries(best.joints)) rows[name] = value.toFixed(2);
  $("pose").replaceChildren(...Object.entries(rows).flatMap(([name, value]) => {
    const term = document.createElement("dt"), text = document.createElement("dd");
    term.textContent = name;
    text.textContent = value;
    return [term, text];
  }));
  $("empty").hidden = true;
  wanted = `/v1/sessions/${estimate.session_id}/estimates/${estimate.index}/overlay.png`;
  draw();
}

// One overlay at a time; what comes meanwhile replaces what waits.
function draw() {
  if (drawing || !wanted) return;
  const image = new Image();
  drawing = true;
  image.onload = image.onerror = (event) => {
    if (event.type === "load") { $("overlay").src = image.src; $("overlay").hidden = false; }
    drawing = false;
    draw();
  };
  image.src = wanted;
  wanted = null;
}

refreshSessions();
setInterval(refreshSessions, 3000);
