// The two forms of the side panel: the model with its options, and what to export.
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
const ROOTS = { scale: "scaled by leg length", keep: "as far as the driving", drop: "none, in place" };
const BODIES = { auto: "automatic", human: "a person", quadruped: "a four-legged animal", other: "other creatures or things" };
const BODIES_ONLY = "Available for mime.";
const JOINTS_ONLY = "Available for models with joints (mime).";

export class ModelForm {
  constructor(section, changed) {
    const grid = section.querySelector(".fields");
    const send = (name, read = (value) => value) => (value) => changed({ [name]: read(value) });
    this.model = field(grid, "Model", choice([], send("model")));
    this.description = grid.appendChild(make("small", ""));
    this.body = field(grid, "Both meshes are", choice(Object.entries(BODIES), send("body")));
    this.root = field(grid, "Root motion", choice(Object.entries(ROOTS), send("root")));
    this.ground = field(grid, "Feet on the ground", checkbox(send("ground")));
    this.smooth = this.addSmooth(grid, send("smooth", Number));
    const refine = [["", "automatic"], ["true", "yes"], ["false", "no"]];
    this.refine = field(grid, "Refine surface", choice(refine, send("refine", (value) => (value ? value === "true" : null))));
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
    return field(grid, "Smoothing", slider);
  }

  showSeconds(value) {
    this.seconds.textContent = Number(value) ? `${Number(value).toFixed(2)} s` : "off";
  }

  show({ models, options }) {
    fill(this.model, models.map(({ name }) => [name, name.split(/[\\/]/).pop()]));
    showValue(this.model, options.model);
    this.description.textContent = DESCRIPTIONS[options.model] ?? "";
    this.description.hidden = !this.description.textContent;
    const { joints, bodies } = models.find(({ name }) => name === options.model) ?? {};
    setEnabled(this.body, bodies, BODIES_ONLY);
    showValue(this.body, options.body);
    for (const control of [this.root, this.ground, this.smooth]) setEnabled(control, joints, JOINTS_ONLY);
    showValue(this.root, options.root);
    showValue(this.ground, options.ground);
    showValue(this.smooth, options.smooth);
    if (this.smooth !== document.activeElement) this.showSeconds(options.smooth);
    showValue(this.refine, options.refine === null ? "" : String(options.refine));
  }
}

export class ExportForm {
  constructor(section, write) {
    const grid = section.querySelector(".fields");
    this.format = field(grid, "Format", choice([], () => this.show(this.state)));
    this.needs = grid.appendChild(make("small", "", { hidden: true }));
    this.which = field(grid, "Meshes", choice([["", "all"]], () => {}));
    this.skinned = field(grid, "With skeleton", checkbox(() => this.show(this.state)));
    this.shapes = field(grid, "Blend shapes", make("input", "", { type: "number", min: 1, max: 512, placeholder: "one per frame" }));
    this.button = section.querySelector("#write");
    this.button.addEventListener("click", () => write(this.values()));
  }

  values() {
    const shapes = this.shapes.disabled || !this.shapes.value ? null : Number(this.shapes.value);
    const meshes = this.which.value ? [Number(this.which.value)] : [];
    return { suffix: this.format.value, skinned: this.skinned.checked && !this.skinned.disabled, blendshapes: shapes, meshes };
  }

  show(state) {
    this.state = state;
    const { formats, identities, models, options, moving } = state;
    fill(this.format, formats.map(({ suffix, words: name, needs }) => [suffix, `${name} (${suffix})`, needs]));
    if (this.format.selectedIndex < 0) this.format.selectedIndex = 0;
    const chosen = formats.find(({ suffix }) => suffix === this.format.value);
    const lacking = formats.filter(({ needs }) => needs);
    this.needs.hidden = !lacking.length;
    this.needs.textContent = `Some formats need: ${[...new Set(lacking.map(({ needs }) => needs))].join(", ")}`;
    const joints = models.find(({ name }) => name === options.model)?.joints;
    setEnabled(this.skinned, joints && chosen?.joints, "Only as GLB or glTF, from models with joints (mime).");
    setEnabled(this.shapes, moving && chosen?.joints && !this.skinned.checked, "Only clips as GLB or glTF, without a skeleton.");
    fill(this.which, [["", identities.length > 1 ? `all ${identities.length}` : "all"], ...identities.map(({ number, name }) => [String(number), name])]);
    this.which.hidden = this.which.caption.hidden = identities.length < 2;
    this.button.disabled = !identities.some((mesh) => mesh.outcome?.state === "done");
  }
}
