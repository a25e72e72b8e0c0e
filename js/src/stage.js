// Everything that is drawn: one scene per pane, one camera for all, one canvas.

import { PerspectiveCamera, Scene, WebGLRenderer } from "three";
import { Cloud, Head, Inside } from "./drawn.js";
import { Painter } from "./painter.js";

const DISTANCE = 700; // mm from the camera to the middle of the face
const PIVOT = 50; // mm behind it: what the camera turns about
const MOST_PIXELS = 2; // per CSS pixel

export class Stage {
  constructor(canvas, columns, rows, centre, radius, renderer) {
    Object.assign(this, { canvas, columns, rows, radius });
    this.pivot = [centre[0], centre[1], centre[2] - PIVOT];
    if (renderer === "canvas" || (renderer !== "webgl" && inSoftware())) this.painter = new Painter(canvas);
    else {
      this.renderer = new WebGLRenderer({ canvas, alpha: true, antialias: true, powerPreference: "low-power" });
      this.renderer.setScissorTest(true);
    }
    this.camera = new PerspectiveCamera(30, 1, 100, 2500);
    this.camera.userData.pivot = this.pivot;
    this.panes = [];
    this.resize();
  }

  resize() {
    const ratio = Math.min(window.devicePixelRatio, MOST_PIXELS);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!width || (width === this.width && height === this.height && ratio === this.ratio)) return false;
    Object.assign(this, { width, height, ratio });
    if (this.painter) this.painter.setSize(Math.round(width * ratio), Math.round(height * ratio));
    else {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
    }
    return true;
  }

  setColours(palette, limits) {
    this.colours = { palette: bytes(palette), limits };
    for (const pane of this.panes) for (const thing of [pane.head, pane.cloud]) thing?.paint(this.colours);
  }

  setGeometry(geometry) {
    for (const pane of this.panes) [pane.head, pane.inside, pane.cloud].forEach((thing) => thing?.dispose());
    this.panes = geometry.map((one) => {
      const scene = new Scene();
      const head = one.triangles ? new Head(one, bytes) : null;
      if (head) scene.add(head.object);
      const inside = one.inside ? new Inside(one.inside, bytes) : null;
      if (inside) scene.add(inside.object);
      return { scene, head, inside, cloud: null };
    });
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
        pane.head.object.visible = one.visible;
        pane.head.setShape(one, base, bytes, factor);
        pane.head.paint(this.colours);
      }
      if (pane.inside) {
        pane.inside.object.visible = one.visible;
        pane.inside.setMotion(one.inside, base?.inside, bytes, factor);
      }
      if (one.points) {
        if (!pane.cloud) pane.scene.add((pane.cloud = new Cloud()).object);
        pane.cloud.setPoints(one.points, bytes);
        pane.cloud.paint(this.colours);
      }
    });
  }

  draw([turn, tilt, zoom]) {
    this.resize();
    const { camera, painter, renderer, pivot } = this;
    const [a, e] = [(turn * Math.PI) / 180, (tilt * Math.PI) / 180];
    const reach = DISTANCE + PIVOT;
    camera.position.set(
      pivot[0] + reach * Math.sin(a) * Math.cos(e),
      pivot[1] + reach * Math.sin(e),
      pivot[2] + reach * Math.cos(a) * Math.cos(e),
    );
    camera.lookAt(...pivot);
    const [width, height] = [this.width / this.columns, this.height / this.rows];
    camera.fov = (360 / Math.PI) * Math.atan(this.radius / DISTANCE / zoom);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    painter?.begin();
    this.panes.forEach((pane, k) => {
      const [x, y] = [(k % this.columns) * width, Math.floor(k / this.columns) * height];
      if (painter) {
        const box = [x, y, x + width, y + height].map((edge) => Math.round(edge * this.ratio));
        painter.draw(pane, camera, [box[0], box[1], box[2] - box[0], box[3] - box[1]]);
        return;
      }
      renderer.setViewport(x, this.height - height - y, width, height);
      renderer.setScissor(x, this.height - height - y, width, height);
      renderer.render(pane.scene, camera);
    });
    painter?.end();
  }

  // Pane under a point of the canvas (CSS pixels), and the point in its coordinates, -1 to 1.
  paneAt(x, y) {
    const [width, height] = [this.width / this.columns, this.height / this.rows];
    const [column, row] = [Math.floor(x / width), Math.floor(y / height)];
    const pane = this.panes[row * this.columns + column];
    return pane && { pane, x: (2 * (x - column * width)) / width - 1, y: 1 - (2 * (y - row * height)) / height, width, height };
  }

  close() {
    for (const pane of this.panes) [pane.head, pane.inside, pane.cloud].forEach((thing) => thing?.dispose());
    this.renderer?.dispose();
    this.renderer?.forceContextLoss(); // browsers keep sixteen contexts and then take the oldest away
  }
}

// What the kernel sends as bytes arrives as a DataView, from an embedded state possibly at an odd offset.
function bytes(view) {
  return view instanceof DataView ? view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength) : new ArrayBuffer(0);
}

// Whether WebGL runs on the processor, or not at all.
let software = null;
function inSoftware() {
  if (software === null) {
    const gl = document.createElement("canvas").getContext("webgl");
    const info = gl?.getExtension("WEBGL_debug_renderer_info");
    software = !gl || /swiftshader|llvmpipe|software/i.test(info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "");
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
  }
  return software;
}
