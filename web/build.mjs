// Bundles each page of this folder into src/mimesh/view/web, with the licence notices of its dependencies.
//   npm ci && node build.mjs
// The first line of each bundle has a fingerprint of all sources here and of the lock file. A test compares it, so that
// the bundles cannot differ from their sources.
import { createHash } from "node:crypto";
import { copyFileSync, readdirSync, readFileSync } from "node:fs";
import { join, relative, sep } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = fileURLToPath(new URL(".", import.meta.url));
const output = join(here, "../src/mimesh/view/web");

/** List all sources below a folder, as paths with forward slashes, sorted. */
function sources(folder) {
  return readdirSync(folder, { recursive: true, withFileTypes: true })
    .filter((entry) => entry.isFile())
    .map((entry) => relative(folder, join(entry.parentPath, entry.name)).split(sep).join("/"))
    .filter((path) => !path.startsWith("node_modules/") && /\.(js|mjs|css|html|json)$/.test(path))
    .sort();
}

/** Compute SHA-256 over the name, the length in bytes and the content of every source. */
function fingerprint() {
  const hash = createHash("sha256");
  for (const path of sources(here)) {
    const content = readFileSync(join(here, path));
    hash.update(`${path}\n${content.length}\n`).update(content);
  }
  return hash.digest("hex").slice(0, 32);
}

const notice = readFileSync(join(here, "node_modules/three/LICENSE"), "utf8").trim();
const mark = `/* mimesh-web ${fingerprint()} */`;
const options = {
  absWorkingDir: here,
  outdir: output,
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  charset: "utf8",
  legalComments: "inline",
  banner: { js: mark, css: mark },
  logLevel: "info",
};
// The player, with three.js, is one script; offline pages embed it and the studio's page loads it: see studio/player.js.
await build({
  ...options,
  entryPoints: [
    { in: "player/page.js", out: "player" },
    { in: "style.css", out: "player" },
  ],
  globalName: "mimeshPlayer",
  footer: { js: `/*! This file contains three.js:\n${notice}\n*/` },
});
await build({
  ...options,
  entryPoints: [
    { in: "studio/studio.js", out: "studio" },
    { in: "studio/studio.css", out: "studio" },
  ],
});
copyFileSync(join(here, "studio/studio.html"), join(output, "studio.html"));
