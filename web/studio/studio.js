// The live page of `mimesh studio`: the side panel, the stage, and what goes between them and the server. The server
// knows the state; the page shows it whenever it changes, so that nothing is lost when it is loaded again.
import { Controls, Stage, make } from "./player.js";
import { acceptDrops, chosen } from "./files.js";
import { say, keep } from "./fields.js";
import { Live } from "./live.js";
import { ExportForm, ModelForm } from "./forms.js";
import { exportRow, meshRow } from "./rows.js";
import { call, upload, watch } from "./server.js";

const at = (id) => document.getElementById(id);
const sectionOf = { identity: at("identities"), driving: at("driving"), both: at("identities") };
const uploads = { identity: new Map(), driving: new Map() };
const wanted = new Set();
let state = null;
let lastUpload = 0;

/** Do something and say what goes wrong in a section. */
async function attempt(section, doing) {
  const error = section.querySelector(":scope > .error");
  say(error, "");
  try {
    return await doing();
  } catch (problem) {
    say(error, problem.message);
  }
}

const act = {
  change: (number, given) => attempt(sectionWith(number), () => call("POST", `/api/meshes/${number}`, given)),
  remove: (number) => number > 0 && attempt(sectionWith(number), () => call("DELETE", `/api/meshes/${number}`)),
  stop: (number) => attempt(sectionWith(number), () => call("POST", `/api/meshes/${number}/stop`)),
  removeExport: (number) => attempt(at("export"), () => call("DELETE", `/api/exports/${number}`)),
  takeOnce: (number) => wanted.delete(number),
};
const sectionWith = (number) => (state.driving?.number === number ? sectionOf.driving : sectionOf.identity);

/** Upload what was chosen or dropped, with a row that shows how far it is. */
async function take(role, files) {
  if (!files.length) return;
  const number = --lastUpload; // negative: no mesh of the server
  const name = files.length === 1 ? files[0].name.split("/").pop() : `${files.length} files`;
  const told = (uploading) => {
    uploads[role].set(number, { number, name, uploading, state: "uploading", outcome: null, error: "" });
    showRows();
  };
  told(0);
  await attempt(sectionOf[role], () => upload(role, files, state.limit, told));
  uploads[role].delete(number);
  showRows();
}

function showRows() {
  if (!state) return;
  const given = { identity: state.identities, driving: state.driving ? [state.driving] : [] };
  for (const role of ["identity", "driving"]) {
    const things = [...given[role], ...uploads[role].values()];
    keep(sectionOf[role].querySelector(".rows"), things, (row, mesh) => meshRow(row, mesh, act));
    sectionOf[role].querySelector(".hint").hidden = things.length > 0;
  }
  keep(at("export").querySelector(".rows"), state.exports, (row, made) => exportRow(row, made, act));
}

/** What the head of the page says is being done. */
function doing() {
  const meshes = [...state.identities, ...(state.driving ? [state.driving] : [])];
  if (meshes.some((mesh) => mesh.state === "reading")) return "reading";
  const moving = state.identities.filter((mesh) => mesh.outcome?.state === "moving");
  if (moving.length) return `moving ${moving.length === 1 ? moving[0].name : `${moving.length} meshes`}`;
  return state.exports.some((made) => made.state === "writing") ? "writing" : "";
}

function refuse() {
  at("stage").append(make("p", "refusal", {
    textContent: "The studio draws with WebGL 2, which this browser has not. Meshes can be moved and exported all the same.",
  }));
}

/** A menu of what is shipped; what is chosen is laid on the desk. Gives what fills it. */
function offerDemo(what, kind) {
  const menu = at(kind);
  menu.addEventListener("change", () => {
    const given = { what, [kind]: menu.value };
    menu.value = "";
    attempt(sectionOf[what], () => call("POST", "/api/demo", given));
  });
  const option = (name) => make("option", "", { value: name, textContent: name });
  return (now) => menu.append(...now[`${kind}s`].map(option));
}

function start() {
  const forms = [
    new ModelForm(at("model"), (given) => attempt(at("model"), () => call("POST", "/api/options", given))),
    new ExportForm(at("export"), async (given) => {
      const made = await attempt(at("export"), () => call("POST", "/api/exports", given));
      if (made) wanted.add(made.export);
      showRows();
    }),
  ];
  let live = null;
  if (document.createElement("canvas").getContext("webgl2")) {
    const stage = new Stage(at("stage"));
    const controls = new Controls(stage, { top: at("top"), bottom: at("bottom") });
    live = new Live(stage, controls, (words) => say(at("model").querySelector(":scope > .error"), words));
    window.mimesh = { stage, controls, live };
  } else refuse();

  acceptDrops(at("drop"), take);
  for (const input of document.querySelectorAll("input[type=file]")) {
    input.addEventListener("change", () => {
      const files = chosen(input);
      input.value = "";
      take(input.dataset.role, files);
    });
  }
  at("demo").addEventListener("click", () => attempt(sectionOf.both, () => call("POST", "/api/demo", { what: "both" })));
  const offers = [offerDemo("identity", "character"), offerDemo("driving", "motion")];

  const seen = (now) => {
    if (!state) for (const offer of offers) offer(now);
    state = now;
    say(at("doing"), doing());
    at("welcome").hidden = Boolean(now.driving) || now.identities.length > 0;
    showRows();
    for (const form of forms) form.show(now);
    live?.see(now);
    Object.assign(document.documentElement.dataset, { version: now.version, state: "ready" });
  };
  watch(seen, (words) => say(at("doing"), words));
}

start();
