// A chart (a picture that the kernel draws) with two horizontal lines over it that can be dragged, or moved with the arrow
// keys. views/thresholds.py says what the values mean.

const CSS = `
.adaptiveface-thresholds { position: relative; display: inline-block; max-width: 100%; margin: 2px 0; }
.adaptiveface-thresholds img { display: block; max-width: 100%; height: auto; }
.adaptiveface-threshold { position: absolute; height: 17px; margin-top: -9px; cursor: ns-resize; touch-action: none; }
.adaptiveface-threshold::before { content: ""; position: absolute; top: 8px; left: 0; right: 0; border-top: 2px dashed #7a7a7a; }
.adaptiveface-threshold span { position: absolute; right: 2px; top: -8px; font: 11px sans-serif; padding: 0 2px;
  color: var(--jp-ui-font-color1, var(--vscode-editor-foreground, CanvasText));
  background: color-mix(in srgb, var(--jp-layout-color0, var(--vscode-editor-background, Canvas)) 70%, transparent); user-select: none; }
.adaptiveface-threshold:focus { outline: none; }
.adaptiveface-threshold:focus::before, .adaptiveface-threshold:hover::before { border-top-color: #d55e00; }`;

function render({ model, el }) {
  const root = document.createElement("div"), style = document.createElement("style"), picture = document.createElement("img");
  style.textContent = CSS;
  root.className = "adaptiveface-thresholds";
  picture.className = "adaptiveface-chart";
  picture.alt = model.get("description");
  root.append(style, picture);
  el.append(root);

  // The axes in shares of the picture, and the decades at their lower and upper end.
  const axes = () => model.get("axes"), decades = () => model.get("decades");
  const toShare = (value) => {
    const [low, high] = decades(), [, top, , bottom] = axes();
    return bottom + ((Math.log10(value) - low) / (high - low)) * (top - bottom);
  };
  const toValue = (share) => {
    const [low, high] = decades(), [, top, , bottom] = axes();
    return 10 ** (low + ((share - bottom) / (top - bottom)) * (high - low));
  };

  const lines = ["low", "high"].map((name) => {
    const line = document.createElement("div"), label = document.createElement("span");
    line.className = `adaptiveface-threshold adaptiveface-threshold-${name}`;
    line.tabIndex = 0;
    line.setAttribute("role", "slider");
    line.append(label);
    root.append(line);

    const place = () => {
      const [left, top, right, bottom] = axes(), value = model.get(name);
      const share = Math.min(Math.max(toShare(value), top), bottom);
      line.style.left = `${100 * left}%`;
      line.style.width = `${100 * (right - left)}%`;
      line.style.top = `${100 * share}%`;
      const [lowest, highest] = decades();
      line.setAttribute("aria-label", model.get("names")[name]);
      line.setAttribute("aria-valuemin", `${10 ** lowest}`);
      line.setAttribute("aria-valuemax", `${10 ** highest}`);
      line.setAttribute("aria-valuenow", `${value}`);
      label.textContent = `${model.get("names")[name]} ${Number(value.toPrecision(3))}`;
    };

    // The kernel tracks anew for every value: while the line is moved it is told of ten a second, and of the last.
    let told = 0, timer = null;
    const tell = (now) => {
      clearTimeout(timer);
      const send = () => { told = performance.now(); model.save_changes(); };
      if (now || performance.now() - told > 100) send();
      else timer = setTimeout(send, 100);
    };
    const move = (value, now) => {
      const [lowest, highest] = decades();
      const other = model.get(name === "low" ? "high" : "low");
      const within = Math.min(Math.max(value, 10 ** lowest), 10 ** highest);
      model.set(name, name === "low" ? Math.min(within, other) : Math.max(within, other));
      tell(now);
    };
    line.addEventListener("pointerdown", (event) => { line.setPointerCapture(event.pointerId); line.focus(); event.preventDefault(); });
    line.addEventListener("pointermove", (event) => {
      if (!line.hasPointerCapture(event.pointerId)) return;
      const box = picture.getBoundingClientRect();
      move(toValue((event.clientY - box.top) / box.height), false);
    });
    line.addEventListener("pointerup", () => tell(true));
    line.addEventListener("keydown", (event) => {
      const steps = { ArrowUp: 1, ArrowDown: -1, PageUp: 5, PageDown: -5 }[event.key];
      if (steps === undefined) return;
      event.preventDefault();
      move(model.get(name) * 10 ** (steps / 20), true);
    });
    model.on(`change:${name}`, place);
    return place;
  });

  let address = null;
  const show = () => {
    const value = model.get("value"), before = address;
    address = URL.createObjectURL(new Blob([value], { type: "image/png" }));
    picture.src = address;
    if (before) URL.revokeObjectURL(before);
  };
  picture.width = model.get("size")[0];
  model.on("change:value", show);
  show();
  lines.forEach((place) => place());
  return () => { if (address) URL.revokeObjectURL(address); };
}

export default { render };
