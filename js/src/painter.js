// Draws without WebGL, into the pixels of a canvas: where WebGL itself runs on the processor, it takes five times as long for
// a head's many small triangles. The light is that of webgl.js.

const NEAR = 100; // mm: what is nearer to the camera is not drawn
const BELOW = 100; // mm: so far below the middle of the face the camera sees the skin from within
const KEY = [-0.5, 0.6, 0.5].map((value) => value / Math.hypot(0.5, 0.6, 0.5));

export class Painter {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
  }

  setSize(width, height, ratio) {
    this.ratio = ratio;
    Object.assign(this.canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    this.image = new ImageData(this.canvas.width, this.canvas.height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.nearness = new Float32Array(this.pixels.length); // 1 / distance, 0 where there is nothing
  }

  // "boxes" (left, top, width, height) of the panes, CSS pixels.
  draw(panes, boxes, camera) {
    this.camera = camera;
    this.pixels.fill(0);
    this.nearness.fill(0);
    const below = camera.eye[1] < camera.pivot[1] - BELOW; // then one sees into the neck
    panes.forEach(({ head, inside, cloud }, k) => {
      const [left, top, width, height] = boxes[k].map((edge) => edge * this.ratio);
      const corner = [Math.round(left), Math.round(top)];
      this.pane = [...corner, Math.round(left + width) - corner[0], Math.round(top + height) - corner[1]];
      for (const thing of [head, inside, cloud]) {
        if (!thing?.visible) continue;
        this.project(thing);
        this.light(thing);
        if (thing.triangles) this.fill(thing.triangles, thing === inside || below);
        else this.dots(Math.round(thing.size * this.ratio));
      }
    });
    this.context.putImageData(this.image, 0, 0);
  }

  forget() {}

  close() {}

  // Of every vertex its place in pixels, and 1 / distance.
  project({ position: at }) {
    const { eye, right: [rx, ry, rz], up: [ux, uy, uz], away: [ax, ay, az], focal } = this.camera;
    const [left, top, width, height] = this.pane;
    const count = at.length / 3;
    if (!(this.x?.length >= count)) for (const name of ["x", "y", "near", "r", "g", "b"]) this[name] = new Float32Array(count);
    const { x, y, near } = this;
    const scale = (focal * height) / 2;
    const [middleX, middleY] = [left + width / 2, top + height / 2];
    for (let k = 0, i = 0; k < count; k++, i += 3) {
      const X = at[i] - eye[0];
      const Y = at[i + 1] - eye[1];
      const Z = at[i + 2] - eye[2];
      const distance = -(ax * X + ay * Y + az * Z);
      const n = distance > NEAR ? 1 / distance : 0;
      near[k] = n;
      x[k] = middleX + scale * n * (rx * X + ry * Y + rz * Z);
      y[k] = middleY - scale * n * (ux * X + uy * Y + uz * Z);
    }
    this.count = count;
  }

  // Of every vertex its colour in the light.
  light({ position: at, normal, tint, unlit }) {
    const { r, g, b, count } = this;
    if (unlit) {
      for (let k = 0; k < count; k++) [r[k], g[k], b[k]] = [tint[3 * k], tint[3 * k + 1], tint[3 * k + 2]];
      return;
    }
    const [ex, ey, ez] = this.camera.eye;
    const [kx, ky, kz] = this.camera.carried(KEY);
    for (let k = 0, i = 0; k < count; k++, i += 3) {
      let [vx, vy, vz] = [ex - at[i], ey - at[i + 1], ez - at[i + 2]];
      const v = 1 / Math.sqrt(vx * vx + vy * vy + vz * vz);
      (vx *= v), (vy *= v), (vz *= v);
      let [nx, ny, nz] = [normal[i], normal[i + 1], normal[i + 2]];
      let n = 1 / Math.sqrt(nx * nx + ny * ny + nz * nz || 1);
      if (nx * vx + ny * vy + nz * vz < 0) n = -n;
      (nx *= n), (ny *= n), (nz *= n);
      const facing = nx * vx + ny * vy + nz * vz;
      const wrapped = Math.max((nx * kx + ny * ky + nz * kz + 0.35) / 1.35, 0);
      const diffuse = 0.3 + 0.45 * facing + 0.3 * wrapped;
      const [hx, hy, hz] = [vx + kx, vy + ky, vz + kz];
      const half = Math.max((nx * hx + ny * hy + nz * hz) / Math.sqrt(hx * hx + hy * hy + hz * hz), 0);
      const two = half * half;
      const four = two * two;
      const shine = 15.3 * two * four * four * four * four; // 255 * 0.06 * half ** 18
      r[k] = Math.min(tint[i] * diffuse + shine, 255);
      g[k] = Math.min(tint[i + 1] * diffuse + shine, 255);
      b[k] = Math.min(tint[i + 2] * diffuse + shine, 255);
    }
  }

  // Triangles that face the camera, or all of them, with their corners' colours in between.
  fill(triangles, both) {
    const { x, y, near, r, g, b, pixels, nearness } = this;
    const [left, top, paneWidth, paneHeight] = this.pane;
    const [right, bottom, stride] = [left + paneWidth - 1, top + paneHeight - 1, this.canvas.width];
    for (let t = 0; t < triangles.length; t += 3) {
      const i = triangles[t];
      let j = triangles[t + 1];
      let k = triangles[t + 2];
      const ax = x[i] - 0.5;
      const ay = y[i] - 0.5;
      let ux = x[j] - 0.5 - ax;
      let uy = y[j] - 0.5 - ay;
      let vx = x[k] - 0.5 - ax;
      let vy = y[k] - 0.5 - ay;
      let area = vx * uy - ux * vy;
      if (both && area < 0) [j, k, ux, uy, vx, vy, area] = [k, j, vx, vy, ux, uy, -area];
      if (!(area > 0) || !near[i] || !near[j] || !near[k]) continue;
      const x0 = Math.max(Math.ceil(ax + Math.min(0, ux, vx)), left);
      const x1 = Math.min(Math.floor(ax + Math.max(0, ux, vx)), right);
      const y0 = Math.max(Math.ceil(ay + Math.min(0, uy, vy)), top);
      const y1 = Math.min(Math.floor(ay + Math.max(0, uy, vy)), bottom);
      if (x0 > x1 || y0 > y1) continue;
      // Shares of the corners j and k at a pixel; that of i is what is left.
      const jx = -vy / area;
      const jy = vx / area;
      const kx = uy / area;
      const ky = -ux / area;
      let js = jx * (x0 - ax) + jy * (y0 - ay);
      let ks = kx * (x0 - ax) + ky * (y0 - ay);
      const ni = near[i];
      const nj = near[j] - ni;
      const nk = near[k] - ni;
      for (let row = y0; row <= y1; row++, js += jy, ks += ky) {
        let v = js;
        let w = ks;
        for (let at = row * stride + x0, end = row * stride + x1; at <= end; at++, v += jx, w += kx) {
          if (v < -1e-6 || w < -1e-6 || v + w > 1.000001) continue;
          const n = ni + v * nj + w * nk;
          if (n <= nearness[at]) continue;
          nearness[at] = n;
          const u = 1 - v - w;
          pixels[at] = 0xff000000 | ((u * b[i] + v * b[j] + w * b[k]) << 16) | ((u * g[i] + v * g[j] + w * g[k]) << 8) |
            (u * r[i] + v * r[j] + w * r[k]);
        }
      }
    }
  }

  // Squares, so many pixels wide.
  dots(size) {
    const { x, y, near, r, g, b, pixels, nearness, count } = this;
    const [left, top, width, height] = this.pane;
    const stride = this.canvas.width;
    for (let k = 0; k < count; k++) {
      if (!near[k]) continue;
      const colour = 0xff000000 | (b[k] << 16) | (g[k] << 8) | r[k];
      const [x0, y0] = [Math.round(x[k] - size / 2), Math.round(y[k] - size / 2)];
      for (let row = Math.max(y0, top); row < Math.min(y0 + size, top + height); row++)
        for (let column = Math.max(x0, left); column < Math.min(x0 + size, left + width); column++) {
          const at = row * stride + column;
          if (near[k] <= nearness[at]) continue;
          nearness[at] = near[k];
          pixels[at] = colour;
        }
    }
  }
}
