// Contrast and colours of a picture: its grey levels go through a table of 256 colours.
const STOPS = {
  grey: ["#000000", "#ffffff"],
  inverted: ["#ffffff", "#000000"],
  inferno: ["#000004", "#280b53", "#65156e", "#9f2a63", "#d44842", "#f57d15", "#fac127", "#fcffa4"],
  viridis: ["#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725"],
};
export const COLOURS = Object.keys(STOPS);

const channels = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));

// (256 × 3) colours: a level `gain` times as bright, then through the stops.
export function table(gain, colours) {
  const stops = STOPS[colours].map(channels), found = new Uint8ClampedArray(768);
  for (let level = 0; level < 256; level++) {
    const at = (Math.min(1, (gain * level) / 255)) * (stops.length - 1), low = Math.min(Math.floor(at), stops.length - 2);
    for (let c = 0; c < 3; c++) found[3 * level + c] = stops[low][c] + (at - low) * (stops[low + 1][c] - stops[low][c]);
  }
  return found;
}

// The picture (an ImageBitmap) through the table, as something to draw; itself where nothing changes.
export function toned(bitmap, gain, colours) {
  if (gain === 1 && colours === "grey") return bitmap;
  const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
  const context = canvas.getContext("2d");
  context.drawImage(bitmap, 0, 0);
  const image = context.getImageData(0, 0, bitmap.width, bitmap.height), { data } = image;
  const colour = table(gain, colours), keepsHue = colours === "grey";
  for (let i = 0; i < data.length; i += 4) {
    const grey = (77 * data[i] + 150 * data[i + 1] + 29 * data[i + 2]) >> 8;
    for (let c = 0; c < 3; c++) data[i + c] = colour[3 * (keepsHue ? data[i + c] : grey) + c];
  }
  context.putImageData(image, 0, 0);
  return canvas;
}
