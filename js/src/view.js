// A view: panes with heads or point clouds on one canvas, titles, a legend, and what the pointer says and asks.
// The kernel sends geometry once and then positions and values; turning, zooming and light never ask it.

import { Gestures } from "./gestures.js";
import { legend } from "./legend.js";
import { Picker } from "./picker.js";
import { Stage } from "./stage.js";

const TEXT = "color:var(--jp-ui-font-color1, var(--vscode-editor-foreground, CanvasText));font-size:12px;";

function element(tag, style, parent) {
  const node = document.createElement(tag);
  node.style.cssText = style;
  parent.appendChild(node);
  return node;
}

// "painterFor" a canvas and what the model says of it: WebGL or Painter.
export function show({ model, el }, painterFor) {
  const [columns, rows] = model.get("grid");
  const [width, height] = model.get("pane");
  const titles = model.get("titles");
  const frame = element("div", `position:relative;width:${width * columns}px;max-width:100%`, el);
  const canvas = element("canvas", "display:block;width:100%;cursor:grab;touch-action:none;user-select:none", frame);
  canvas.style.aspectRatio = `${width * columns} / ${height * rows}`;
  canvas.className = model.get("name");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `3D view: ${titles.filter(Boolean).join(", ") || "head"}; arrow keys turn it`);
  titles.forEach((title, k) => {
    const place = `left:${(100 * (k % columns)) / columns}%;top:${(100 * Math.floor(k / columns)) / rows}%;width:${100 / columns}%`;
    const node = element("div", `position:absolute;${place};${TEXT}padding:2px 6px;box-sizing:border-box;pointer-events:none`, frame);
    node.textContent = title;
    node.className = "adaptiveface-title";
  });
  const bubble = element("div", `position:absolute;display:none;${TEXT}padding:1px 5px;pointer-events:none;border-radius:3px;` +
    "background:var(--jp-layout-color2, Canvas);border:1px solid var(--jp-border-color1, GrayText);white-space:nowrap", frame);
  bubble.className = "adaptiveface-value";

  const stage = new Stage(canvas, columns, rows, model.get("centre"), model.get("radius"), painterFor(canvas, model.get("renderer")));
  const picker = new Picker(stage, bubble);
  let waiting = 0;
  let fresh = false;
  const draw = () => {
    waiting ||= requestAnimationFrame(() => {
      waiting = 0;
      // Here and not when it arrives: of frames that come faster than they can be drawn, only the newest costs time.
      if (fresh) stage.setFrame(model.get("frame"), model.get("exaggeration"));
      stage.draw(model.get("camera"));
      canvas.dataset.camera = model.get("camera").map((value) => +value.toFixed(3)).join(" ");
      picker.refresh();
      canvas.dispatchEvent(new CustomEvent("adaptiveface-picture", { bubbles: true, detail: { fresh } }));
      fresh = false;
    });
  };
  const colours = () => {
    stage.setColours(model.get("palette"), model.get("limits"));
    draw();
  };
  const geometry = () => {
    stage.setGeometry(model.get("geometry"));
    rests();
  };
  const rests = () => {
    stage.setRests(model.get("rests"));
    update();
  };
  const update = () => {
    fresh = true;
    draw();
  };
  // Of this page only: set without save_changes(), the camera is shared by all copies of the view and never sent.
  const gestures = new Gestures(canvas, () => model.get("camera"), model.get("bounds"), (camera) => model.set("camera", camera));
  canvas.addEventListener("pointermove", (event) => picker.point(event, gestures.busy));
  canvas.addEventListener("pointerleave", () => picker.leave());
  canvas.addEventListener("webglcontextrestored", geometry);

  const foot = element("div", `display:flex;flex-wrap:wrap;gap:2px 16px;align-items:center;${TEXT}`, el);
  if (model.get("label")) legend(foot, model);
  if (model.get("differs")) exaggeration(foot, model);

  const watched = { "change:camera": draw, "change:frame": update, "change:geometry": geometry, "change:exaggeration": update };
  watched["change:rests"] = rests;
  watched["change:palette"] = watched["change:limits"] = colours;
  for (const [name, act] of Object.entries(watched)) model.on(name, act);
  const resized = new ResizeObserver(() => stage.resize() && draw());
  resized.observe(canvas);
  colours();
  geometry();
  return () => {
    for (const [name, act] of Object.entries(watched)) model.off(name, act);
    resized.disconnect();
    gestures.close();
    cancelAnimationFrame(waiting);
    stage.close();
  };
}

// The slider "difference x": how much larger what tells the panes apart is drawn. It belongs to the page, too.
function exaggeration(parent, model) {
  const label = element("label", "display:flex;align-items:center;gap:4px", parent);
  label.title = "draws the difference of these heads larger than it is";
  const name = element("span", "", label);
  const slider = element("input", "width:90px", label);
  slider.className = "adaptiveface-exaggeration";
  Object.assign(slider, { type: "range", min: 1, max: 10, step: 0.5 });
  const show = () => {
    slider.value = model.get("exaggeration");
    name.textContent = `difference × ${model.get("exaggeration")}`;
  };
  slider.addEventListener("input", () => model.set("exaggeration", Number(slider.value)));
  model.on("change:exaggeration", show);
  show();
}
