// Mouse, pen, fingers and keys on the view: drag turns, wheel or two fingers zoom, a double click goes back.

const DEGREES_PER_PIXEL = 0.4;
const WHEEL = 0.0015;
const LINE = 16; // pixels per line, for wheels that count lines
const PASSING_BY = 400; // ms: a page that scrolls already goes on scrolling when the view slides under the pointer
const KEYS = { ArrowLeft: [5, 0], ArrowRight: [-5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] };

export class Gestures {
  constructor(canvas, camera, bounds, move) {
    Object.assign(this, { canvas, camera, bounds, move, fingers: new Map(), outside: -Infinity });
    this.elsewhere = (event) => {
      if (event.target !== canvas) this.outside = event.timeStamp;
    };
    window.addEventListener("wheel", this.elsewhere, { capture: true, passive: true });
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"])
      canvas.addEventListener(name, (event) => this.up(event));
    canvas.addEventListener("dblclick", (event) => {
      this.move([0, 0, 1]);
      event.preventDefault();
    });
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  get busy() {
    return this.fingers.size > 0;
  }

  change(turn, tilt, zoom) {
    const [a, e, z] = this.camera();
    this.move([a + turn, e + tilt, z * zoom].map((v, k) => Math.min(Math.max(v, this.bounds[k][0]), this.bounds[k][1])));
  }

  down(event) {
    if (event.button !== 0) return;
    this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.style.cursor = "grabbing";
    this.canvas.style.outline = "none"; // a frame is for those who come with the keyboard
    this.canvas.focus({ preventScroll: true });
    event.preventDefault();
  }

  drag(event) {
    const from = this.fingers.get(event.pointerId);
    if (!from) return;
    const before = spread(this.fingers);
    this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (before) this.change(0, 0, spread(this.fingers) / before);
    else this.change((from[0] - event.clientX) * DEGREES_PER_PIXEL, (event.clientY - from[1]) * DEGREES_PER_PIXEL, 1);
  }

  up(event) {
    this.fingers.delete(event.pointerId);
    if (!this.fingers.size) this.canvas.style.cursor = "grab";
  }

  wheel(event) {
    if (event.timeStamp - this.outside < PASSING_BY) {
      this.outside = event.timeStamp;
      return;
    }
    event.preventDefault();
    event.stopPropagation();
    this.change(0, 0, Math.exp(-event.deltaY * (event.deltaMode ? LINE : 1) * WHEEL));
  }

  key(event) {
    if (KEYS[event.key]) this.change(...KEYS[event.key], 1);
    else if (event.key === "+" || event.key === "-") this.change(0, 0, event.key === "+" ? 1.1 : 1 / 1.1);
    else if (event.key === "Home") this.move([0, 0, 1]);
    else return;
    this.canvas.style.outline = "";
    event.preventDefault();
    event.stopPropagation(); // the notebook would select another cell
  }

  close() {
    window.removeEventListener("wheel", this.elsewhere, { capture: true });
  }
}

// Distance of two fingers in pixels, 0 with fewer.
function spread(fingers) {
  const [a, b] = fingers.values();
  return b ? Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1) : 0;
}
