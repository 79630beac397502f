// Where the Sun stands, and where the Earth's shadow lies in the sky of a site. For a drawing: good to 0.05 degrees.
const EARTH_KM = 6371, EQUATOR_KM = 6378, DAY_MS = 86_400_000, J2000_MS = Date.UTC(2000, 0, 1, 12);
const radians = (angle) => (angle * Math.PI) / 180, degrees = (angle) => (angle * 180) / Math.PI;

// Azimuth (from north through east) and elevation of the Sun, degrees, without refraction: the low-precision formulae
// of the Astronomical Almanac. `time` in s since 1970, UTC for UT1.
export function sunAt(time, latitudeDeg, longitudeDeg) {
  const days = (time * 1000 - J2000_MS) / DAY_MS;
  const anomaly = radians(357.528 + 0.9856003 * days);
  const longitude = radians(280.46 + 0.9856474 * days + 1.915 * Math.sin(anomaly) + 0.02 * Math.sin(2 * anomaly));
  const tilt = radians(23.439 - 4e-7 * days);
  const rightAscension = Math.atan2(Math.cos(tilt) * Math.sin(longitude), Math.cos(longitude));
  const declination = Math.asin(Math.sin(tilt) * Math.sin(longitude));
  const hour = radians(280.46062 + 360.98564737 * days + longitudeDeg) - rightAscension, latitude = radians(latitudeDeg);
  const east = -Math.cos(declination) * Math.sin(hour);
  const north = Math.cos(latitude) * Math.sin(declination) - Math.sin(latitude) * Math.cos(declination) * Math.cos(hour);
  const up = Math.sin(latitude) * Math.sin(declination) + Math.cos(latitude) * Math.cos(declination) * Math.cos(hour);
  return { azimuth: (degrees(Math.atan2(east, north)) + 360) % 360, elevation: degrees(Math.asin(up)) };
}

// Unit vector east, north, up of a direction in the sky.
export function direction({ azimuth, elevation }) {
  const [a, e] = [radians(azimuth), radians(elevation)];
  return [Math.sin(a) * Math.cos(e), Math.cos(a) * Math.cos(e), Math.sin(e)];
}

// Distance from the Earth's centre, km, of an object at a range (km) and elevation (degrees); a round Earth.
export function radiusOf(range, elevation) {
  return Math.sqrt(EARTH_KM ** 2 + range ** 2 + 2 * EARTH_KM * range * Math.sin(radians(elevation)));
}

// Whether an object `radius` km from the Earth's centre that is seen in a direction is in the Earth's shadow (a
// cylinder); `sun`: the unit vector towards the Sun. Both east, north, up.
export function inShadow([east, north, up], radius, sun) {
  const sight = Math.sqrt((EARTH_KM * up) ** 2 + radius ** 2 - EARTH_KM ** 2) - EARTH_KM * up;
  const place = [sight * east, sight * north, EARTH_KM + sight * up];
  const along = place[0] * sun[0] + place[1] * sun[1] + place[2] * sun[2];
  return along < 0 && radius ** 2 - along ** 2 < EQUATOR_KM ** 2;
}
