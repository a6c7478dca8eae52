// The forms of the side panel: the motion with its model, corrections, and what to export. Every field has a tooltip.
import { make } from "./player.js";
import { checkbox, choice, field, fill, setEnabled, showValue } from "./fields.js";

const DESCRIPTIONS = {
  mime: "predicts joints and skinning weights of both meshes; fast",
  "mime-network": "mime without fitting a body model",
  npt: "Neural Pose Transfer (2020), frame by frame",
  "npt-maxpool": "its variant with one pose code",
  aniformer: "AniFormer (2021), three frames at once",
  skeleton: "fits a body model to both meshes; slow",
  copy: "the driving mesh's own vertices, for comparison",
};
const ROOTS = { scale: "by leg length", keep: "as far as the driving", drop: "none, in place" };
const BODIES = { auto: "automatic", human: "a person", quadruped: "a four-legged animal", other: "other creatures or things" };
const RIGS = { own: "of the file", mimesh: "found on the surface" };
const RESTS = { file: "of the file", T: "T-pose", A: "A-pose" };
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
    for (const control of [this.root, this.ground, this.smooth]) setEnabled(control, joints, JOINTS_ONLY);
    showValue(this.root, options.root);
    showValue(this.ground, options.ground);
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
    this.rig = field(grid, "Bones", rigs, "Move the mesh on the bones of its file if it has any, or on joints found on its surface");
  }

  show({ models, options }) {
    const { joints, bodies } = models.find(({ name }) => name === options.model) ?? {};
    setEnabled(this.body, bodies, BODIES_ONLY);
    setEnabled(this.rig, joints, JOINTS_ONLY);
    showValue(this.body, options.body);
    showValue(this.rig, options.rig);
  }
}

/** The format with its options, and the button that starts an export: `write` is called with the request. */
export class ExportForm {
  constructor(section, write) {
    const [grid, details] = section.querySelectorAll(".fields");
    const again = () => this.show(this.state);
    this.format = field(grid, "Format", choice([], again), "Format of the file; movies are drawn, all others hold the mesh or its bones");
    this.which = field(grid, "Meshes", choice([["", "all"]], again), "Which results to export; several become one .zip");
    this.skinned = field(details, "With bones", checkbox(() => {
      this.chosen = true;
      again();
    }), "Write a skeleton with weights, which engines play, instead of the vertices of every frame");
    const shapes = make("input", "", { type: "number", min: 1, max: 512, placeholder: "one per frame" });
    this.shapes = field(details, "Blend shapes", shapes, "Number of morph targets that approximate the frames");
    this.names = field(details, "Bone names", choice([], again), "Names and hierarchy of the bones that another program expects");
    this.rest = field(details, "Rest pose", choice(Object.entries(RESTS), again), "Pose that the skeleton is bound in; bones of the file keep theirs");
    this.root = field(details, "Root bone", checkbox(again), "Put the way over the ground on a bone above all others");
    const fps = make("input", "", { type: "number", min: 1, max: 1000, step: "any" });
    this.fps = field(details, "Frames per second", fps, "Frame rate of the file, sampled from that of the driving motion");
    this.button = section.querySelector("#write");
    this.button.addEventListener("click", () => write(this.values()));
  }

  values() {
    const given = (control, value) => (control.disabled ? undefined : value);
    const number = (control) => (control.value && !control.disabled ? Number(control.value) : null);
    return {
      suffix: this.format.value,
      meshes: this.which.value ? [Number(this.which.value)] : [],
      skinned: this.skinned.checked && !this.skinned.disabled,
      blendshapes: number(this.shapes),
      names: given(this.names, this.names.value),
      rest: given(this.rest, this.rest.value),
      root_bone: given(this.root, this.root.checked),
      fps: number(this.fps),
    };
  }

  show(state) {
    this.state = state;
    const { formats, identities, driving, bone_names: names, moving } = state;
    fill(this.format, formats.map(({ suffix, words, needs }) => [suffix, `${words} (${suffix})${needs && `, needs ${needs}`}`, needs]));
    if (this.format.selectedIndex < 0) this.format.selectedIndex = 0;
    fill(this.names, Object.entries(names).map(([name, program]) => [name, name === "own" ? "as they are" : program]));
    fill(this.which, [["", identities.length > 1 ? `all ${identities.length}` : "all"], ...identities.map(({ number, name }) => [String(number), name])]);
    this.which.hidden = this.which.caption.hidden = identities.length < 2;
    const results = identities.filter(({ number, outcome }) => outcome?.state === "done" && [number, 0].includes(Number(this.which.value)));
    this.showBones(formats.find(({ suffix }) => suffix === this.format.value) ?? {}, moving, results.every(({ outcome }) => outcome.joints));
    this.fps.placeholder = driving?.fps ? `${+driving.fps.toFixed(3)}` : "";
    this.button.disabled = !results.length;
    this.button.title = results.length ? "Write the files and download them" : "Available when a mesh has been moved";
  }

  /** Enable what a format has: bones by choice or always, blend shapes; `jointed`: the results have joints. */
  showBones(format, moving, jointed) {
    if (!this.chosen) this.skinned.checked = moving; // a single pose is a mesh in that pose, unless bones are wanted
    setEnabled(this.skinned, jointed && format.joints, "Only in .glb, .gltf and .fbx, of models with joints (mime).");
    const bones = format.bones || (this.skinned.checked && !this.skinned.disabled);
    setEnabled(this.shapes, moving && format.shapes && !bones, "Only for clips as .glb or .gltf, without bones.");
    for (const control of [this.names, this.rest, this.root]) setEnabled(control, bones && format.joints, "Only with bones, in .glb, .gltf and .fbx.");
    setEnabled(this.fps, bones && moving, "Only with bones, for clips.");
  }
}
