// One camera for all panes: it looks at the face and turns about a point within the head.

const DISTANCE = 700; // mm from the camera to the middle of the face
const PIVOT = 50; // mm behind it: what the camera turns about

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

export class Camera {
  // "radius": mm of what is seen to each side of the middle, above and below.
  constructor(centre, radius) {
    this.pivot = [centre[0], centre[1], centre[2] - PIVOT];
    this.radius = radius;
    this.look([0, 0, 1], 1);
  }

  // Degrees to the side and up, zoom; "aspect": width by height of a pane.
  look([turn, tilt, zoom], aspect) {
    const [a, e] = [(turn * Math.PI) / 180, (tilt * Math.PI) / 180];
    const away = [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)];
    this.right = [Math.cos(a), 0, -Math.sin(a)];
    this.up = [-Math.sin(a) * Math.sin(e), Math.cos(e), -Math.cos(a) * Math.sin(e)];
    this.away = away;
    this.eye = this.pivot.map((value, k) => value + (DISTANCE + PIVOT) * away[k]);
    this.focal = (DISTANCE * zoom) / this.radius; // half heights of a pane by tangent
    this.aspect = aspect;
  }

  // Place in the pane, -1 to 1, and mm from the camera along its axis.
  project(point) {
    const from = point.map((value, k) => value - this.eye[k]);
    const distance = -dot(from, this.away);
    const scale = this.focal / distance;
    return { x: (dot(from, this.right) * scale) / this.aspect, y: dot(from, this.up) * scale, distance };
  }

  // A direction that comes along with the camera, in the head's frame.
  carried([x, y, z]) {
    return [0, 1, 2].map((k) => x * this.right[k] + y * this.up[k] + z * this.away[k]);
  }
}
