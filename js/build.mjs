// Bundles src/heads.js and what it takes from three.js into adaptiveface/assets/heads.js: npm ci && npm run build
// The bundle is checked in, so that pip needs no node. tests/test_heads.py tells when it is older than its sources.

import { createHash } from "node:crypto";
import { copyFileSync, readFileSync, readdirSync } from "node:fs";
import { build } from "esbuild";

const assets = "../adaptiveface/assets/";
const three = JSON.parse(readFileSync("node_modules/three/package.json")).version;
const sources = ["package.json", ...readdirSync("src").sort().map((name) => `src/${name}`)];
const digest = createHash("sha256");
for (const name of sources) digest.update(readFileSync(name, "utf8").replaceAll("\r\n", "\n"));

await build({
  entryPoints: ["src/heads.js"],
  outfile: assets + "heads.js",
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  legalComments: "inline",
  banner: { js: `// three.js ${three}, MIT, see LICENSE-three.txt. Built by js/build.mjs from sources ${digest.digest("hex")}` },
});
copyFileSync("node_modules/three/LICENSE", assets + "LICENSE-three.txt");
