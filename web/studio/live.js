// Keeps the stage up to date with the session: fetches the scene when it changes and, until a result is finished, the
// pose under the time slider. Each mesh has one request at a time, so that the next one is always for the newest time.
import { call, fetchPose } from "./server.js";

export class Live {
  constructor(stage, controls, failed, loadingChanged) {
    Object.assign(this, { stage, controls, failed, loadingChanged, loading: false });
    Object.assign(this, { key: "", numbers: [], state: null, requests: new Map() });
    stage.addEventListener("time", () => this.follow());
  }

  /** Take a new state: load its scene if it changed, and fetch poses of meshes whose results are not finished. */
  async update(state) {
    this.state = state;
    if (state.scene !== this.key && !this.loading) await this.load();
    this.markWaiting();
    this.follow();
  }

  async load() {
    this.setLoading(true);
    try {
      while (this.state.scene !== this.key) {
        const { key, numbers, scene } = await call("GET", "/api/scene");
        const sameItems = this.numbers.join() === numbers.join();
        this.key = key;
        this.numbers = numbers;
        this.abortRequests();
        if (scene) await this.stage.show(scene, { keepView: sameItems });
        document.documentElement.dataset.scene = key;
        this.failed("");
        if (scene && !sameItems && this.stage.offers.moves && !reducedMotion()) this.controls.play();
      }
    } catch (error) {
      this.failed(error.message);
    } finally {
      this.setLoading(false);
    }
  }

  setLoading(loading) {
    this.loading = loading;
    this.loadingChanged();
  }

  /** Whether the shown result of a mesh is not being computed again. */
  current(number) {
    return this.outcome(number)?.state !== "moving";
  }

  outcome(number) {
    return this.state?.identities.find((item) => item.number === number)?.outcome;
  }

  /** Iterate over [number, view] of the panels that show results. */
  *results() {
    if (this.loading) return;
    for (const [k, view] of this.stage.views.entries()) {
      if (view.panel.role === "result") yield [this.numbers[k], view];
    }
  }

  markWaiting() {
    for (const [number, view] of this.results()) {
      const waiting = !this.current(number);
      view.box.classList.toggle("failed", this.outcome(number)?.state === "failed");
      view.box.classList.toggle("waiting", waiting);
      view.box.classList.toggle("posed", Boolean(view.panel.fixedPose));
      if (!waiting && view.panel.fixedPose && !this.requests.has(number)) {
        this.stage.setFixedPose(view, null);
      }
    }
  }

  follow() {
    for (const [number, view] of this.results()) {
      if (!this.current(number) && !this.requests.has(number)) this.requestPoses(number, view);
    }
  }

  /** Fetch poses until the shown one is that under the slider. */
  async requestPoses(number, view) {
    const controller = new AbortController();
    this.requests.set(number, controller);
    const wantedPose = () => `${this.frame()} ${this.outcome(number)?.version}`;
    try {
      while (!this.current(number) && view.shownPose !== wantedPose() && !controller.signal.aborted) {
        view.shownPose = wantedPose();
        const points = await fetchPose(number, this.frame(), controller.signal);
        if (!points || controller.signal.aborted || points.length !== 3 * view.panel.vertices) break;
        this.stage.setFixedPose(view, points);
        this.failed("");
        this.markWaiting();
      }
    } catch (error) {
      if (error.name !== "AbortError") this.failed(error.message);
    } finally {
      if (this.requests.get(number) === controller) this.requests.delete(number);
    }
  }

  /** Return the index of the frame under the slider. */
  frame() {
    return Math.round(this.stage.time * (this.state.driving?.fps || 30));
  }

  abortRequests() {
    for (const controller of this.requests.values()) controller.abort();
    this.requests.clear();
  }
}

const reducedMotion = () => matchMedia("(prefers-reduced-motion: reduce)").matches;
