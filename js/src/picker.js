// The value under the pointer: of the nearest vertex that is not hidden by a nearer one.

import { Vector3 } from "./drawn.js";

const REACH = 7; // CSS pixels
const THICKNESS = 0.0075; // of what counts as the same surface, in depth of the picture: some 20 mm at the face

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
    const drawn = place && [place.pane.head, place.pane.cloud].find((thing) => thing?.object.visible && thing.values);
    if (!drawn) return null;
    const at = drawn.geometry.getAttribute("position").array;
    const point = new Vector3();
    const near = [];
    for (let k = 0; k < drawn.values.length; k++) {
      point.set(at[3 * k], at[3 * k + 1], at[3 * k + 2]).project(this.stage.camera);
      const far = Math.hypot(((point.x - place.x) * place.width) / 2, ((point.y - place.y) * place.height) / 2);
      if (far < REACH) near.push({ vertex: k, value: drawn.values[k], far, depth: point.z });
    }
    const front = Math.min(...near.map((one) => one.depth)) + THICKNESS;
    return near.filter((one) => one.depth <= front).reduce((a, b) => (a && a.far <= b.far ? a : b), null);
  }
}
