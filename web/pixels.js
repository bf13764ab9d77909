// Pictures as numbers: linear RGB from a portable float map, the difference map from its PNG, and both as colours.

export const WHITE_JND = 10; // white of a stored difference map
const LEVELS = 4096; // of the table from linear light to sRGB

// A PFM of RGB: three lines of text, then float32 rows, the last one first. Gives {width, height, data} top row first.
export function readPfm(buffer) {
  const bytes = new Uint8Array(buffer);
  let end = 0;
  const line = () => {
    const start = end;
    while (bytes[end] !== 10) end += 1;
    end += 1;
    return new TextDecoder().decode(bytes.subarray(start, end - 1));
  };
  if (line() !== "PF") throw new Error("The picture is not a portable float map. Reload the page.");
  const [width, height] = line().split(" ").map(Number);
  const little = Number(line()) < 0;
  const view = new DataView(buffer, end);
  const data = new Float32Array(width * height * 3);
  for (let y = 0; y < height; y += 1) {
    const row = (height - 1 - y) * width * 3;
    for (let x = 0; x < width * 3; x += 1) data[y * width * 3 + x] = view.getFloat32(4 * (row + x), little);
  }
  return { width, height, data };
}

// The values of a difference map [JND], from its grey PNG: 255 is WHITE_JND or more.
export async function readMap(buffer) {
  const bitmap = await createImageBitmap(new Blob([buffer], { type: "image/png" }), { colorSpaceConversion: "none" });
  const canvas = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d", { willReadFrequently: true });
  canvas.drawImage(bitmap, 0, 0);
  const { data } = canvas.getImageData(0, 0, bitmap.width, bitmap.height);
  const values = Float32Array.from({ length: bitmap.width * bitmap.height }, (_, index) => (data[4 * index] / 255) * WHITE_JND);
  return { width: bitmap.width, height: bitmap.height, data: values };
}

const encode = (linear) => 255 * (linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055);
// Even in the square root, where the curve is nearly straight: no step of the table is wider than a level.
const SRGB = Uint8ClampedArray.from({ length: LEVELS + 1 }, (_, index) => Math.round(encode((index / LEVELS) ** 2)));

// As the server's PNGs: exposure, clipped, sRGB; what is not finite is black.
export function toned({ width, height, data }, exposure) {
  const image = new ImageData(width, height);
  for (let index = 0, out = 0; index < data.length; index += 3, out += 4) {
    for (let c = 0; c < 3; c += 1) {
      const shown = data[index + c] * exposure;
      image.data[out + c] = Number.isFinite(shown) ? SRGB[Math.round(LEVELS * Math.sqrt(Math.min(Math.max(shown, 0), 1)))] : 0;
    }
    image.data[out + 3] = 255;
  }
  return onCanvas(image);
}

// Luminance of test less reference, as shown at this exposure: 1 is the display's white.
export function luminanceDifference(reference, test, exposure) {
  const weights = [0.2126, 0.7152, 0.0722];
  const values = new Float32Array(reference.width * reference.height);
  for (let pixel = 0; pixel < values.length; pixel += 1) {
    for (let c = 0; c < 3; c += 1) values[pixel] += weights[c] * exposure * (test.data[3 * pixel + c] - reference.data[3 * pixel + c]);
  }
  return { width: reference.width, height: reference.height, data: values };
}

// Scales that colour-blind readers can tell apart: dark to light (viridis), and blue over grey to orange.
const STOPS = {
  jnd: [[13, 2, 20], [68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]],
  luminance: [[0, 60, 130], [60, 150, 215], [70, 75, 80], [230, 140, 40], [255, 220, 130]],
};
export const SCALES = {
  jnd: { low: 0, high: WHITE_JND, unit: "JND", ticks: [0, 1, 3, 5, 10], words: "visible difference, at the sweep's own exposure" },
  luminance: { low: -0.2, high: 0.2, unit: "of white", ticks: [-0.2, -0.1, 0, 0.1, 0.2], words: "test less reference in luminance, at this exposure" },
};

function colourOf(kind, part) {
  const stops = STOPS[kind];
  const place = Math.min(Math.max(part, 0), 1) * (stops.length - 1);
  const [one, other] = [stops[Math.floor(place)], stops[Math.ceil(place)]];
  return one.map((value, c) => value + (other[c] - value) * (place - Math.floor(place)));
}

export function coloured({ width, height, data }, kind) {
  const { low, high } = SCALES[kind];
  const image = new ImageData(width, height);
  data.forEach((value, pixel) => image.data.set([...colourOf(kind, (value - low) / (high - low)), 255], 4 * pixel));
  return onCanvas(image);
}

// The scale itself, as a strip of `width` colours.
export function scaleStrip(canvas, kind) {
  const paint = canvas.getContext("2d");
  for (let x = 0; x < canvas.width; x += 1) {
    paint.fillStyle = `rgb(${colourOf(kind, x / (canvas.width - 1)).map(Math.round).join(" ")})`;
    paint.fillRect(x, 0, 1, canvas.height);
  }
}

function onCanvas(image) {
  const canvas = new OffscreenCanvas(image.width, image.height);
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}
