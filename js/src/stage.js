// Everything that is drawn: what stands in every pane, one camera for all, one canvas.

import { Camera } from "./camera.js";
import { Cloud, Head, Inside } from "./drawn.js";

const MOST_PIXELS = 2; // per CSS pixel

export class Stage {
  // "painter" draws: WebGL or Painter.
  constructor(canvas, columns, rows, centre, radius, painter) {
    Object.assign(this, { canvas, columns, rows, painter });
    this.camera = new Camera(centre, radius);
    this.panes = [];
    this.resize();
  }

  resize() {
    const ratio = Math.min(window.devicePixelRatio, MOST_PIXELS);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!width || (width === this.width && height === this.height && ratio === this.ratio)) return false;
    Object.assign(this, { width, height, ratio });
    this.painter.setSize(width, height, ratio);
    return true;
  }

  setColours(palette, limits) {
    this.colours = { palette: bytes(palette), limits };
    for (const pane of this.panes) for (const thing of [pane.head, pane.cloud]) thing?.paint(this.colours);
  }

  setGeometry(geometry) {
    this.forget();
    this.panes = geometry.map((one) => ({
      head: one.triangles ? new Head(one, bytes) : null,
      inside: one.inside ? new Inside(one.inside, bytes) : null,
      cloud: null,
    }));
  }

  // of every pane the rigid parts inside its head
  setRests(rests) {
    this.panes.forEach(({ inside }, k) => inside?.setRest(rests[k], bytes));
  }

  // positions and values of every pane; a head that "differs" does so from the first pane's
  setFrame(frames, factor) {
    frames.forEach((one, k) => {
      const pane = this.panes[k];
      const base = one.differs ? frames[0] : null;
      if (pane.head) {
        pane.head.visible = one.visible;
        pane.head.setShape(one, base, bytes, factor);
        pane.head.paint(this.colours);
      }
      if (pane.inside) {
        pane.inside.visible = one.visible;
        pane.inside.setMotion(one.inside, base?.inside, bytes, factor);
      }
      if (one.points) {
        pane.cloud ??= new Cloud();
        pane.cloud.setPoints(one.points, bytes);
        pane.cloud.paint(this.colours);
      }
    });
  }

  draw(look) {
    this.resize();
    const [width, height] = [this.width / this.columns, this.height / this.rows];
    const boxes = this.panes.map((_, k) => [(k % this.columns) * width, Math.floor(k / this.columns) * height, width, height]);
    this.camera.look(look, width / height);
    this.painter.draw(this.panes, boxes, this.camera);
  }

  // Pane under a point of the canvas (CSS pixels), and the point in its coordinates, -1 to 1.
  paneAt(x, y) {
    const [width, height] = [this.width / this.columns, this.height / this.rows];
    const [column, row] = [Math.floor(x / width), Math.floor(y / height)];
    const pane = this.panes[row * this.columns + column];
    return pane && { pane, x: (2 * (x - column * width)) / width - 1, y: 1 - (2 * (y - row * height)) / height, width, height };
  }

  forget() {
    for (const pane of this.panes) for (const thing of [pane.head, pane.inside, pane.cloud]) if (thing) this.painter.forget(thing);
  }

  close() {
    this.forget();
    this.painter.close();
  }
}

// What the kernel sends as bytes arrives as a DataView, from an embedded state possibly at an odd offset.
function bytes(view) {
  return view instanceof DataView ? view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength) : new ArrayBuffer(0);
}
