// Handles for the joints of the mesh to move and of the driving mesh: shown over their panels, dragged with the pointer
// or moved with the arrow keys. What is dragged counts as picked by hand; the server finds the others again.
import { make } from "./player.js";
import { showText } from "./fields.js";
import { call } from "./server.js";

const SVG = "http://www.w3.org/2000/svg";
/** Pixels that an arrow key moves a joint by, without and with shift. */
const STEP = 2;
const LARGE_STEP = 10;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const ROLES = { identity: "mesh to move", driving: "driving mesh" };
/** Milliseconds after the last arrow key until the joint is sent. */
const PAUSE = 400;

const draw = (tag, attributes) => {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
};

export class Joints {
  /** `attempt(number, action)` runs an action and shows its error beside the mesh. */
  constructor(stage, controls, live, attempt) {
    Object.assign(this, { stage, controls, live, attempt, on: false, found: null, key: "", selected: null, undone: [] });
    this.overlays = new Map(); // view -> its SVG
    this.button = controls.addButton(controls.tools, "joints", "Correct joints", () => this.toggle(), { key: "j", pressed: false });
    this.bar = this.buildBar(stage.element);
    this.correct = document.getElementById("correct"); // the same button, in the side panel
    this.correct.addEventListener("click", () => this.toggle());
    stage.addEventListener("drawn", () => this.place());
    stage.addEventListener("clear", () => (this.hadFocus = this.hasFocus())); // handles go with their panels
    stage.addEventListener("scene", () => this.rebuild());
  }

  buildBar(element) {
    const bar = element.appendChild(make("div", "joint-bar", { hidden: true }));
    bar.setAttribute("role", "group");
    bar.setAttribute("aria-label", "Joints");
    this.choice = bar.appendChild(make("select", ""));
    this.choice.setAttribute("aria-label", "Joint");
    this.choice.title = "Choose a joint, to move it with the arrow keys";
    this.choice.addEventListener("change", () => this.select(...this.choice.value.split(" "), true));
    const button = (text, act, title) => {
      const made = bar.appendChild(make("button", "plain", { type: "button", textContent: text, title }));
      made.addEventListener("click", act);
      return made;
    };
    this.undoButton = button("Undo", () => this.undo(), "Take the last correction back");
    this.resetButton = button("Reset", () => this.selected && this.reset(this.selected.role, this.selected.name), "Find the chosen joint again");
    this.resetAllButton = button("Reset all", () => this.resetAll(), "Find all joints again");
    this.saveLink = bar.appendChild(make("a", "plain", { textContent: "Save" }));
    this.hint = bar.appendChild(make("span", "joint-hint", { textContent: "Drag a joint, or choose one and use the arrow keys." }));
    this.hint.setAttribute("role", "status");
    return bar;
  }

  toggle() {
    this.on = !this.on;
    this.button.setAttribute("aria-pressed", this.on);
    this.correct.textContent = this.on ? "End correcting joints" : "Correct joints";
    this.bar.hidden = !this.on;
    if (this.on) this.controls.seek(0);
    this.key = "";
    this.update(this.live.state);
    this.rebuild();
  }

  /** Return the item of the state that a role shows, if there is exactly one; handles need both roles. */
  item(role) {
    const { identities = [], driving } = this.state ?? {};
    return role === "driving" ? driving : identities.length === 1 ? identities[0] : null;
  }

  /** Take a new state: fetch the joints if their inputs have changed. */
  async update(state) {
    this.state = state;
    if (!state) return;
    const joints = state.models.find(({ name }) => name === state.options.model)?.joints;
    const ready = joints && this.item("identity")?.state === "ready" && this.item("driving")?.state === "ready";
    const needs = "available with one mesh to move, a driving file, and a model with joints (mime)";
    const title = `Correct joints${ready ? " (j)" : `: ${needs}`}`;
    for (const button of [this.button, this.correct]) Object.assign(button, { disabled: !ready && !this.on, title });
    showText(document.getElementById("correct-hint"), ready ? "" : `Correcting joints is ${needs}.`);
    if (!ready && this.found) this.found = null;
    if (!this.on) return;
    this.showBar();
    if (!ready) return this.rebuild();
    const { number, joints: { key } } = this.item("identity");
    const wanted = `${number} ${key}`;
    if (wanted === this.key) return;
    this.key = wanted;
    this.hint.textContent = "Finding the joints …";
    await this.attempt(number, async () => {
      const found = await call("GET", `/api/meshes/${number}/joints`);
      if (!found || this.key !== wanted) return;
      this.found = found.meshes ? found : null; // without meshes: no model has found them
      this.rebuild();
      this.hint.textContent = found.meshes
        ? "Drag a joint, or choose one and use the arrow keys."
        : "These rigs are followed as they are: no joints to correct.";
    });
  }

  corrected(role) {
    return this.item(role)?.joints.corrected ?? {};
  }

  /** Positions of the joints of a role: found ones, those corrected since, and the one that is being dragged. */
  positions(role) {
    const item = this.item(role);
    const found = item && this.found?.meshes[item.number]?.joints;
    if (!found) return null;
    const dragged = this.dragged?.role === role ? { [this.dragged.name]: this.dragged.position } : {};
    return { ...found, ...this.corrected(role), ...dragged };
  }

  /** Make the handles of all panels anew; the one that has the focus keeps it, so that arrow keys go on working. */
  rebuild() {
    const focused = this.hadFocus || this.hasFocus();
    this.hadFocus = false;
    for (const overlay of this.overlays.values()) overlay.svg.remove();
    this.overlays.clear();
    for (const view of this.on ? this.stage.views : []) {
      const { role } = view.panel;
      if (!(role in ROLES) || !this.positions(role)) continue;
      this.overlays.set(view, this.buildOverlay(view, role));
    }
    if (focused && this.selected) return this.select(this.selected.role, this.selected.name, true);
    this.showBar();
    this.place();
  }

  hasFocus() {
    return [...this.overlays.values()].some(({ svg }) => svg.contains(document.activeElement));
  }

  buildOverlay(view, role) {
    const svg = draw("svg", { class: "joints" });
    const names = Object.keys(this.positions(role)).filter((name) => name in this.found.parents);
    const bones = names.filter((name) => this.found.parents[name]);
    const lines = new Map(bones.map((name) => [name, svg.appendChild(draw("line", { class: "bone" }))]));
    const circles = new Map(names.map((name) => [name, svg.appendChild(this.buildHandle(view, role, name))]));
    view.box.append(svg);
    return { svg, role, lines, circles };
  }

  buildHandle(view, role, name) {
    const circle = draw("circle", { class: "joint", r: 5.5, role: "button", tabindex: -1 });
    circle.append(draw("title", {}));
    circle.addEventListener("pointerdown", (event) => this.begin(event, view, role, name));
    circle.addEventListener("dblclick", (event) => {
      event.stopPropagation();
      this.reset(role, name);
    });
    circle.addEventListener("keydown", (event) => this.pressed(event, view, role, name));
    circle.addEventListener("focus", () => this.select(role, name));
    return circle;
  }

  /** Put handles and bones where the joints are. */
  place() {
    for (const [view, { svg, role, lines, circles }] of this.overlays) {
      const positions = this.positions(role);
      if (!positions) continue;
      const frame = this.found.meshes[this.item(role).number].frame;
      const away = Math.abs(this.stage.time - frame / this.state.driving.fps); // the stage may show fewer frames a second
      svg.toggleAttribute("hidden", view.panel.frames > 1 && away * view.panel.fps > 0.5);
      const names = [...circles.keys()];
      const at = new Map(this.stage.project(view, names.map((name) => positions[name])).map((xy, k) => [names[k], xy]));
      const corrected = this.corrected(role);
      for (const [name, circle] of circles) {
        const [x, y] = at.get(name);
        const picked = name in corrected || (this.dragged?.role === role && this.dragged.name === name);
        const selected = this.selected?.role === role && this.selected.name === name;
        circle.setAttribute("cx", x);
        circle.setAttribute("cy", y);
        circle.classList.toggle("corrected", picked);
        circle.classList.toggle("selected", selected);
        circle.setAttribute("tabindex", selected ? 0 : -1);
        const label = `${name} of the ${ROLES[role]}${picked ? ", corrected" : ""}`;
        if (circle.getAttribute("aria-label") !== label) circle.setAttribute("aria-label", label);
        circle.firstChild.textContent = `${name}${picked ? ", corrected: double click resets it" : ""}`;
      }
      for (const [name, line] of lines) {
        const [[x1, y1], [x2, y2]] = [at.get(this.found.parents[name]), at.get(name)];
        for (const [key, value] of Object.entries({ x1, y1, x2, y2 })) line.setAttribute(key, value);
      }
    }
  }

  select(role, name, focus = false) {
    this.selected = name ? { role, name } : null;
    this.showBar();
    this.place();
    if (!focus) return;
    for (const overlay of this.overlays.values()) if (overlay.role === role) overlay.circles.get(name)?.focus();
  }

  showBar() {
    const shown = Object.keys(ROLES).filter((role) => this.on && this.positions(role));
    const key = `${shown.map((role) => this.item(role).number)} ${Object.keys(this.found?.parents ?? {})}`;
    if (this.choice.dataset.key !== key) {
      this.choice.dataset.key = key;
      this.choice.replaceChildren(new Option("Joint …", ""), ...shown.map((role) => {
        const group = make("optgroup", "", { label: ROLES[role] });
        for (const name of Object.keys(this.found.parents)) group.append(new Option(name, `${role} ${name}`));
        return group;
      }));
    }
    this.choice.value = this.selected ? `${this.selected.role} ${this.selected.name}` : "";
    if (this.choice.selectedIndex < 0) this.choice.value = ""; // a joint of another body
    const role = this.selected?.role ?? (Object.keys(this.corrected("identity")).length ? "identity" : "driving");
    const any = this.on && Object.keys(ROLES).some((each) => Object.keys(this.corrected(each)).length);
    this.resetButton.disabled = !this.selected || !(this.selected.name in this.corrected(this.selected.role));
    this.resetAllButton.disabled = !any;
    this.undoButton.disabled = !this.undone.length;
    const saved = Object.keys(this.corrected(role)).length ? this.item(role) : null;
    if (saved) {
      this.saveLink.href = `/api/meshes/${saved.number}/joints.json`;
      this.saveLink.title = `Save the corrected joints of ${saved.name}; put the file beside it to use it again`;
    }
    this.saveLink.hidden = !saved;
  }

  /** Follow the pointer from a press on a handle to its release. */
  begin(event, view, role, name) {
    if (event.button) return;
    event.preventDefault();
    event.stopPropagation();
    const circle = event.currentTarget;
    circle.focus();
    const start = this.positions(role)[name];
    const from = [event.clientX, event.clientY];
    const move = ({ clientX, clientY }) => {
      const [right, down] = [clientX - from[0], clientY - from[1]];
      if (!this.dragged && Math.hypot(right, down) < 2) return; // a click, or half of a double click
      this.dragged = { role, name, position: this.stage.drag(view, start, right, down) };
      this.place();
    };
    const end = () => {
      circle.removeEventListener("pointermove", move);
      for (const type of ["pointerup", "pointercancel"]) circle.removeEventListener(type, end);
      this.drop();
    };
    circle.setPointerCapture(event.pointerId);
    circle.addEventListener("pointermove", move);
    for (const type of ["pointerup", "pointercancel"]) circle.addEventListener(type, end);
  }

  pressed(event, view, role, name) {
    if (event.key === "Delete" || event.key === "Backspace") this.reset(role, name);
    else if (event.key in ARROWS) {
      const step = event.shiftKey ? LARGE_STEP : STEP;
      const [right, down] = ARROWS[event.key].map((x) => x * step);
      this.dragged = { role, name, position: this.stage.drag(view, this.positions(role)[name], right, down) };
      this.place();
      clearTimeout(this.waiting);
      this.waiting = setTimeout(() => this.drop(), PAUSE);
    } else return;
    event.preventDefault();
    event.stopPropagation(); // arrow keys also step through the frames
  }

  /** Send the joint that was dragged. */
  drop() {
    if (!this.dragged) return;
    const { role, name, position } = this.dragged;
    this.send(role, { ...this.corrected(role), [name]: position });
  }

  reset(role, name) {
    const { [name]: dropped, ...others } = this.corrected(role);
    clearTimeout(this.waiting);
    this.dragged = null;
    if (dropped) this.send(role, others);
    this.place();
  }

  async resetAll() {
    for (const role of Object.keys(ROLES)) if (Object.keys(this.corrected(role)).length) await this.send(role, {});
  }

  undo() {
    const last = this.undone.pop();
    if (last && this.item(last.role)?.number === last.number) this.send(last.role, last.joints, false);
    this.showBar();
  }

  /** Replace the corrected joints of a role on the server. */
  async send(role, joints, undoable = true) {
    const item = this.item(role);
    if (!item) return;
    if (undoable) this.undone.push({ role, number: item.number, joints: { ...this.corrected(role) } });
    await this.attempt(item.number, () => call("POST", `/api/meshes/${item.number}/joints`, { joints }));
    item.joints.corrected = joints; // until the new state comes
    this.dragged = null;
    this.showBar();
    this.place();
  }
}
