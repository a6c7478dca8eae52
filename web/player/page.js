// The offline page: reads its embedded scene, starts the stage, and offers the result's file. In a page without a scene,
// such as the studio's, nothing is started: that page uses the exports through `mimeshPlayer`.
import { Controls } from "./controls.js";
import { make } from "./dom.js";
import { ICONS } from "./icons.js";
import { fromBase64, inflate } from "./scene.js";
import { Stage } from "./stage.js";

const REFUSALS = {
  webgl: "This page needs WebGL 2, which this browser does not have or has switched off. Open it in a current Chrome, Edge, Firefox or Safari, on a computer with a graphics driver.",
  inflate: "This page needs a browser from 2023 or later (it lacks DecompressionStream). Open it in a current Chrome, Edge, Firefox or Safari.",
};

/** Build the page: a head, the stage, and two rows of buttons. */
function buildPage(root, packed) {
  const head = root.appendChild(make("header", "head"));
  const names = head.appendChild(make("div", "names"));
  names.append(make("h1", "", { textContent: packed.title }));
  if (packed.model) names.append(make("span", "chip", { textContent: packed.model, title: "Model that moved the mesh" }));
  const top = head.appendChild(make("div", "top"));
  const stage = root.appendChild(make("main", "stage"));
  const bottom = root.appendChild(make("footer", "bottom"));
  return { top, stage, bottom };
}

/** Show the notes of the report, and what was left out of the page. */
function addNotes(bottom, { notes, left_out: leftOut }) {
  const lines = [...notes, ...leftOut];
  if (!lines.length) return;
  const box = bottom.appendChild(make("details", "notes", { open: lines.length < 3 }));
  box.append(make("summary", "", { textContent: lines.length === 1 ? "1 note" : `${lines.length} notes` }));
  const list = box.appendChild(make("ul", ""));
  for (const line of lines) list.append(make("li", "", { textContent: line }));
}

/** Add a button that downloads the file embedded in the page, or a link to the file beside it. */
function addDownload(top, { download }) {
  if (!download) return;
  const label = `${ICONS.download}<span></span>`;
  const link = make("a", "plain download", { innerHTML: label, href: download.href ?? "#", download: download.name });
  link.lastChild.textContent = download.data ? `Download ${download.name}` : `${download.name} (beside this page)`;
  link.title = `Download ${download.name}, the result of this page`;
  if (download.data) link.addEventListener("click", (event) => downloadEmbedded(event, link, download));
  top.prepend(link);
}

/** Decode the embedded file on the first click, then click again on a link to it. */
async function downloadEmbedded(event, link, download) {
  if (link.dataset.ready) return;
  event.preventDefault();
  const bytes = await inflate(fromBase64(download.data));
  link.href = URL.createObjectURL(new Blob([bytes], { type: "model/gltf-binary" }));
  link.dataset.ready = "yes";
  link.click();
}

/** Show a message in place of the page. */
function refuse(root, message) {
  const main = make("main", "refusal");
  main.append(make("h1", "", { textContent: document.title }), make("p", "", { textContent: message }));
  root.replaceChildren(main);
  document.documentElement.dataset.state = "refused";
}

async function start() {
  const root = document.getElementById("mimesh");
  if (typeof DecompressionStream === "undefined") return refuse(root, REFUSALS.inflate);
  if (!document.createElement("canvas").getContext("webgl2")) return refuse(root, REFUSALS.webgl);
  const packed = JSON.parse(document.getElementById("mimesh-scene").textContent);
  const { top, stage: box, bottom } = buildPage(root, packed);
  addDownload(top, packed);
  const stage = new Stage(box);
  const controls = new Controls(stage, { top, bottom });
  addNotes(bottom, packed);
  await stage.show(packed);
  window.mimesh = { stage, controls };
  // Not before: a change of size draws the stage while it is still empty.
  stage.addEventListener("drawn", () => (document.documentElement.dataset.state = "ready"), { once: true });
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) controls.play();
}

if (document.getElementById("mimesh-scene")) {
  start().catch((error) => {
    refuse(document.getElementById("mimesh"), `This page could not be shown: ${error.message}`);
    throw error;
  });
}

export { Controls, Stage, make };
