// What stands in a pane: a head with its values, what is inside it, or a cloud of points.

const STEP = 1 / 64; // mm: positions are whole numbers of it
const UNKNOWN = 65535; // among values, which are otherwise 0 .. 65534 between the ends of their range
const SKIN = [205, 170, 150];
const GREY = [160, 160, 160];

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

// Positions, normals and colours of vertices; "changed" counts how often each was, for those who keep copies.
class Drawn {
  constructor() {
    this.visible = true;
    this.changed = { position: 0, normal: 0, tint: 0 };
  }

  paint({ palette, limits: [low, high] }) {
    const lut = new Uint8Array(palette);
    const last = lut.length / 3 - 1;
    const { values, own, tint } = this;
    for (let k = 0, at = 0; at < tint.length; k++, at += 3) {
      let [from, source] = [at, own]; // of a vertex: its own colour, or that of its value
      if (values) {
        [from, source] = [0, GREY];
        if (!Number.isNaN(values[k])) {
          from = 3 * Math.round(last * Math.min(Math.max((values[k] - low) / (high - low), 0), 1));
          source = lut;
        }
      } else if (!own) [from, source] = [0, SKIN];
      tint[at] = source[from];
      tint[at + 1] = source[from + 1];
      tint[at + 2] = source[from + 2];
    }
    this.changed.tint++;
  }
}

export class Head extends Drawn {
  constructor({ count, triangles, colours, moving, rest }, bytes) {
    super();
    this.count = count;
    this.moving = new Uint32Array(bytes(moving));
    this.rests = millimetres(rest, bytes); // where those are that do not move
    this.own = colours ? new Uint8Array(bytes(colours)) : null;
    this.triangles = new Uint32Array(bytes(triangles));
    this.position = new Float32Array(3 * count);
    this.normal = new Float32Array(3 * count);
    this.tint = new Uint8Array(3 * count);
  }

  setShape({ positions, values, range }, base, bytes, factor) {
    const at = this.everywhere(millimetres(positions, bytes), 3, this.rests);
    const from = base && factor !== 1 ? this.everywhere(millimetres(base.positions, bytes), 3, this.rests) : null;
    this.place(at, from, factor);
    const known = decoded(values, range, bytes);
    this.values = known && this.everywhere(known, 1, null);
  }

  // Numbers of every vertex, "each" so many, of those that are given for the moving ones only; "others" have theirs, or none.
  everywhere(given, each, others) {
    if (given.length === each * this.count) return given;
    const all = others ? others.slice() : new Float32Array(each * this.count).fill(NaN);
    for (let k = 0, next = 0; k < this.moving.length; k++)
      for (let c = 0; c < each; c++) all[each * this.moving[k] + c] = given[next++];
    return all;
  }

  // Vertices "at", as far again from those they differ from as "factor" says.
  place(at, from, factor) {
    if (from?.length === at.length) for (let k = 0; k < at.length; k++) at[k] = from[k] + factor * (at[k] - from[k]);
    this.position.set(at);
    this.changed.position++;
    this.findNormals(at);
  }

  // Of every vertex the sum of its triangles' normals, each as long as its triangle is large.
  findNormals(at) {
    const { triangles } = this;
    const sums = this.normal.fill(0);
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
    this.changed.normal++;
  }
}

// Eyeballs, teeth, tongue and the dark of the mouth, in colours of their own. Rigid parts are placed here, vertex by vertex;
// where the soft ones are is said.
export class Inside extends Head {
  constructor(sent, bytes) {
    super(sent, bytes);
    this.part = new Int8Array(bytes(sent.part));
    this.tint.set(this.own);
    this.behind = true;
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
  setPoints({ positions, normals, values, range, size }, bytes) {
    const n = new Int8Array(bytes(normals));
    this.unlit = !n.length;
    this.position = millimetres(positions, bytes);
    this.normal = this.unlit ? new Float32Array(this.position.length) : Float32Array.from(n, (v) => v / 127);
    this.tint = new Uint8Array(this.position.length);
    this.size = size;
    this.values = decoded(values, range, bytes);
    this.changed.position++;
    this.changed.normal++;
  }
}
