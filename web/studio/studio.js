// The page of `mimesh studio`: connects the side panel and the stage to the server. The state is on the server; the page
// shows it whenever it changes, so that reloading the page loses nothing.
import { Controls, Stage, make } from "./player.js";
import { acceptDrops, chosenFiles } from "./files.js";
import { showError, showText, updateList } from "./fields.js";
import { Live } from "./live.js";
import { Joints } from "./joints.js";
import { CorrectionForm, ExportForm, ModelForm } from "./forms.js";
import { Notice } from "./notice.js";
import { exportRow, meshRow } from "./rows.js";
import { call, upload, watchState } from "./server.js";

const element = (id) => document.getElementById(id);
const sectionOf = { identity: element("identities"), driving: element("driving"), both: element("identities") };
const uploads = { identity: new Map(), driving: new Map() };
const toDownload = new Set(); // numbers of exports that were started here
const notice = new Notice(element("notice"));
let connectionError = "";
let stageError = "";
let state = null;
let lastUpload = 0;

/** Run an action; a section and the notice above the stage show its error. */
async function attempt(section, action) {
  fail(section, "");
  try {
    return await action();
  } catch (problem) {
    fail(section, problem.message);
  }
}

/** Show the error of an action in a section, or none. */
function fail(section, message) {
  showError(section.querySelector(":scope > .error"), message);
  showProblems();
}

/** Show in the notice what is wrong: with the connection, actions, meshes, their results, and exports. */
function showProblems() {
  const sections = [...document.querySelectorAll(".step > .error")].map((error) => error.textContent);
  const { identities = [], driving, exports = [] } = state ?? {};
  const items = [...identities, ...(driving ? [driving] : []), ...exports];
  const texts = [...sections, ...items.flatMap(({ error, outcome }) => [error, outcome?.error]), connectionError, stageError];
  notice.update([...new Set(texts.filter(Boolean))]);
}

const act = {
  change: (number, changes) => attempt(sectionWith(number), () => call("POST", `/api/meshes/${number}`, changes)),
  remove: (number) => number > 0 && attempt(sectionWith(number), () => call("DELETE", `/api/meshes/${number}`)),
  stop: (number) => attempt(sectionWith(number), () => call("POST", `/api/meshes/${number}/stop`)),
  removeExport: (number) => attempt(element("export"), () => call("DELETE", `/api/exports/${number}`)),
  takeDownload: (number) => toDownload.delete(number),
};
const sectionWith = (number) => (state.driving?.number === number ? sectionOf.driving : sectionOf.identity);

/** Upload chosen or dropped files, with a row that shows the progress. */
async function uploadFiles(role, files) {
  if (!files.length) return;
  const number = --lastUpload; // negative: not a number of the server
  const name = files.length === 1 ? files[0].name.split("/").pop() : `${files.length} files`;
  const report = (uploading) => {
    uploads[role].set(number, { number, name, uploading, state: "uploading", outcome: null, error: "" });
    showRows();
  };
  report(0);
  await attempt(sectionOf[role], () => upload(role, files, state.limit, report));
  uploads[role].delete(number);
  showRows();
}

function showRows() {
  if (!state) return;
  const items = { identity: state.identities, driving: state.driving ? [state.driving] : [] };
  for (const role of ["identity", "driving"]) {
    const entries = [...items[role], ...uploads[role].values()];
    updateList(sectionOf[role].querySelector(".rows"), entries, (row, mesh) => meshRow(row, mesh, act));
    sectionOf[role].querySelector(".hint").hidden = entries.length > 0;
  }
  updateList(element("export").querySelector(".rows"), state.exports, (row, entry) => exportRow(row, entry, act));
}

/** Describe the current work for the head of the page. */
function currentWork() {
  const meshes = [...state.identities, ...(state.driving ? [state.driving] : [])];
  if (meshes.some((mesh) => mesh.state === "reading")) return "reading";
  const moving = state.identities.filter((mesh) => mesh.outcome?.state === "moving");
  if (moving.length) return `moving ${moving.length === 1 ? moving[0].name : `${moving.length} meshes`}`;
  return state.exports.some((entry) => entry.state === "writing") ? "writing" : "";
}

function showWithoutStage() {
  element("stage").append(make("p", "refusal", {
    textContent: "The stage needs WebGL 2, which this browser does not have. Meshes can still be moved and exported.",
  }));
}

/** Set up a menu of what is shipped, of people and of animals; returns the function that fills it from the state. */
function setUpDemoMenu(what, kind, animals) {
  const menu = element(kind);
  menu.addEventListener("change", () => {
    const body = { what, [kind]: menu.value };
    menu.value = "";
    attempt(sectionOf[what], () => call("POST", "/api/demo", body));
  });
  const option = (name) => make("option", "", { value: name, textContent: name });
  const group = (label, names) => {
    const made = make("optgroup", "", { label });
    made.append(...names.map(option));
    return made;
  };
  return (now) => menu.append(group("People", now[`${kind}s`]), group("Four-legged animals", now[animals]));
}

function start() {
  const setOptions = (section) => (changes) => attempt(section, () => call("POST", "/api/options", changes));
  const forms = [
    new ModelForm(element("model"), setOptions(element("model"))),
    new CorrectionForm(element("corrections"), setOptions(element("corrections"))),
    new ExportForm(element("export"), async (options) => {
      const started = await attempt(element("export"), () => call("POST", "/api/exports", options));
      if (started) toDownload.add(started.export);
      showRows();
    }),
  ];
  let live = null;
  let joints = null;
  if (document.createElement("canvas").getContext("webgl2")) {
    const stage = new Stage(element("stage"));
    const controls = new Controls(stage, { top: element("top"), bottom: element("bottom") });
    const failed = (message) => {
      stageError = message; // "" when it works again
      showProblems();
    };
    live = new Live(stage, controls, failed, () => showWork());
    joints = new Joints(stage, controls, live, (number, action) => attempt(sectionWith(number), action));
    window.mimesh = { stage, controls, live, joints };
  } else {
    showWithoutStage();
    showText(element("correct-hint"), "Correcting joints needs WebGL 2, which this browser does not have.");
  }

  acceptDrops(element("drop"), uploadFiles);
  for (const input of document.querySelectorAll("input[type=file]")) {
    input.addEventListener("change", () => {
      const files = chosenFiles(input);
      input.value = "";
      uploadFiles(input.dataset.role, files);
    });
  }
  const demos = { demo: {}, "animal-demo": { character: "cow", motion: "horse gallop" } };
  for (const [button, names] of Object.entries(demos)) {
    const load = () => call("POST", "/api/demo", { what: "both", ...names });
    element(button).addEventListener("click", () => attempt(sectionOf.both, load));
  }
  const fillMenus = [
    setUpDemoMenu("identity", "character", "animals"),
    setUpDemoMenu("driving", "motion", "animal_motions"),
  ];

  const showWork = () => {
    showText(element("doing"), currentWork() || (live?.loading ? "loading the scene" : ""));
    element("loading").hidden = !live?.loading || live.stage.views.length > 0;
  };
  const update = (now) => {
    if (!state) for (const fillMenu of fillMenus) fillMenu(now);
    state = now;
    connectionError = "";
    showWork();
    showProblems();
    element("welcome").hidden = Boolean(now.driving) || now.identities.length > 0;
    showRows();
    for (const form of forms) form.show(now);
    live?.update(now);
    joints?.update(now);
    Object.assign(document.documentElement.dataset, { version: now.version, state: "ready" });
  };
  watchState(update, (message) => {
    connectionError = message;
    showText(element("doing"), "no connection");
    showProblems();
  });
}

start();
