// The widget.

import { Painter } from "./painter.js";
import { show } from "./view.js";
import { WebGL, inSoftware } from "./webgl.js";

const painterFor = (canvas, renderer) =>
  renderer === "canvas" || (renderer !== "webgl" && inSoftware()) ? new Painter(canvas) : new WebGL(canvas);

export default { render: (view) => show(view, painterFor) };
