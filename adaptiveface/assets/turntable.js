// A picture of a 3D view that is turned with mouse, pen or fingers: drag turns, wheel or two fingers zoom, a double click
// goes back. Only wishes are sent ("camera": turn, tilt, zoom); the kernel draws and sends the next picture.
// At most one wish per screen refresh leaves here, and Jupyter's own channel merges those that wait for a busy kernel.

const DEGREES_PER_PIXEL = 0.4;
const WHEEL = 0.0015;
const LINE = 16; // pixels per line, for wheels that count lines
const PASSING_BY = 400; // ms: a page that scrolls already goes on scrolling when the picture slides under the pointer

function render({ model, el }) {
  const image = document.createElement("img");
  image.className = model.get("name");
  image.draggable = false;
  image.width = model.get("width");
  image.height = model.get("height");
  image.alt = "3D view: drag to turn, wheel to zoom, double click to reset";
  image.title = "drag: turn · wheel: zoom · double click: straight ahead";
  image.style.cssText =
    "max-width:100%;height:auto;object-fit:contain;margin:2px 0;cursor:grab;touch-action:none;user-select:none";
  el.appendChild(image);

  let shown = null;
  function show() {
    const data = model.get("value");
    if (!data?.byteLength) return;
    const url = URL.createObjectURL(new Blob([data], { type: "image/jpeg" }));
    const old = shown;
    image.src = shown = url;
    if (old) URL.revokeObjectURL(old);
  }
  model.on("change:value", show);
  show();

  // The page's colour behind the picture: the first opaque one of what holds it.
  function tellBackground() {
    let [colour, holder] = [[255, 255, 255, 1], image];
    while ((holder = holder.parentElement ?? holder.getRootNode().host)) {
      const [red, green, blue, opacity = 1] = getComputedStyle(holder).backgroundColor.match(/[\d.]+/g)?.map(Number) ?? [0, 0, 0, 0];
      if (opacity === 1) {
        colour = [red, green, blue];
        break;
      }
    }
    colour = colour.slice(0, 3).map(Math.round);
    if (String(colour) === String(model.get("background"))) return;
    model.set("background", colour);
    model.save_changes();
  }
  // A theme changes attributes of the page, and its colours when its style sheet is there.
  const theme = new MutationObserver(() => [0, 1000].forEach((wait) => setTimeout(() => image.isConnected && tellBackground(), wait)));
  for (const node of [document.documentElement, document.body])
    theme.observe(node, { attributes: true, attributeFilter: ["class", "style", "theme", "data-jp-theme-light", "data-theme"] });
  requestAnimationFrame(() => image.isConnected && tellBackground());

  const fingers = new Map(); // pointers that are down, by id: [x, y]
  let camera = model.get("camera");
  let waiting = 0;
  model.on("change:camera", follow);
  function follow() {
    if (!fingers.size && !waiting) camera = model.get("camera");
  }
  function wish(change) {
    const limits = model.get("limits");
    camera = camera.map((value, k) => Math.min(Math.max(value + change[k], limits[k][0]), limits[k][1]));
    waiting ||= requestAnimationFrame(send);
  }
  function send() {
    waiting = 0;
    model.set("camera", camera);
    model.save_changes();
  }

  image.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    image.setPointerCapture(event.pointerId);
    image.style.cursor = "grabbing";
    event.preventDefault();
  });
  image.addEventListener("pointermove", (event) => {
    const from = fingers.get(event.pointerId);
    if (!from) return;
    const before = spread(fingers);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (before) {
      wish([0, 0, camera[2] * (spread(fingers) / before - 1)]);
    } else {
      const [x, y] = [event.clientX - from[0], event.clientY - from[1]];
      wish([-x * DEGREES_PER_PIXEL, y * DEGREES_PER_PIXEL, 0]);
    }
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"])
    image.addEventListener(name, (event) => {
      fingers.delete(event.pointerId);
      if (!fingers.size) image.style.cursor = "grab";
    });
  image.addEventListener("dblclick", (event) => {
    camera = [0, 0, 1];
    wish([0, 0, 0]);
    event.preventDefault();
  });

  let outside = -Infinity;
  const elsewhere = (event) => {
    if (event.target !== image) outside = event.timeStamp;
  };
  window.addEventListener("wheel", elsewhere, { capture: true, passive: true });
  image.addEventListener(
    "wheel",
    (event) => {
      if (event.timeStamp - outside < PASSING_BY) {
        outside = event.timeStamp;
        return;
      }
      event.preventDefault();
      event.stopPropagation();
      const pixels = event.deltaY * (event.deltaMode ? LINE : 1);
      wish([0, 0, camera[2] * (Math.exp(-pixels * WHEEL) - 1)]);
    },
    { passive: false },
  );

  return () => {
    window.removeEventListener("wheel", elsewhere, { capture: true });
    theme.disconnect();
    model.off("change:value", show);
    model.off("change:camera", follow);
    cancelAnimationFrame(waiting);
    if (shown) URL.revokeObjectURL(shown);
  };
}

// Distance of two fingers in pixels, 0 with fewer.
function spread(fingers) {
  const [a, b] = fingers.values();
  return b ? Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1) : 0;
}

export default { render };
