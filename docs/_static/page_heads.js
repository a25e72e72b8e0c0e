// Heads in pages without a kernel: what a notebook's widget held when its cell had run, drawn by the widget's own code. A
// head is drawn when it comes into sight, because a page has only so many WebGL contexts.
import heads from "./heads.js";

async function state(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const { values, buffers, paths } = await new Response(stream).json();
  const views = buffers.map((data) => new DataView(Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0)).buffer));
  for (const [path, number] of paths) {
    const last = path.pop();
    path.reduce((place, key) => place[key], values)[last] = views[number];
  }
  return values;
}

// What the widget's code asks of a model; values change in the page only.
function pageModel(values) {
  const listeners = new Map();
  return {
    get: (name) => values[name],
    set: (name, value) => {
      values[name] = value;
      for (const listener of listeners.get(`change:${name}`) ?? []) listener();
    },
    on: (event, listener) => listeners.set(event, [...(listeners.get(event) ?? []), listener]),
    off: (event, listener) => listeners.set(event, (listeners.get(event) ?? []).filter((known) => known !== listener)),
    save_changes: () => {},
  };
}

const inSight = new IntersectionObserver(async (entries) => {
  for (const { isIntersecting, target } of entries) {
    if (!isIntersecting) continue;
    inSight.unobserve(target);
    const model = pageModel(await state(target.querySelector("script").textContent));
    target.replaceChildren();
    heads.render({ model, el: target });
  }
}, { rootMargin: "200px" });
document.querySelectorAll(".adaptiveface-page-head").forEach((place) => inSight.observe(place));
