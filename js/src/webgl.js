// Draws with WebGL, through three.js.

import {
  BufferAttribute, BufferGeometry, DoubleSide, Mesh, PerspectiveCamera, Points, Scene, ShaderMaterial, WebGLRenderer,
} from "three";

// A wrapped key light and one at the camera, as in adaptiveface.geometry.rendering; both come along with the camera.
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

export class WebGL {
  constructor(canvas) {
    this.renderer = new WebGLRenderer({ canvas, alpha: true, antialias: true, powerPreference: "low-power" });
    this.renderer.setScissorTest(true);
    this.camera = new PerspectiveCamera(30, 1, 100, 2500);
    this.objects = new Map(); // of what is drawn
  }

  setSize(width, height, ratio) {
    this.height = height;
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
  }

  // "boxes" (left, top, width, height) of the panes, CSS pixels.
  draw(panes, boxes, view) {
    const { camera, renderer } = this;
    camera.position.set(...view.eye);
    camera.lookAt(...view.pivot);
    camera.fov = (360 / Math.PI) * Math.atan(1 / view.focal);
    camera.aspect = view.aspect;
    camera.updateProjectionMatrix();
    panes.forEach((pane, k) => {
      const [left, top, width, height] = boxes[k];
      renderer.setViewport(left, this.height - height - top, width, height);
      renderer.setScissor(left, this.height - height - top, width, height);
      const scene = new Scene();
      for (const thing of [pane.head, pane.inside, pane.cloud]) if (thing?.visible) scene.add(this.object(thing));
      renderer.render(scene, camera);
    });
  }

  object(thing) {
    let known = this.objects.get(thing);
    if (known && (known.count !== thing.position.length || known.unlit !== thing.unlit)) {
      this.forget(thing);
      known = null;
    }
    if (!known) {
      known = { count: thing.position.length, unlit: thing.unlit, object: this.make(thing) };
      this.objects.set(thing, known);
    }
    const { object } = known;
    object.material.uniforms.size.value = (thing.size ?? 1) * this.renderer.getPixelRatio();
    for (const name of ["position", "normal", "tint"]) {
      const attribute = object.geometry.getAttribute(name);
      attribute.array = thing[name];
      if (known[name] !== thing.changed[name]) attribute.needsUpdate = true;
      known[name] = thing.changed[name];
    }
    return object;
  }

  make(thing) {
    const geometry = new BufferGeometry();
    if (thing.triangles) geometry.setIndex(new BufferAttribute(thing.triangles, 1));
    geometry.setAttribute("position", new BufferAttribute(thing.position, 3));
    geometry.setAttribute("normal", new BufferAttribute(thing.normal, 3));
    geometry.setAttribute("tint", new BufferAttribute(thing.tint, 3, true));
    const material = new ShaderMaterial({
      vertexShader: thing.unlit ? FLAT : VERTEX, fragmentShader: FRAGMENT, uniforms: { size: { value: 1 } }, side: DoubleSide,
    });
    const object = thing.triangles ? new Mesh(geometry, material) : new Points(geometry, material);
    object.frustumCulled = false;
    object.renderOrder = thing.behind ? 1 : 0; // after the skin, which hides most of it
    return object;
  }

  forget(thing) {
    const known = this.objects.get(thing);
    known?.object.geometry.dispose();
    known?.object.material.dispose();
    this.objects.delete(thing);
  }

  close() {
    for (const thing of [...this.objects.keys()]) this.forget(thing);
    this.renderer.dispose();
    this.renderer.forceContextLoss(); // browsers keep sixteen contexts and then take the oldest away
  }
}

// Whether WebGL runs on the processor, or not at all.
let software = null;
export function inSoftware() {
  if (software === null) {
    const gl = document.createElement("canvas").getContext("webgl");
    const info = gl?.getExtension("WEBGL_debug_renderer_info");
    software = !gl || /swiftshader|llvmpipe|software/i.test(info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "");
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
  }
  return software;
}
