// What stands in a pane: a head with its values, what is inside it, or a cloud of points.

import { BufferAttribute, BufferGeometry, DoubleSide, Mesh, Points, ShaderMaterial, Vector3 } from "three";

const STEP = 1 / 64; // mm: positions are whole numbers of it
const UNKNOWN = 65535; // among values, which are otherwise 0 .. 65534 between the ends of their range
const SKIN = [205, 170, 150];
const GREY = [160, 160, 160];

// A wrapped key light and one at the camera, as in adaptiveface.rendering; both come along with the camera.
const LIGHT = `
  vec3 lit(vec3 colour, vec3 n, vec3 eye) {
    n = dot(n, eye) < 0.0 ? -n : n;
    vec3 key = normalize(vec3(-0.5, 0.6, 0.5));
    float diffuse = 0.30 + 0.45 * abs(dot(n, eye)) + 0.30 * max((dot(n, key) + 0.35) / 1.35, 0.0);
    float shine = 0.06 * pow(clamp(dot(n, normalize(eye + key)), 0.0, 1.0), 18.0);
    return colour * diffuse + shine;
  }`;
const VERTEX = `${LIGHT}
  attribute vec3 tint;
  uniform float size;
  varying vec3 shown;
  void main() {
    vec4 at = modelViewMatrix * vec4(position, 1.0);
    shown = lit(tint, normalize(normalMatrix * normal), normalize(-at.xyz));
    gl_PointSize = size;
    gl_Position = projectionMatrix * at;
  }`;
const FLAT = VERTEX.replace(/shown = lit.*/, "shown = tint;"); // points without normals
const FRAGMENT = `varying vec3 shown; void main() { gl_FragColor = vec4(shown, 1.0); }`;

function material(vertexShader, size = 1) {
  return new ShaderMaterial({ vertexShader, fragmentShader: FRAGMENT, uniforms: { size: { value: size } }, side: DoubleSide });
}

// Values in millimetres, NaN where unknown; null where there are none.
function decoded(sent, [low, high], bytes) {
  const codes = new Uint16Array(bytes(sent));
  if (!codes.length) return null;
  const scale = (high - low) / (UNKNOWN - 1);
  const values = new Float32Array(codes.length);
  for (let k = 0; k < codes.length; k++) values[k] = codes[k] === UNKNOWN ? NaN : low + scale * codes[k];
  return values;
}

function millimetres(positions, bytes) {
  const at = new Float32Array(new Int16Array(bytes(positions)));
  for (let k = 0; k < at.length; k++) at[k] *= STEP;
  return at;
}

class Drawn {
  paint({ palette, limits: [low, high] }) {
    const lut = new Uint8Array(palette);
    const last = lut.length / 3 - 1;
    const { values, own } = this;
    const tint = this.geometry.getAttribute("tint");
    for (let k = 0, at = 0; k < tint.count; k++, at += 3) {
      let [from, source] = [at, own]; // of a vertex: its own colour, or that of its value
      if (values) {
        [from, source] = [0, GREY];
        if (!Number.isNaN(values[k])) {
          from = 3 * Math.round(last * Math.min(Math.max((values[k] - low) / (high - low), 0), 1));
          source = lut;
        }
      } else if (!own) [from, source] = [0, SKIN];
      tint.array[at] = source[from];
      tint.array[at + 1] = source[from + 1];
      tint.array[at + 2] = source[from + 2];
    }
    tint.needsUpdate = true;
  }

  dispose() {
    this.geometry.dispose();
    this.object.material.dispose();
  }
}

export class Head extends Drawn {
  constructor({ count, triangles, colours }, bytes) {
    super();
    this.own = colours ? new Uint8Array(bytes(colours)) : null;
    this.geometry = new BufferGeometry();
    this.triangles = new Uint32Array(bytes(triangles));
    this.geometry.setIndex(new BufferAttribute(this.triangles, 1));
    for (const name of ["position", "normal"])
      this.geometry.setAttribute(name, new BufferAttribute(new Float32Array(3 * count), 3));
    this.geometry.setAttribute("tint", new BufferAttribute(new Uint8Array(3 * count), 3, true));
    this.object = new Mesh(this.geometry, material(VERTEX));
    this.object.frustumCulled = false;
  }

  setShape({ positions, values, range }, base, bytes, factor) {
    const at = millimetres(positions, bytes);
    this.place(at, base && factor !== 1 ? millimetres(base.positions, bytes) : null, factor);
    this.values = decoded(values, range, bytes);
  }

  // Vertices "at", as far again from those they differ from as "factor" says.
  place(at, from, factor) {
    if (from?.length === at.length) for (let k = 0; k < at.length; k++) at[k] = from[k] + factor * (at[k] - from[k]);
    this.geometry.getAttribute("position").array.set(at);
    this.geometry.getAttribute("position").needsUpdate = true;
    this.findNormals(at);
  }

  // Of every vertex the sum of its triangles' normals, each as long as its triangle is large.
  findNormals(at) {
    const { triangles } = this;
    const normal = this.geometry.getAttribute("normal");
    const sums = normal.array.fill(0);
    for (let t = 0; t < triangles.length; t += 3) {
      const a = 3 * triangles[t];
      const b = 3 * triangles[t + 1];
      const c = 3 * triangles[t + 2];
      const [ux, uy, uz] = [at[b] - at[a], at[b + 1] - at[a + 1], at[b + 2] - at[a + 2]];
      const [vx, vy, vz] = [at[c] - at[a], at[c + 1] - at[a + 1], at[c + 2] - at[a + 2]];
      const [x, y, z] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
      for (const k of [a, b, c]) {
        sums[k] += x;
        sums[k + 1] += y;
        sums[k + 2] += z;
      }
    }
    normal.needsUpdate = true;
  }
}

// Eyeballs, teeth, tongue and the dark of the mouth, in colours of their own. Rigid parts are placed here, vertex by vertex;
// where the soft ones are is said.
export class Inside extends Head {
  constructor(sent, bytes) {
    super(sent, bytes);
    this.part = new Int8Array(bytes(sent.part));
    this.geometry.getAttribute("tint").array.set(this.own);
    this.object.renderOrder = 1; // after the skin, which hides most of it
  }

  setRest(sent, bytes) {
    this.rest = millimetres(sent, bytes);
  }

  setMotion(sent, base, bytes, factor) {
    this.place(this.moved(sent, bytes), base && factor !== 1 ? this.moved(base, bytes) : null, factor);
  }

  // Rows of a placement are a rotation and a shift, 3 x 4.
  moved({ placements, soft }, bytes) {
    const { part, rest } = this;
    const rows = new Float32Array(bytes(placements));
    const free = millimetres(soft, bytes);
    const at = new Float32Array(rest.length);
    let next = 0;
    for (let k = 0; k < at.length; k += 3) {
      const r = 12 * part[k / 3];
      for (let axis = 0; axis < 3; axis++) {
        const row = r + 4 * axis;
        at[k + axis] = r < 0
          ? free[next++]
          : rows[row] * rest[k] + rows[row + 1] * rest[k + 1] + rows[row + 2] * rest[k + 2] + rows[row + 3];
      }
    }
    return at;
  }
}

export class Cloud extends Drawn {
  constructor() {
    super();
    this.geometry = new BufferGeometry();
    this.object = new Points(this.geometry, material(VERTEX));
    this.object.frustumCulled = false;
  }

  setPoints({ positions, normals, values, range, size }, bytes) {
    const at = millimetres(positions, bytes);
    const n = new Int8Array(bytes(normals));
    if (this.geometry.getAttribute("position")?.array.length !== at.length) this.geometry.dispose();
    this.geometry.setAttribute("position", new BufferAttribute(at, 3));
    this.geometry.setAttribute("normal", new BufferAttribute(Float32Array.from(n.length ? n : at, (v) => v / 127), 3));
    this.geometry.setAttribute("tint", new BufferAttribute(new Uint8Array(at.length), 3, true));
    this.unlit = !n.length;
    const shader = this.unlit ? FLAT : VERTEX;
    if (this.object.material.vertexShader !== shader) {
      this.object.material.dispose();
      this.object.material = material(shader);
    }
    this.object.material.uniforms.size.value = size * Math.min(window.devicePixelRatio, 2);
    this.values = decoded(values, range, bytes);
  }
}

export { Vector3 };
