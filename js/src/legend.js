// The legend of the heat map: its colours, the ends and the middle of its range, and what it means.

export function legend(parent, model) {
  const box = document.createElement("div");
  box.className = "adaptiveface-legend";
  box.style.cssText = "display:grid;grid-template-columns:1fr auto 1fr;width:260px;line-height:1.2;font-size:11px";
  const bar = document.createElement("div");
  bar.style.cssText = "grid-column:1/4;height:8px;border-radius:2px";
  const ticks = ["left", "center", "right"].map((side) => {
    const tick = document.createElement("span");
    tick.style.textAlign = side;
    return tick;
  });
  const name = document.createElement("span");
  name.style.cssText = "grid-column:1/4;text-align:center";
  box.append(bar, ...ticks, name);
  parent.appendChild(box);
  const show = () => {
    const palette = model.get("palette");
    const steps = Array.from({ length: 17 }, (_, k) => {
      const at = 3 * Math.round((k / 16) * (palette.byteLength / 3 - 1));
      return `rgb(${palette.getUint8(at)} ${palette.getUint8(at + 1)} ${palette.getUint8(at + 2)})`;
    });
    bar.style.background = `linear-gradient(to right, ${steps})`;
    const [low, high] = model.get("limits");
    [low, (low + high) / 2, high].forEach((value, k) => (ticks[k].textContent = String(+value.toPrecision(3))));
    name.textContent = model.get("label");
  };
  for (const trait of ["palette", "limits", "label"]) model.on(`change:${trait}`, show);
  show();
}
