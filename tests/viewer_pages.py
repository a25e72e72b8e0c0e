"""Pages that show a .glb as model-viewer and Babylon.js do it by themselves: no camera, no light, no setting of ours."""

from __future__ import annotations

SIZE = 420  # pixels


MODEL_VIEWER = f"""<!doctype html><title>model-viewer</title>
<script type="module" src="/node_modules/@google/model-viewer/dist/model-viewer.min.js"></script>
<model-viewer src="/x.glb" PLAYING style="width:{SIZE}px;height:{SIZE}px;background:#fff"></model-viewer>
<script type="module">
const viewer = document.querySelector('model-viewer');
const answer = value => {{
  const out = document.createElement('pre'); out.id = 'out'; out.textContent = JSON.stringify(value); document.body.append(out);
}};
customElements.get('model-viewer').minimumRenderScale = 1;  // a slow machine draws all pixels too
viewer.addEventListener('error', event => answer({{error: String(event.detail && event.detail.sourceError)}}));
viewer.addEventListener('load', async () => {{
  for (let i = 0; i < 10; i++) await new Promise(requestAnimationFrame);
  answer({{picture: viewer.toDataURL('image/png'), animations: viewer.availableAnimations}});
}});
</script>"""

BABYLON = f"""<!doctype html><title>Babylon.js</title>
<script src="/node_modules/babylonjs/babylon.js"></script>
<script src="/node_modules/babylonjs-loaders/babylonjs.loaders.js"></script>
<canvas id="canvas" width="{SIZE}" height="{SIZE}" style="width:{SIZE}px;height:{SIZE}px"></canvas>
<script type="module">
const out = document.createElement('pre'); out.id = 'out';
try {{
  const canvas = document.getElementById('canvas');
  const engine = new BABYLON.Engine(canvas, true, {{preserveDrawingBuffer: true}});
  const scene = await BABYLON.SceneLoader.LoadAsync('/', 'x.glb', engine);
  scene.clearColor = new BABYLON.Color4(1, 1, 1, 1);
  scene.createDefaultCameraOrLight(true, true, true);
  scene.activeCamera.alpha += Math.PI;  // as Babylon's Sandbox and Viewer do for glTF, whose fronts look along +z
  await scene.whenReadyAsync();
  for (let i = 0; i < 3; i++) {{ scene.render(); await new Promise(requestAnimationFrame); }}
  scene.render();
  const animations = scene.animationGroups.map(group => group.name);
  out.textContent = JSON.stringify({{picture: canvas.toDataURL('image/png'), animations}});
}} catch (error) {{ out.textContent = JSON.stringify({{error: String(error && error.stack || error)}}); }}
document.body.append(out);
</script>"""


def page(viewer: str, playing: bool = False) -> str:
    """The page of "model-viewer" or "babylon" for x.glb on its server; Babylon.js always plays."""
    return BABYLON if viewer == "babylon" else MODEL_VIEWER.replace("PLAYING", "autoplay" if playing else "")
