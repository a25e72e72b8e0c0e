"""A page that plays an avatar with three.js and three-vrm, and says what it sees."""

from __future__ import annotations

PAGE = """<!doctype html><title>avatar</title>
<script type="importmap">{"imports": {"three": "/node_modules/three/build/three.module.js",
 "three/addons/": "/node_modules/three/examples/jsm/",
 "@pixiv/three-vrm": "/node_modules/@pixiv/three-vrm/lib/three-vrm.module.js"}}</script>
<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { DRACOLoader } from 'three/addons/loaders/DRACOLoader.js';
import { MeshoptDecoder } from 'three/addons/libs/meshopt_decoder.module.js';
import { VRMLoaderPlugin, VRMUtils } from '@pixiv/three-vrm';
const out = document.createElement('pre'); out.id = 'out';
const size = 420;
try {
  const loader = new GLTFLoader();
  loader.setDRACOLoader(new DRACOLoader().setDecoderPath('/node_modules/three/examples/jsm/libs/draco/gltf/'));
  loader.setMeshoptDecoder(MeshoptDecoder);
  loader.register(parser => new VRMLoaderPlugin(parser));
  const gltf = await loader.loadAsync('/FILE');
  const vrm = gltf.userData.vrm || null;
  if (vrm) VRMUtils.rotateVRM0(vrm);
  const clip = gltf.animations[gltf.animations.length - 1], mixer = new THREE.AnimationMixer(gltf.scene);
  mixer.clipAction(clip).play();
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0xffffff);
  const sun = new THREE.DirectionalLight(0xffffff, 1.5); sun.position.set(1, 2, 3);
  scene.add(gltf.scene, new THREE.HemisphereLight(0xffffff, 0x808080, 2), sun);
  const faces = [], meshes = [];
  gltf.scene.traverse(o => { if (o.isMesh) { meshes.push(o); if (o.morphTargetInfluences) faces.push(o); } });
  mixer.setTime(0); gltf.scene.updateMatrixWorld(true);
  const box = new THREE.Box3(), v = new THREE.Vector3();
  const world = (mesh, i) => mesh.localToWorld(mesh.getVertexPosition(i, v).clone());
  for (const face of faces) for (let i = 0; i < face.geometry.attributes.position.count; i += 3)
    box.expandByPoint(world(face, i));
  const centre = box.getCenter(new THREE.Vector3()), extent = box.getSize(new THREE.Vector3()).y;
  const camera = new THREE.PerspectiveCamera(24, 1, extent / 50, extent * 50);
  camera.position.copy(centre).add(new THREE.Vector3(0.15, 0.05, 1).multiplyScalar(4 * extent));
  camera.lookAt(centre);
  const renderer = new THREE.WebGLRenderer({preserveDrawingBuffer: true, antialias: true});
  renderer.setSize(size, size, false);
  const bone = BONE ? gltf.scene.getObjectByName(BONE) : faces[0];
  const look = time => {
    if (vrm) vrm.update(1 / 60);  // before the mixer, as docs/retargeting.md says
    mixer.setTime(time); gltf.scene.updateMatrixWorld(true);
    for (const mesh of meshes) if (mesh.skeleton) mesh.skeleton.update();
    renderer.render(scene, camera);
    const points = [];
    for (const face of faces) for (let i = 0; i < face.geometry.attributes.position.count; i += 11)
      points.push(face.getVertexPosition(i, v).toArray());
    const weights = {};
    for (const face of faces) weights[face.name] = Array.from(face.morphTargetInfluences);
    return {points, weights, head: bone.getWorldQuaternion(new THREE.Quaternion()).toArray(),
      place: bone.getWorldPosition(new THREE.Vector3()).toArray(), picture: renderer.domElement.toDataURL('image/png')};
  };
  const frames = TIMES.map(look);
  const apart = (a, b) => Math.max(...a.map((p, i) => Math.hypot(...p.map((x, k) => x - b[i][k]))));
  const moved = frames.map(f => apart(f.points, frames[0].points));
  for (const f of frames) delete f.points;
  out.textContent = JSON.stringify({vrm: vrm ? vrm.meta.metaVersion : null, duration: clip.duration, extent, moved, frames,
    names: faces.length ? Object.keys(faces[0].morphTargetDictionary) : [],
    textured: meshes.filter(m => [m.material].flat().some(x => x.map)).map(m => m.name)});
} catch (error) { out.textContent = JSON.stringify({error: String(error && error.stack || error)}); }
document.body.append(out);
</script>"""


def page(file: str, times: list[float], bone: str | None) -> str:
    """The page for a file on its server, looked at at ``times``; ``bone``: the node whose world rotation it tells."""
    import json

    return PAGE.replace("FILE", file).replace("TIMES", json.dumps(times)).replace("BONE", json.dumps(bone))
