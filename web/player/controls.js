// The play bar, the buttons, the keyboard and the help panel of a stage.
//
//   const controls = new Controls(stage, {top, bottom})   two elements to which the buttons are added
//   controls.play(), controls.pause(), controls.playing, controls.speed, controls.loop
//   controls.addButton(parent, name, label, act, {pressed, key})   for further buttons of a page
import { make } from "./dom.js";
import { ICONS } from "./icons.js";
import { Legend } from "./legend.js";

export const SPEEDS = [0.1, 0.25, 0.5, 1, 1.5, 2];
/** Name, label and tooltip of the ways to colour the surfaces. */
const COLOURS = [
  ["material", "Material", "Colours and textures of the file"],
  ["clay", "Clay", "One colour, to judge the shape"],
  ["stretch", "Stretch", "Edges that became longer (red) or shorter (blue) than the identity's"],
  ["error", "Error", "Distance of each vertex to the truth"],
];

export class Controls {
  constructor(stage, { top, bottom }) {
    this.stage = stage;
    this.playing = false;
    this.speed = 1;
    this.loop = true;
    this.keys = [];
    this.buildBar(bottom);
    this.buildTools(bottom);
    this.buildTop(top);
    this.legend = new Legend(stage);
    this.help = this.buildHelp();
    stage.addEventListener("time", () => this.showTime());
    stage.addEventListener("look", () => this.showLook());
    stage.addEventListener("scene", () => this.showScene());
    this.listen = (event) => this.pressed(event);
    document.addEventListener("keydown", this.listen);
    this.followSystemTheme();
  }

  buildBar(bottom) {
    const bar = bottom.appendChild(make("div", "bar"));
    this.bar = bar;
    this.playButton = this.addButton(bar, "play", "Play", () => this.toggle(), { key: " ", keyName: "space" });
    this.scrub = bar.appendChild(make("input", "scrub", { type: "range", min: 0, max: 1000, step: 1, value: 0 }));
    this.scrub.setAttribute("aria-label", "Time");
    this.scrub.title = "Time (← and → step through the frames)";
    this.scrub.addEventListener("input", () => this.seek((this.scrub.value / 1000) * this.stage.duration));
    this.clock = bar.appendChild(make("output", "clock", { title: "Time and length of the clip" }));
    this.clock.setAttribute("aria-live", "off"); // it changes with every frame
    this.speedChoice = bar.appendChild(make("select", "speed", { title: "Speed of playback" }));
    this.speedChoice.setAttribute("aria-label", "Speed");
    for (const speed of SPEEDS) this.speedChoice.add(new Option(`${speed}×`, speed, speed === 1, speed === 1));
    this.speedChoice.addEventListener("change", () => (this.speed = Number(this.speedChoice.value)));
    this.loopButton = this.addButton(bar, "loop", "Loop", () => this.setLoop(!this.loop), { key: "l", pressed: true });
    this.keys.push(["arrowleft", "←", "previous frame", () => this.seek(this.stage.time - this.frame)]);
    this.keys.push(["arrowright", "→", "next frame", () => this.seek(this.stage.time + this.frame)]);
    this.keys.push(["home", "home", "to the start", () => this.seek(0)]);
    this.keys.push(["end", "end", "to the end", () => this.seek(this.stage.duration)]);
  }

  buildTools(bottom) {
    const { stage } = this;
    const tools = (this.tools = bottom.appendChild(make("div", "tools")));
    const group = tools.appendChild(make("div", "segments"));
    group.setAttribute("role", "group");
    group.setAttribute("aria-label", "Colours");
    this.colours = COLOURS.map(([value, label, title]) => {
      const button = group.appendChild(make("button", "segment", { type: "button", textContent: label, title }));
      button.dataset.name = value;
      button.addEventListener("click", () => stage.set({ colours: value }));
      return button;
    });
    this.keys.push(["c", "c", "next colours", () => this.nextColours()]);
    const toggle = (name, label, key) =>
      this.addButton(tools, name, label, () => stage.set({ [name]: !stage.look[name] }), { key, pressed: false });
    this.toggles = {
      wireframe: toggle("wireframe", "Wireframe", "w"),
      overlay: toggle("overlay", "Overlay the driving mesh", "o"),
      follow: this.addButton(tools, "follow", "Follow the subject", () => this.toggleFollow(), { key: "f", pressed: false }),
    };
    this.addButton(tools, "reset", "Reset the view", () => stage.resetView(), { key: "r" });
  }

  buildTop(top) {
    this.top = top;
    const dark = () => this.stage.set({ dark: !this.stage.look.dark });
    this.themeButton = this.addButton(top, "theme", "Dark or light", dark, { key: "d" });
    this.addButton(top, "help", "Help and keys", () => this.toggleHelp(), { key: "?" });
  }

  /** Add a button with the icon `name`; `key` is its shortcut, `pressed` makes it a toggle. */
  addButton(parent, name, label, act, { pressed, key, keyName = key } = {}) {
    const button = parent.appendChild(make("button", "tool", { type: "button", innerHTML: ICONS[name] }));
    button.dataset.name = name;
    button.title = key ? `${label} (${keyName})` : label;
    button.setAttribute("aria-label", label);
    if (pressed !== undefined) button.setAttribute("aria-pressed", pressed);
    button.addEventListener("click", act);
    if (key) this.keys.push([key, keyName, label.toLowerCase(), () => !button.hidden && act()]);
    return button;
  }

  buildHelp() {
    const dialog = document.body.appendChild(make("dialog", "help"));
    dialog.setAttribute("aria-label", "Help and keys");
    const rows = this.keys.map(([, name, what]) => `<div><dt><kbd>${name}</kbd></dt><dd>${what}</dd></div>`).join("");
    dialog.innerHTML = `<h2>Camera</h2>
      <p>Drag to rotate, scroll or pinch to zoom, drag with the right button or two fingers to pan.
      A double click resets the view. All panels share one camera.</p>
      <h2>Keys</h2><dl>${rows}</dl><form method="dialog"><button class="plain">Close</button></form>`;
    dialog.addEventListener("click", (event) => event.target === dialog && dialog.close());
    return dialog;
  }

  toggleHelp() {
    this.help.open ? this.help.close() : this.help.showModal();
  }

  toggleFollow() {
    this.stage.set({ follow: !this.stage.look.follow });
    this.stage.resetView();
  }

  nextColours() {
    const offered = this.colours.filter((button) => !button.hidden);
    const index = offered.findIndex((button) => button.dataset.name === this.stage.look.colours);
    offered[(index + 1) % offered.length].click();
  }

  play() {
    if (this.playing || !this.stage.offers.moves) return;
    if (this.stage.time >= this.stage.duration) this.stage.setTime(0);
    this.playing = true;
    this.showPlaying();
    let before; // not performance.now(), which can be later than the time of the first frame
    const tick = (now) => {
      if (!this.playing) return;
      // A background tab gets no frames: without the limit, playback would jump when it is shown again.
      this.advance(Math.min((now - (before ?? now)) / 1000, 0.25) * this.speed);
      before = now;
      this.ticking = requestAnimationFrame(tick);
    };
    this.ticking = requestAnimationFrame(tick);
  }

  /** Move the time on; at the end, start again or pause. */
  advance(seconds) {
    const { stage } = this;
    const time = stage.time + seconds;
    if (time < stage.duration) stage.setTime(time);
    else if (this.loop) stage.setTime(stage.duration > 0 ? time % stage.duration : 0);
    else {
      stage.setTime(stage.duration);
      this.pause();
    }
  }

  pause() {
    this.playing = false;
    cancelAnimationFrame(this.ticking);
    this.showPlaying();
  }

  toggle() {
    this.playing ? this.pause() : this.play();
  }

  seek(seconds) {
    this.pause();
    this.stage.setTime(Math.min(Math.max(seconds, 0), this.stage.duration));
  }

  setLoop(on) {
    this.loop = on;
    this.loopButton.setAttribute("aria-pressed", on);
  }

  pressed(event) {
    const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName) && event.target.type !== "range";
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === " " && event.target.tagName === "BUTTON") return; // the browser presses the button
    if (this.help.open && event.key !== "?") return;
    const found = this.keys.find(([key]) => key === event.key.toLowerCase());
    if (!found) return;
    event.preventDefault();
    found[3]();
  }

  showPlaying() {
    this.playButton.innerHTML = this.playing ? ICONS.pause : ICONS.play;
    const label = this.playing ? "Pause" : "Play";
    this.playButton.setAttribute("aria-label", label);
    this.playButton.title = `${label} (space)`;
  }

  showTime() {
    const { time, duration } = this.stage;
    const text = `${time.toFixed(2)} / ${duration.toFixed(2)} s`;
    if (this.clock.value === text) return;
    this.scrub.value = duration > 0 ? (1000 * time) / duration : 0;
    this.scrub.setAttribute("aria-valuetext", text);
    this.scrub.style.setProperty("--done", `${this.scrub.value / 10}%`);
    this.clock.value = text;
  }

  showLook() {
    const { look } = this.stage;
    for (const button of this.colours) button.setAttribute("aria-pressed", button.dataset.name === look.colours);
    for (const [name, button] of Object.entries(this.toggles)) button.setAttribute("aria-pressed", look[name]);
    document.documentElement.dataset.theme = look.dark ? "dark" : "light";
  }

  showScene() {
    const { offers, scene } = this.stage;
    this.bar.hidden = !offers.moves;
    const moving = scene.panels.filter((panel) => panel.frames > 1);
    this.frame = 1 / Math.max(...moving.map((panel) => panel.fps));
    for (const button of this.colours) button.hidden = !offers[button.dataset.name];
    this.toggles.overlay.hidden = !offers.overlay;
    this.toggles.follow.hidden = !offers.travels;
  }

  followSystemTheme() {
    const system = matchMedia("(prefers-color-scheme: dark)");
    system.addEventListener("change", () => this.stage.set({ dark: system.matches }));
    this.stage.set({ dark: system.matches });
  }

  dispose() {
    this.pause();
    document.removeEventListener("keydown", this.listen);
    this.help.remove();
    this.legend.dispose();
  }
}
