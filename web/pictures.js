// Reference, test and delta of one point at a glance, with the figures that say how far they are apart.

import { getJson, getPicture, query } from "/assets/api.js";
import { el, facts, fill, problem, quiet } from "/assets/dom.js";
import { interval, number, percent, quality } from "/assets/format.js";

const kept = new Map(); // path -> promise of an object URL, the oldest revoked first
const MOST_KEPT = 60;

function picture(path) {
  if (!kept.has(path)) {
    kept.set(path, getPicture(path).catch((error) => { kept.delete(path); throw error; }));
    const [oldest] = kept.keys();
    if (kept.size > MOST_KEPT) { kept.get(oldest).then(URL.revokeObjectURL, () => {}); kept.delete(oldest); }
  }
  return kept.get(path);
}

const imagePath = (sha256, exposure) => `/v1/images/${sha256}.png${query({ exposure })}`;

function frame(kind, caption, alternative, path) {
  const image = el("img", { alt: alternative, "data-picture": kind, decoding: "async" });
  const place = el("div", { class: "frame loading" }, image);
  Promise.resolve(path).then(picture).then(
    (url) => { image.src = url; place.classList.remove("loading"); },
    (error) => { place.classList.remove("loading"); fill(place, problem(error)); },
  );
  return el("figure", { class: kind }, place, el("figcaption", {}, caption));
}

let latest = 0;
let shown = null;

// `compare` is the link to the view that shows more. Without a point it only forgets what was shown.
export function showPictures(box, point, head, compare) {
  const wanted = JSON.stringify([point, head?.noise_floor, compare?.hash]);
  if (point && wanted === shown) return; // a live update elsewhere must not make the pictures flicker
  shown = point && wanted;
  const turn = ++latest;
  if (!point) return;
  const heading = el("p", { class: "chosen-point" }, el("strong", {}, point.label), " ", el("span", { class: "detail" }, costs(head, point)));
  if (!point.image_sha256) {
    fill(box, heading, quiet("This point has no picture yet. It comes with the first result of its job."));
    return;
  }
  const { exposure } = head;
  const reference = point.reference_image_sha256;
  const compared = reference && getJson(`/v1/compare${query({ reference, test: point.image_sha256, exposure })}`);
  const delta = compared?.then((result) => imagePath(result.delta_sha256));
  const figures = el("div", { class: "figures" }, quiet(reference ? "Comparing the pictures …" : ""));
  fill(box, heading,
    el("div", { class: "pictures" },
      reference ? frame("reference", "Reference", `Reference picture of ${head.scene}`, imagePath(reference, exposure))
        : quiet("The reference is not rendered yet; the difference follows it."),
      frame("test", "Test", `${head.scene} rendered with ${point.label}`, imagePath(point.image_sha256, exposure)),
      delta && frame("delta", "Delta: black is the same, white is 10 JND or more",
        "Map of the visible difference between the two, black where they look the same", delta)),
    el("p", {}, compare), figures,
    el("details", {}, el("summary", { "data-key": "all-settings" }, "All settings of this point"),
      facts(Object.entries(point.settings).map(([name, value]) => [name, String(value)]))));
  compared?.then(
    (result) => { if (turn === latest) fill(figures, facts(differences(head, point, result))); },
    (error) => { if (turn === latest) fill(figures, problem(error, () => { shown = null; showPictures(box, point, head, compare); })); },
  );
}

const costs = (head, point) =>
  [point.energy_j && `${interval(point.energy_j, quality(head.energy_quality).unit)} an image`, `${interval(point.time_s, "s")} an image`]
    .filter(Boolean).join(" · ");

// What a comparison found, in words; `head` and `point` are null for pictures that belong to no sweep.
export function differences(head, point, result) {
  return [
    ["Difference of this pair", `${number(result.value)} of ${number(result.limit)}: ${result.acceptable ? "acceptable" : "beyond the limit"}`,
      "Sum of visible differences over the picture; the limit grows with the number of pixels"],
    point?.repeats > 1 && [`Mean over ${point.repeats} seeds`, interval(point.difference), "What the chart shows: the mean over the repeats, with its interval"],
    ["Worst pixel", `${number(result.max_jnd)} JND`, "Just noticeable differences"],
    ["Beyond 3 JND", percent(result.share_above_3_jnd), "Share of the pixels that clearly differ"],
    ["FLIP", number(result.flip_mean), "Second opinion: mean FLIP, 0 is equal"],
    ["SSIM", number(result.ssim), "Second opinion: structural similarity, 1 is equal"],
    ["relMSE", number(result.relmse), "On linear data: the physical error"],
    head?.noise_floor && ["Noise floor", number(head.noise_floor.value), "The reference against itself with another seed"],
    point?.fragile && ["Fragile", point.fragile],
  ].filter(Boolean);
}
