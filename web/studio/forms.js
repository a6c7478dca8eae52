// The forms of the side panel: the motion with its model, corrections, and what to export. Every field has a tooltip.
import { make } from "./player.js";
import { checkbox, choice, field, fill, setEnabled, setShown, showValue } from "./fields.js";

const DESCRIPTIONS = {
  mime: "predicts joints and skinning weights of both meshes; fast",
  "mime-network": "mime without fitting a body model",
  npt: "Neural Pose Transfer (2020), frame by frame",
  "npt-maxpool": "its variant with one pose code",
  aniformer: "AniFormer (2021), three frames at once",
  copy: "the driving mesh's own vertices, for comparison",
};
const ROOTS = { scale: "by leg length", keep: "as far as the driving", drop: "none, in place" };
const BODIES = { auto: "automatic", human: "a person", quadruped: "a four-legged animal", other: "other creatures or things" };
const RIGS = { own: "of the file", mimesh: "found on the surface" };
const RESTS = { file: "of the file", T: "T-pose", A: "A-pose" };
const PRODUCTS = { result: "Result", rig: "Rig: bones, at rest", motion: "Motion: joints alone" };
const VRM_LICENSE = "https://vrm.dev/licenses/1.0/";
const BODIES_ONLY = "Available for mime.";
const JOINTS_ONLY = "Available for models with joints (mime).";

/** Options of the motion; `changed` is called with the changed ones. */
export class ModelForm {
  constructor(section, changed) {
    const grid = section.querySelector(".fields");
    const send = (name, read = (value) => value) => (value) => changed({ [name]: read(value) });
    this.model = field(grid, "Model", choice([], send("model")), "The method that moves the mesh; mime is for most files");
    this.description = grid.appendChild(make("small", ""));
    this.root = field(grid, "Root motion", choice(Object.entries(ROOTS), send("root")), "How far the result goes over the ground");
    this.ground = field(grid, "Feet on the ground", checkbox(send("ground")), "Plant the soles where those of the driving mesh stand");
    this.contacts = field(grid, "Hands in contact", checkbox(send("contacts")), "Keep hands where those of the driving mesh touch its body, and arms out of the own");
    this.smooth = this.addSmooth(grid, send("smooth", Number));
    const refine = [["", "automatic"], ["true", "yes"], ["false", "no"]];
    const sendRefine = send("refine", (value) => (value ? value === "true" : null));
    this.refine = field(grid, "Refine surface", choice(refine, sendRefine), "Smooth the result along the surface of the mesh; automatic: for npt and aniformer");
  }

  addSmooth(grid, changed) {
    const row = make("span", "with");
    const slider = row.appendChild(make("input", "", { type: "range", min: 0, max: 0.3, step: 0.01, value: 0 }));
    this.seconds = row.appendChild(make("output", ""));
    slider.addEventListener("input", () => {
      this.showSeconds(slider.value);
      clearTimeout(this.waiting);
      this.waiting = setTimeout(() => changed(slider.value), 60);
    });
    return field(grid, "Smoothing", slider, "Average the motion of the joints over this many seconds");
  }

  showSeconds(value) {
    this.seconds.textContent = Number(value) ? `${Number(value).toFixed(2)} s` : "off";
  }

  show({ models, options }) {
    fill(this.model, models.map(({ name }) => [name, name.split(/[\\/]/).pop()]));
    showValue(this.model, options.model);
    this.description.textContent = DESCRIPTIONS[options.model] ?? "";
    this.description.hidden = !this.description.textContent;
    const joints = models.find(({ name }) => name === options.model)?.joints;
    for (const control of [this.root, this.ground, this.contacts, this.smooth]) setEnabled(control, joints, JOINTS_ONLY);
    showValue(this.root, options.root);
    showValue(this.ground, options.ground);
    showValue(this.contacts, options.contacts);
    showValue(this.smooth, options.smooth);
    if (this.smooth !== document.activeElement) this.showSeconds(options.smooth);
    showValue(this.refine, options.refine === null ? "" : String(options.refine));
  }
}

/** What the meshes and their bones are taken for; the joints themselves are corrected on the stage (joints.js). */
export class CorrectionForm {
  constructor(section, changed) {
    const grid = section.querySelector(".fields");
    const bodies = choice(Object.entries(BODIES), (body) => changed({ body }));
    this.body = field(grid, "Both meshes are", bodies, "What both meshes are taken for; automatic: found by rig or shape");
    const rigs = choice(Object.entries(RIGS), (rig) => changed({ rig }));
    this.rig = field(grid, "Bones", rigs, "Use the bones of the mesh's file if it has any, or joints found on its surface; a motion is exported likewise");
  }

  show({ models, options }) {
    const { joints, bodies } = models.find(({ name }) => name === options.model) ?? {};
    setEnabled(this.body, bodies, BODIES_ONLY);
    setEnabled(this.rig, joints, JOINTS_ONLY);
    showValue(this.body, options.body);
    showValue(this.rig, options.rig);
  }
}

/** What is exported, its format and options, and the button that starts it: `write` is called with the request. */
export class ExportForm {
  constructor(section, write) {
    const [grid, details] = section.querySelectorAll(".fields");
    const again = () => this.show(this.state);
    this.what = field(grid, "What", choice(Object.entries(PRODUCTS), () => {
      this.format.value = ""; // the first of the new formats
      again();
    }), "The moved mesh, the mesh at rest with bones and weights, or the joints of the driving motion");
    this.format = field(grid, "Format", choice([], again), "Format of the file; movies are drawn, all others hold the mesh or its bones");
    this.which = field(grid, "Meshes", choice([["", "all"]], again), "Which meshes to export; several become one .zip");
    this.author = field(grid, "Author", make("input", "", { type: "text", maxLength: 200 }), "Who made the character; VRM needs it");
    const license = make("input", "", { type: "url", maxLength: 500, placeholder: VRM_LICENSE });
    this.license = field(grid, "Licence", license, `Address of its licence, which VRM needs; that of VRM is ${VRM_LICENSE}`);
    this.skinned = field(details, "With bones", checkbox(() => {
      this.chosen = true;
      again();
    }), "Write a skeleton with weights, which engines play, instead of the vertices of every frame");
    this.names = field(details, "Bone names", choice([], again), "Names and hierarchy of the bones that another program expects");
    this.rest = field(details, "Rest pose", choice(Object.entries(RESTS), again), "Pose that the skeleton is bound in; bones of the file keep theirs");
    this.root = field(details, "Root bone", checkbox(again), "Add a bone on the ground above all others, which has the way over it");
    const weights = choice([["", "4, of all engines"], ["8", "8"]], again);
    this.influences = field(details, "Weights per vertex", weights, "Largest number of bones that move a vertex; bones of the file keep theirs");
    const fps = make("input", "", { type: "number", min: 1, max: 1000, step: "any" });
    this.fps = field(details, "Frames per second", fps, "Frame rate of the file, sampled from that of the driving motion");
    this.details = details.closest("details");
    this.button = section.querySelector("#write");
    this.button.addEventListener("click", () => write(this.values()));
  }

  values() {
    const given = (control, value) => (control.disabled || control.hidden ? undefined : value);
    const number = (control) => (control.value ? given(control, Number(control.value)) : undefined);
    return {
      what: this.what.value,
      suffix: this.format.value,
      meshes: this.which.value ? [Number(this.which.value)] : [],
      skinned: given(this.skinned, this.skinned.checked),
      names: given(this.names, this.names.value),
      rest: given(this.rest, this.rest.value),
      root_bone: given(this.root, this.root.checked),
      influences: number(this.influences),
      fps: number(this.fps),
      author: given(this.author, this.author.value),
      license: given(this.license, this.license.value),
    };
  }

  show(state) {
    this.state = state;
    const { identities, driving, bone_names: names, moving } = state;
    const what = this.what.value;
    const formats = state.formats[what];
    fill(this.format, formats.map(({ suffix, words, needs }) => [suffix, `${words} (${suffix})${needs && `, needs ${needs}`}`, needs]));
    if (this.format.selectedIndex < 0) this.format.selectedIndex = 0;
    fill(this.names, Object.entries(names).map(([name, program]) => [name, name === "own" ? "as they are" : program]));
    fill(this.which, [["", identities.length > 1 ? `all ${identities.length}` : "all"], ...identities.map(({ number, name }) => [String(number), name])]);
    const chosen = identities.filter(({ number }) => [number, 0].includes(Number(this.which.value)));
    const results = chosen.filter(({ outcome }) => outcome?.state === "done");
    const format = formats.find(({ suffix }) => suffix === this.format.value) ?? {};
    this.showFields(what, format, identities.length > 1);
    this.showBones(what, format, moving, results.every(({ outcome }) => outcome.joints));
    this.fps.placeholder = driving?.fps ? `${+driving.fps.toFixed(3)}` : "";
    this.showButton(what, state, chosen, results);
  }

  /** Show the fields that a product has. */
  showFields(what, format, several) {
    setShown(this.which, several && what !== "motion");
    for (const control of [this.skinned, this.fps]) setShown(control, what === "result");
    for (const control of [this.author, this.license]) setShown(control, what === "rig" && format.suffix === ".vrm");
    this.details.hidden = what === "motion";
  }

  /** Enable what a format has: bones by choice or always; `jointed`: the results have joints. */
  showBones(what, format, moving, jointed) {
    if (!this.chosen) this.skinned.checked = moving; // a single pose is a mesh in that pose, unless bones are wanted
    setEnabled(this.skinned, jointed && format.joints, "Only in .glb, .gltf and .fbx, of models with joints (mime).");
    const bones = what === "rig" || format.bones || (this.skinned.checked && !this.skinned.disabled);
    for (const control of [this.names, this.rest, this.root]) setEnabled(control, bones && format.joints, "Only with bones, in .glb, .gltf and .fbx.");
    setEnabled(this.influences, bones && format.joints && format.suffix !== ".vrm", "Only with bones, in .glb, .gltf and .fbx.");
    setEnabled(this.fps, bones && moving, "Only with bones, for clips.");
  }

  /** Enable the button when there is something to write. */
  showButton(what, { models, options, driving }, chosen, results) {
    const joints = models.find(({ name }) => name === options.model)?.joints;
    const ready = (entry) => entry?.state === "ready";
    const [able, when] = {
      result: [results.length, "when a mesh has been moved"],
      rig: [joints && chosen.length && chosen.every(ready), "when there is a mesh to move, for models with joints (mime)"],
      motion: [joints && ready(driving), "when there is a driving motion, for models with joints (mime)"],
    }[what];
    this.button.disabled = !able;
    this.button.title = able ? "Write the files and download them" : `Available ${when}`;
  }
}
