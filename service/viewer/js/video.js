// The pass as a video of what is seen of the frame: every frame from the first, at the speed of the pass or slower.
import { download } from "./download.js";
import { tellProblem } from "./notices.js";
import { titleOf } from "./sessions.js";

// MP4 where the browser makes it, since more programs play it.
const KINDS = ["video/mp4;codecs=avc1.640028", "video/mp4", "video/webm;codecs=vp9", "video/webm"];
const BITS_PER_S = 8_000_000, LONGEST_WAIT_MS = 10_000;

export class Video {
  constructor(button, frame, timeline) {
    Object.assign(this, { button, frame, timeline, running: false });
    button.addEventListener("click", () => this.toggle());
  }

  async toggle() {
    if (this.running) {
      this.running = false; // what there is by now is saved
      return;
    }
    if (!this.frame.shown) return;
    this.tell(true);
    try {
      await this.save();
    } catch (error) {
      tellProblem(error);
    }
    this.tell(false);
  }

  tell(running) {
    this.running = running;
    this.button.setAttribute("aria-pressed", String(running));
    this.button.textContent = running ? "Stop" : "Video";
  }

  async save() {
    const { frame, timeline } = this, { session } = frame;
    const kind = KINDS.find((one) => globalThis.MediaRecorder?.isTypeSupported(one));
    if (!kind) throw new Error("This browser cannot make a video.");
    timeline.stop();
    timeline.goTo(0);
    await this.shows(0);
    const still = frame.snapshot(), canvas = document.createElement("canvas");
    canvas.width = still.width & ~1; // encoders want even numbers
    canvas.height = still.height & ~1;
    const context = canvas.getContext("2d"), stream = canvas.captureStream(0), [track] = stream.getVideoTracks();
    const recorder = new MediaRecorder(stream, { mimeType: kind, videoBitsPerSecond: BITS_PER_S }), parts = [];
    recorder.addEventListener("dataavailable", (event) => parts.push(event.data));
    const ended = new Promise((done) => recorder.addEventListener("stop", done));
    recorder.start();
    for (let index = 0; index < timeline.count && this.running && frame.session === session; index++) {
      timeline.goTo(index);
      await this.shows(index);
      const began = performance.now();
      context.drawImage(frame.snapshot(), 0, 0, canvas.width, canvas.height);
      track.requestFrame();
      await sleep(timeline.gapMs() - (performance.now() - began));
    }
    recorder.stop();
    await ended;
    const ending = kind.slice(6).split(";")[0];
    if (frame.session === session) download(new Blob(parts, { type: kind }), `${titleOf(session)}.${ending}`);
  }

  // Until image and outlines are those of a frame; one that never comes is left out.
  async shows(index) {
    const last = performance.now() + LONGEST_WAIT_MS;
    while (this.running && this.frame.shown?.index !== index && performance.now() < last) await sleep(10);
  }
}

const sleep = (ms) => new Promise((done) => setTimeout(done, ms));
