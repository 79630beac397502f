// The sky of the site: where the object stands and came along, the Sun, and where objects of its height are in the
// Earth's shadow. North is up and east is left, as one sees it lying on one's back.
import { direction, inShadow, radiusOf, sunAt } from "./ephemeris.js";
import { Painter, pixelRatio } from "./gl.js";

const INK = { ring: "#2c3a4b", text: "#93a2b4", lit: "#ffd479", dark: "#7c8b9d", here: "#4da3ff", sun: "#ffe08a" };
const SHADOW = "rgba(110, 80, 150, 0.38)", CELLS = 72, FONT = "11px system-ui, sans-serif";

export class SkyView {
  constructor(figure) {
    this.figure = figure;
    this.canvas = figure.querySelector("canvas");
    this.note = figure.querySelector(".note");
    this.painter = new Painter(figure.querySelector(".stage"), (width, height) => this.draw(width, height));
  }

  // `place`: {azimuth, elevation, range, lit} of the frame that is shown, null where it is not known; `track`: those of
  // all frames; `site`: the session's camera
  show(place, track, time, site) {
    this.figure.hidden = !place;
    if (!place) return;
    const sun = sunAt(time, site.site_latitude_deg, site.site_longitude_deg);
    Object.assign(this, { place, track, sun });
    const round = (angle) => `${angle.toFixed(1)}°`;
    this.note.textContent = `elevation ${round(place.elevation)}, Sun ${round(sun.elevation)}`;
    this.canvas.setAttribute("aria-label", `The sky of the site: the object at azimuth ${round(place.azimuth)}, elevation `
      + `${round(place.elevation)}; the Sun at azimuth ${round(sun.azimuth)}, elevation ${round(sun.elevation)}`);
    this.painter.request();
  }

  draw(width, height) {
    if (!this.place) return;
    const ratio = pixelRatio(), { canvas } = this;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    context.translate(width / 2, height / 2);
    const radius = Math.min(width, height) / 2 - 24;
    this.drawShadow(context, radius);
    drawRings(context, radius);
    this.drawTrack(context, radius);
    this.drawSun(context, radius);
  }

  drawShadow(context, radius) {
    const { place, sun } = this, height = radiusOf(place.range, place.elevation), towards = direction(sun);
    const cell = (2 * radius) / CELLS;
    context.beginPath(); // one path: cells that touch are not drawn twice
    for (let i = 0; i < CELLS; i++) {
      for (let k = 0; k < CELLS; k++) {
        const x = (i + 0.5) * cell - radius, y = (k + 0.5) * cell - radius, out = Math.hypot(x, y) / radius;
        const seen = { azimuth: (Math.atan2(-x, -y) * 180) / Math.PI, elevation: 90 * (1 - out) };
        if (out < 1 && inShadow(direction(seen), height, towards)) context.rect(x - cell / 2, y - cell / 2, cell + 0.5, cell + 0.5);
      }
    }
    context.fillStyle = SHADOW;
    context.fill();
  }

  drawTrack(context, radius) {
    context.lineWidth = 2;
    context.lineCap = "round";
    this.track.forEach((now, k) => {
      const before = this.track[k - 1] ?? now;
      context.strokeStyle = now.lit === false ? INK.dark : INK.lit;
      context.beginPath();
      context.moveTo(...onChart(before, radius));
      context.lineTo(...onChart(now, radius));
      context.stroke();
    });
    disc(context, onChart(this.place, radius), 5, INK.here);
  }

  // Below the horizon: on the rim, hollow.
  drawSun(context, radius) {
    const { sun } = this, below = sun.elevation < 0;
    const at = onChart({ ...sun, elevation: Math.max(sun.elevation, 0) }, radius);
    context.strokeStyle = INK.sun;
    context.lineWidth = 1.5;
    disc(context, at, 6, below ? "#0a0e13" : INK.sun);
    context.stroke();
    const inwards = Math.abs(at[0]) > radius / 2 ? [at[0] - Math.sign(at[0]) * 34, at[1] + 14] : [at[0], at[1] + (at[1] > 0 ? -16 : 16)];
    label(context, below ? `Sun ${sun.elevation.toFixed(0)}°` : "Sun", inwards);
  }
}

function onChart({ azimuth, elevation }, radius) {
  const out = radius * (1 - elevation / 90), angle = (azimuth * Math.PI) / 180;
  return [-out * Math.sin(angle), -out * Math.cos(angle)];
}

function disc(context, [x, y], radius, colour) {
  context.fillStyle = colour;
  context.beginPath();
  context.arc(x, y, radius, 0, 7);
  context.fill();
}

function label(context, text, [x, y]) {
  context.fillStyle = INK.text;
  context.font = FONT;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(text, x, y);
}

function drawRings(context, radius) {
  context.strokeStyle = INK.ring;
  context.lineWidth = 1;
  for (const elevation of [0, 30, 60]) {
    context.beginPath();
    context.arc(0, 0, radius * (1 - elevation / 90), 0, 7);
    context.stroke();
    if (elevation) label(context, `${elevation}°`, [0, -radius * (1 - elevation / 90) + 8]);
  }
  for (const [name, azimuth] of [["N", 0], ["E", 90], ["S", 180], ["W", 270]]) label(context, name, onChart({ azimuth, elevation: 0 }, radius + 12));
}
