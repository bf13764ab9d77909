// Puts a live chart in the place of its picture once it comes into view, in the page's own colours.
const pageColours = JSON.parse(document.getElementById("page-colours").textContent);
const dark = matchMedia("(prefers-color-scheme: dark)");
const views = new Map();

function inPageColours(text) {
  const style = getComputedStyle(document.documentElement);
  const spec = JSON.parse(text, function inkFor(key, value) {
    const halo = this.type === "text"; // a point keeps its white edge: dark colours need it most on a dark screen
    const name = value === "#ffffff" && !halo ? null : pageColours[value];
    return name ? style.getPropertyValue(name).trim() : value;
  });
  const config = { ...spec.config, background: "transparent", font: getComputedStyle(document.body).fontFamily };
  const screen = document.documentElement.clientWidth;
  if (screen < 600) {
    config.legend = { ...config.legend, columns: 2, labelLimit: 150, labelFontSize: 11, layout: { bottom: { direction: "vertical" } } };
    config.title = { ...config.title, limit: screen - 60 };
    config.axis = { ...config.axis, labelLimit: 110 };
  }
  return { ...spec, background: "transparent", config };
}

async function draw(box) {
  const text = document.getElementById(box.id.replace(/^chart-/, "spec-")).textContent;
  const picture = box.querySelector("img");
  const description = picture?.alt ?? box.dataset.description ?? "";
  const canvas = document.createElement("div");
  box.append(canvas); // in the page before it is drawn, because its width is its container's
  try {
    const { view } = await globalThis.vegaEmbed(canvas, inPageColours(text), {
      mode: "vega-lite", ast: true, actions: false, renderer: "svg", defaultStyle: false,
      tooltip: { disableDefaultStyle: true, theme: "joulebox" },
    });
    views.get(box)?.finalize();
    views.set(box, view);
    canvas.querySelector("svg")?.setAttribute("aria-label", description);
    box.dataset.description = description;
    for (const old of [...box.children]) if (old !== canvas) old.remove();
  } catch (error) {
    canvas.remove(); // the picture stays
    console.error(`${box.id}: ${error.message}`);
  }
}

const near = new IntersectionObserver((entries) => {
  for (const { isIntersecting, target } of entries) {
    if (!isIntersecting) continue;
    near.unobserve(target);
    draw(target);
  }
}, { rootMargin: "600px" });
for (const box of document.querySelectorAll(".drawing")) near.observe(box);
dark.addEventListener("change", () => { for (const box of views.keys()) draw(box); });
