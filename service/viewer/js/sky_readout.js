// What an estimate tells of the sky: attitude among the stars, range and elevation, the Sun. What is not known is left out.
import { Vector3 } from "../vendor/three/three.module.min.js";
import { quaternionOf } from "./rotation.js";

const SHADOW = { true: "sunlit", false: "in the Earth’s shadow" };
const SOURCES = { ephemeris: "by time and pointing", told: "told", fitted: "fitted" };

// [[name, value]…] of an estimate as the API answers it.
export function skyRows({ best, camera, orbit, light }) {
  return [...attitude(best.attitude), ...pointing(camera), ...place(orbit, best), ...sun(light)];
}

function attitude(found) {
  if (!found) return [];
  const rows = [[`Attitude, body to ${found.frame} (w, x, y, z)`, "wxyz".split("").map((axis) => found.orientation[axis].toFixed(4)).join(", ")]];
  const rate = found.angular_velocity_gcrf_deg_s;
  return rate ? [...rows, [`Turning in ${found.frame}`, `${Math.hypot(...rate).toFixed(2)} °/s`]] : rows;
}

// Where the camera looks. Of a mirrored image z comes towards the observer.
function pointing(camera) {
  if (!camera) return [];
  const { x, y, z } = new Vector3(0, 0, camera.mirrored ? -1 : 1).applyQuaternion(quaternionOf(camera.orientation));
  const degrees = (angle) => (angle * 180) / Math.PI;
  return [["Pointing (RA, Dec)", `${((degrees(Math.atan2(y, x)) + 360) % 360).toFixed(3)}°, ${degrees(Math.asin(z)).toFixed(3)}°`]];
}

function place(orbit, best) {
  if (!orbit) return [];
  const rows = [
    ["Range", `${orbit.range_km.toFixed(1)} km`],
    ["Azimuth, elevation", `${orbit.azimuth_deg.toFixed(2)}°, ${orbit.elevation_deg.toFixed(2)}°`],
    ["Age of the elements", `${orbit.elements_age_days.toFixed(2)} days`],
  ];
  const expected = orbit.expected_scale_px;
  if (!expected) return rows;
  const off = (100 * (best.scale_px / expected - 1)).toFixed(1);
  return [...rows, ["Scale by the range", `${expected.toPrecision(4)} px/unit, seen ${off} % off`]];
}

function sun(light) {
  const rows = [];
  if (light?.sun) rows.push(["Phase angle", `${light.phase_deg.toFixed(1)}°, Sun ${SOURCES[light.source] ?? light.source}`]);
  if (light && light.sunlit !== null) rows.push(["Light", SHADOW[light.sunlit]]);
  return rows;
}
