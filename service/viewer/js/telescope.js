// What the dialog of a new track says of telescope, site and orbit, as the service takes it: only what was filled in.
const CAMERA = {
  up_angle: "up_angle_deg", pixel_scale: "pixel_scale_arcsec",
  latitude: "site_latitude_deg", longitude: "site_longitude_deg", height: "site_height_m",
};

export function telescope(fields) {
  const camera = numbers(fields, CAMERA), prior = numbers(fields, { unit: "unit_m" });
  if (fields.mount.value !== "equatorial") camera.mount = fields.mount.value;
  if (fields.mirrored.checked) camera.mirrored = true;
  if (fields.orbit.value.trim()) prior.orbit = fields.orbit.value.trim();
  return { ...section("camera", camera), ...section("prior", prior) };
}

function numbers(fields, names) {
  const given = Object.entries(names).map(([field, name]) => [name, fields[field].valueAsNumber]);
  return Object.fromEntries(given.filter(([, value]) => Number.isFinite(value)));
}

const section = (name, values) => (Object.keys(values).length ? { [name]: values } : {});
