// Heads in a saved notebook and in pages made of it, without a kernel and without WebGL: where a picture stands, the head
// that it shows is drawn when it comes into sight, and turns. views/saved.py writes what is read here.

import { Painter } from "./painter.js";
import { show } from "./view.js";

async function values(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const { state, buffers } = await new Response(stream).json();
  const views = buffers.map((data) => new DataView(Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0)).buffer));
  const filled = (value) => {
    if (Array.isArray(value)) return value.map(filled);
    if (value === null || typeof value !== "object") return value;
    return "bytes" in value ? views[value.bytes] : Object.fromEntries(Object.entries(value).map(([k, one]) => [k, filled(one)]));
  };
  return filled(state);
}

// What a view asks of a model; values change in the page only.
function pageModel(state) {
  const listeners = new Map();
  return {
    get: (name) => state[name],
    set: (name, value) => {
      state[name] = value;
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
    const model = pageModel(await values(target.querySelector("script").textContent));
    target.replaceChildren();
    show({ model, el: target }, (canvas) => new Painter(canvas));
  }
}, { rootMargin: "200px" });
for (const place of document.querySelectorAll(".adaptiveface-saved-head:not([data-seen])")) {
  place.dataset.seen = "yes";
  inSight.observe(place);
}
