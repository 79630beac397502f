// Files and folders that a user picked or dropped, sorted into a model, empty sky, and frames.
const MESHES = ["glb", "obj", "stl", "ply"], ROBOTS = ["urdf"], PIECES = [...MESHES, "dae"];
const IMAGES = {
  png: "image/png", jpg: "image/jpeg", jpeg: "image/jpeg", tif: "image/tiff", tiff: "image/tiff", fits: "image/fits",
  fit: "image/fits", fts: "image/fits", fz: "image/fits", npy: "application/x-npy",
};
const VIDEOS = {
  ser: "video/x-ser", avi: "video/x-msvideo", mp4: "video/mp4", mkv: "video/x-matroska", mov: "video/quicktime",
};
const SKY_FOLDER = /^(backgrounds?|bg|sky|darks?|empty)[ _.-]*\d*$/i, SKY_FILE = /^(background|bg|sky|dark|empty)[ _.-]*\d/i;
const TRUTH_FILE = /^truth.*\.csv$/i;
const order = new Intl.Collator("en", { numeric: true }).compare;

export const ACCEPT_MESH = [...PIECES, ...ROBOTS].map((name) => `.${name}`).join(",");

const pathOf = (file) => file.path || file.webkitRelativePath || file.name;
const folderOf = (file) => pathOf(file).split("/").slice(0, -1).join("/");

function suffixOf(file) {
  const parts = file.name.toLowerCase().replace(/\.gz$/, "").split(".");
  return parts.length > 1 ? parts.at(-1) : "";
}

export function mediaType(file) {
  const suffix = suffixOf(file);
  return IMAGES[suffix] ?? VIDEOS[suffix] ?? null;
}

export const isVideo = (file) => suffixOf(file) in VIDEOS;

const isSky = (file) => SKY_FOLDER.test(folderOf(file).split("/").at(-1)) || SKY_FILE.test(file.name);

// The files of one model: a mesh, or a URDF file and the meshes that it names.
export function modelFiles(files) {
  const robot = files.find((file) => ROBOTS.includes(suffixOf(file)));
  const ofKind = (kinds) => files.filter((file) => kinds.includes(suffixOf(file)));
  return robot ? [robot, ...ofKind(PIECES)] : ofKind(MESHES).slice(0, 1);
}

// {model: [], sky: [], frames: [], truth, ignored}: frames and sky in the order of their numbers; truth: a file, or none.
export function sort(files) {
  const sorted = [...files].filter((file) => !file.name.startsWith(".")).sort((a, b) => order(pathOf(a), pathOf(b)));
  const model = modelFiles(sorted);
  const images = sorted.filter((file) => mediaType(file));
  const sky = images.filter(isSky);
  const frames = largestFolder(images.filter((file) => !sky.includes(file)));
  const truth = sorted.find((file) => TRUTH_FILE.test(file.name));
  const ignored = sorted.length - model.length - sky.length - frames.length - (truth ? 1 : 0);
  return { model, sky, frames, truth, ignored };
}

// A pass is one folder: pictures elsewhere (masks, previews) are not its frames.
function largestFolder(images) {
  const folders = Map.groupBy ? Map.groupBy(images, folderOf) : grouped(images);
  return [...folders.values()].sort((a, b) => b.length - a.length)[0] ?? [];
}

function grouped(images) {
  const folders = new Map();
  for (const image of images) folders.set(folderOf(image), [...(folders.get(folderOf(image)) ?? []), image]);
  return folders;
}

// All files of a drop, with their paths; folders are walked.
export async function dropped(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  return (await Promise.all(entries.map(walk))).flat();
}

async function walk(entry) {
  if (entry.isFile) {
    const file = await new Promise((done, failed) => entry.file(done, failed));
    file.path = entry.fullPath.replace(/^\//, "");
    return [file];
  }
  const reader = entry.createReader(), found = [];
  for (;;) { // a reader gives at most some hundred entries at a time
    const some = await new Promise((done, failed) => reader.readEntries(done, failed));
    if (!some.length) return (await Promise.all(found.map(walk))).flat();
    found.push(...some);
  }
}

export function describe(files) {
  if (!files.length) return "none";
  if (files.length === 1) return pathOf(files[0]);
  return `${files.length} files, ${files[0].name} to ${files.at(-1).name}`;
}
