// The two forms of the side panel: the model with its options, and what to export.
import { make } from "./player.js";
import { allow, checkbox, choice, field, fill, showValue } from "./fields.js";

const WORDS = {
  mime: "joints of both, then skinning: fast, and the best by far",
  "mime-network": "the same without fitting a body",
  npt: "Neural Pose Transfer, pairs points",
  "npt-maxpool": "its variant with one pose code",
  aniformer: "AniFormer, sees three frames at once",
  skeleton: "fits a body to both; slow",
  copy: "the driving's own vertices, to compare with",
};
const ROOTS = { scale: "as its legs take it", keep: "as far as the driving", drop: "nowhere, in place" };
const JOINTS_ONLY = "Only models with joints (mime) can do this.";

export class ModelForm {
  constructor(section, changed) {
    const grid = section.querySelector(".fields");
    const give = (name, read = (value) => value) => (value) => changed({ [name]: read(value) });
    this.model = field(grid, "Model", choice([], give("model")));
    this.words = grid.appendChild(make("small", ""));
    this.root = field(grid, "Travels", choice(Object.entries(ROOTS), give("root")));
    this.ground = field(grid, "Feet stand", checkbox(give("ground")));
    this.smooth = this.addSmooth(grid, give("smooth", Number));
    const refine = [["", "as the model needs"], ["true", "yes"], ["false", "no"]];
    this.refine = field(grid, "Smooth surface", choice(refine, give("refine", (value) => (value ? value === "true" : null))));
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
    return field(grid, "Calm motion", slider);
  }

  showSeconds(value) {
    this.seconds.textContent = Number(value) ? `${Number(value).toFixed(2)} s` : "off";
  }

  show({ models, options }) {
    fill(this.model, models.map(({ name }) => [name, name.split(/[\\/]/).pop()]));
    showValue(this.model, options.model);
    this.words.textContent = WORDS[options.model] ?? "";
    this.words.hidden = !this.words.textContent;
    const joints = models.find(({ name }) => name === options.model)?.joints;
    for (const control of [this.root, this.ground, this.smooth]) allow(control, joints, JOINTS_ONLY);
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
    this.skinned = field(grid, "As joints", checkbox(() => this.show(this.state)));
    this.shapes = field(grid, "Blend shapes", make("input", "", { type: "number", min: 1, max: 512, placeholder: "one a frame" }));
    this.button = section.querySelector("#write");
    this.button.addEventListener("click", () => write(this.given()));
  }

  given() {
    const shapes = this.shapes.disabled || !this.shapes.value ? null : Number(this.shapes.value);
    const meshes = this.which.value ? [Number(this.which.value)] : [];
    return { suffix: this.format.value, skinned: this.skinned.checked && !this.skinned.disabled, blendshapes: shapes, meshes };
  }

  show(state) {
    this.state = state;
    const { formats, identities, models, options, moving } = state;
    fill(this.format, formats.map(({ suffix, words, needs }) => [suffix, `${words} (${suffix})`, needs]));
    if (this.format.selectedIndex < 0) this.format.selectedIndex = 0;
    const chosen = formats.find(({ suffix }) => suffix === this.format.value);
    const lacking = formats.filter(({ needs }) => needs);
    this.needs.hidden = !lacking.length;
    this.needs.textContent = `Some need more: ${[...new Set(lacking.map(({ needs }) => needs))].join(", ")}`;
    const joints = models.find(({ name }) => name === options.model)?.joints;
    allow(this.skinned, joints && chosen?.joints, "GLB and glTF from models with joints (mime) alone.");
    allow(this.shapes, moving && chosen?.joints && !this.skinned.checked, "Clips as GLB and glTF alone, without joints.");
    fill(this.which, [["", identities.length > 1 ? `all ${identities.length}` : "all"], ...identities.map(({ number, name }) => [String(number), name])]);
    this.which.hidden = this.which.words.hidden = identities.length < 2;
    this.button.disabled = !identities.some((mesh) => mesh.outcome?.state === "done");
  }
}
