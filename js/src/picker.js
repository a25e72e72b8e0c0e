// The value under the pointer: of the nearest vertex that is not hidden by a nearer one.

const REACH = 7; // CSS pixels
const THICKNESS = 20; // mm of what counts as the same surface

export class Picker {
  constructor(stage, bubble) {
    Object.assign(this, { stage, bubble, at: null });
  }

  point(event, busy) {
    this.at = busy || event.pointerType === "touch" ? null : [event.offsetX, event.offsetY];
    this.refresh();
  }

  leave() {
    this.at = null;
    this.refresh();
  }

  // Again with every picture: the face moves under a pointer that rests.
  refresh() {
    const found = this.at && this.find(...this.at);
    this.bubble.style.display = found ? "block" : "none";
    if (!found) return;
    const value = Number.isNaN(found.value) ? "unknown" : `${found.value.toFixed(2)} mm`;
    this.bubble.textContent = `${value} · vertex ${found.vertex}`;
    this.bubble.style.left = `${Math.min(this.at[0] + 12, this.stage.width - 130)}px`;
    this.bubble.style.top = `${Math.max(this.at[1] - 24, 0)}px`;
  }

  find(x, y) {
    const place = this.stage.paneAt(x, y);
    const drawn = place && [place.pane.head, place.pane.cloud].find((thing) => thing?.visible && thing.values);
    if (!drawn) return null;
    const at = drawn.position;
    const near = [];
    for (let k = 0; k < drawn.values.length; k++) {
      const point = this.stage.camera.project([at[3 * k], at[3 * k + 1], at[3 * k + 2]]);
      const far = Math.hypot(((point.x - place.x) * place.width) / 2, ((point.y - place.y) * place.height) / 2);
      if (far < REACH) near.push({ vertex: k, value: drawn.values[k], far, distance: point.distance });
    }
    const front = Math.min(...near.map((one) => one.distance)) + THICKNESS;
    return near.filter((one) => one.distance <= front).reduce((a, b) => (a && a.far <= b.far ? a : b), null);
  }
}
