// Bundles src/heads.js and what it takes from three.js into adaptiveface/assets/heads.js, and src/saved.js, which takes nothing
// from it, into saved_heads.js: npm ci && npm run build
// The bundles are checked in, so that pip needs no node. tests/test_heads.py tells when they are older than their sources.

import { createHash } from "node:crypto";
import { copyFileSync, readFileSync, readdirSync } from "node:fs";
import { build } from "esbuild";

const assets = "../adaptiveface/assets/";
const three = JSON.parse(readFileSync("node_modules/three/package.json")).version;
const sources = ["package.json", ...readdirSync("src").sort().map((name) => `src/${name}`)];
const digest = createHash("sha256");
for (const name of sources) digest.update(readFileSync(name, "utf8").replaceAll("\r\n", "\n"));

const built = `Built by js/build.mjs from sources ${digest.digest("hex")}`;
const common = { bundle: true, minify: true, target: "es2022", legalComments: "inline" };
await build({
  ...common,
  entryPoints: ["src/heads.js"],
  outfile: assets + "heads.js",
  format: "esm",
  banner: { js: `// three.js ${three}, MIT, see LICENSE-three.txt. ${built}` },
});
await build({
  ...common,
  entryPoints: ["src/saved.js"],
  outfile: assets + "saved_heads.js",
  format: "iife",
  banner: { js: `// ${built}` },
});
copyFileSync("node_modules/three/LICENSE", assets + "LICENSE-three.txt");
