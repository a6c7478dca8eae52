// Keeps the stage as the desk is: fetches the scene when it changes, and until a result is there asks for the pose
// under the time slider, one wish at a time, so that the newest is always the next.
import { askPose, call } from "./server.js";

export class Live {
  constructor(stage, controls, failed) {
    Object.assign(this, { stage, controls, failed, key: "", numbers: [], state: null, asking: new Map() });
    stage.addEventListener("time", () => this.follow());
  }

  /** The state is new: show another scene if there is one, and follow the slider where results are of before. */
  async see(state) {
    this.state = state;
    if (state.scene !== this.key && !this.loading) await this.load();
    this.mark();
    this.follow();
  }

  async load() {
    this.loading = true;
    try {
      while (this.state.scene !== this.key) {
        const { key, numbers, scene } = await call("GET", "/api/scene");
        const known = this.numbers.join() === numbers.join();
        this.key = key;
        this.numbers = numbers;
        this.forget();
        if (scene) await this.stage.show(scene, { keepView: known });
        document.documentElement.dataset.scene = key;
        if (scene && !known && this.stage.offers.moves && !calm()) this.controls.play();
      }
    } catch (error) {
      this.failed(error.message);
    } finally {
      this.loading = false;
    }
  }

  /** Whether the result of a mesh is that of now. */
  current(number) {
    const mesh = this.state?.identities.find((each) => each.number === number);
    return !mesh?.outcome || mesh.outcome.state !== "moving";
  }

  versionOf(number) {
    return this.state.identities.find((each) => each.number === number)?.outcome?.version;
  }

  /** The panels that show results, with the numbers of their meshes. */
  *results() {
    if (this.loading) return;
    for (const [k, view] of this.stage.views.entries()) {
      if (view.panel.role === "result") yield [this.numbers[k], view];
    }
  }

  mark() {
    for (const [number, view] of this.results()) {
      const waiting = !this.current(number);
      view.box.classList.toggle("waiting", waiting);
      view.box.classList.toggle("posed", Boolean(view.panel.held));
      if (!waiting && view.panel.held && !this.asking.has(number)) {
        this.stage.hold(view, null);
      }
    }
  }

  follow() {
    for (const [number, view] of this.results()) {
      if (!this.current(number) && !this.asking.has(number)) this.ask(number, view);
    }
  }

  /** Ask for poses until the one that is shown is the one under the slider. */
  async ask(number, view) {
    const stop = new AbortController();
    this.asking.set(number, stop);
    const wish = () => `${this.frame()} ${this.versionOf(number)}`;
    try {
      while (!this.current(number) && view.had !== wish() && !stop.signal.aborted) {
        view.had = wish();
        const points = await askPose(number, this.frame(), stop.signal);
        if (!points || stop.signal.aborted || points.length !== 3 * view.panel.vertices) break;
        this.stage.hold(view, points);
        this.mark();
      }
    } catch (error) {
      if (error.name !== "AbortError") this.failed(error.message);
    } finally {
      if (this.asking.get(number) === stop) this.asking.delete(number);
    }
  }

  /** The frame under the slider. */
  frame() {
    return Math.round(this.stage.time * (this.state.driving?.fps || 30));
  }

  forget() {
    for (const stop of this.asking.values()) stop.abort();
    this.asking.clear();
  }
}

const calm = () => matchMedia("(prefers-reduced-motion: reduce)").matches;
