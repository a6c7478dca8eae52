// The stage: panels side by side in one canvas, with one camera. Buttons are in `controls.js`.
//
//   const stage = new Stage(element)        element: a positioned element, filled by the panels
//   await stage.show(packed, {keepView})    the output of pack_scene; replaces the current scene
//   stage.setTime(seconds)                  any time in 0..stage.duration
//   stage.set({colours, wireframe, overlay, follow, dark})   each optional; colours: material clay stretch error
//   stage.look                              the current settings
//   stage.offers                            {moves, stretch, error, overlay, travels}: what this scene supports
//   stage.measure                           statistics of the measure shown by the colours (see Meter.paint), or null
//   stage.project(view, points), stage.drag(view, point, right, down)   between a file's coordinates and pixels of a panel
//   stage.resetView(), stage.render(), stage.dispose()
//   stage.addEventListener("time" | "look" | "scene" | "drawn", ...)
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { ContactShadow, addLights } from "./ground.js";
import { fitView } from "./fit.js";
import { Meter } from "./meter.js";
import { decodeScene } from "./scene.js";
import { Subject } from "./surface.js";

/** Pixels below the subject that are reserved for its caption. */
const CAPTION = 40;
const LABELS = { identity: "Identity", driving: "Driving", result: "Result", truth: "Truth", mesh: "" };

export class Stage extends EventTarget {
  constructor(element) {
    super();
    this.element = element;
    this.canvas = element.appendChild(Object.assign(document.createElement("canvas"), { className: "stage-canvas" }));
    this.canvas.setAttribute("aria-hidden", "true");
    this.grid = element.appendChild(Object.assign(document.createElement("div"), { className: "stage-panels" }));
    this.software = drawsInSoftware();
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: !this.software, alpha: true });
    this.renderer.setClearColor(0, 0);
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.renderer.autoClear = false;
    this.camera = new THREE.PerspectiveCamera(26, 1, 0.02, 60);
    this.orbit = new OrbitControls(this.camera, this.grid);
    Object.assign(this.orbit, { enableDamping: false, minDistance: 0.15, maxDistance: 30, zoomSpeed: 0.9 });
    this.orbit.addEventListener("change", () => this.render());
    this.orbit.addEventListener("start", () => (this.touched = true));
    this.grid.addEventListener("dblclick", () => this.resetView());
    this.views = [];
    this.look = { colours: "material", wireframe: false, overlay: false, follow: false, dark: false };
    this.offers = {};
    this.time = 0;
    this.duration = 0;
    this.resizing = new ResizeObserver(() => this.resized());
    this.resizing.observe(element);
  }

  async show(packed, { keepView = false } = {}) {
    const scene = await decodeScene(packed);
    const textures = await Promise.all(scene.images.map(readTexture));
    this.dispatchEvent(new Event("clear"));
    this.clear();
    this.scene = scene;
    this.textures = textures;
    this.duration = scene.duration;
    this.views = scene.panels.map((panel) => this.addView(panel, scene.surfaces[panel.surface]));
    this.grid.dataset.count = this.views.length;
    this.meter = new Meter(this.views.map((view) => view.subject));
    this.offers = this.findOffers();
    this.addGhost();
    const colours = this.offers[this.look.colours] === false ? "material" : this.look.colours;
    this.time = Math.min(this.time, this.duration);
    this.set({ ...this.look, colours, follow: this.look.follow || this.offers.travels });
    this.dispatchEvent(new Event("scene"));
    if (!keepView || !this.fitted) this.resetView();
    this.resized();
  }

  addView(panel, surface) {
    const box = document.createElement("figure");
    box.className = `panel panel-${panel.role}`;
    const caption = box.appendChild(document.createElement("figcaption"));
    const role = LABELS[panel.role];
    const strong = caption.appendChild(document.createElement("strong"));
    strong.textContent = role || panel.name;
    if (role) caption.append(` ${panel.name}`);
    const counts = caption.appendChild(document.createElement("small"));
    counts.textContent = panel.triangles
      ? `${panel.vertices.toLocaleString("en")} vertices`
      : `${panel.vertices.toLocaleString("en")} points`;
    this.grid.append(box);
    const scene = new THREE.Scene();
    addLights(scene);
    const subject = new Subject(panel, surface, this.textures);
    scene.add(subject);
    return { panel, subject, scene, box, shadow: new ContactShadow(scene), travel: [0, 0, 0], stale: true };
  }

  findOffers() {
    const longest = Math.max(...this.scene.panels.map(travelDistance));
    return {
      moves: this.duration > 0,
      material: true,
      clay: true,
      stretch: this.meter.hasStretch,
      error: this.meter.hasError,
      overlay: this.find("driving") !== undefined && this.find("result") !== undefined,
      travels: longest > 0.35,
    };
  }

  find(role) {
    return this.views.find((view) => view.panel.role === role);
  }

  /** Add a translucent copy of the driving mesh to the result's panel. */
  addGhost() {
    if (!this.offers.overlay) return;
    const { panel, subject } = this.find("driving");
    this.ghost = new Subject(panel, subject.surface, this.textures);
    const { material } = this.ghost.body;
    this.ghost.materials.ghost = Object.assign(material.clone(), { transparent: true, opacity: 0.38, depthWrite: false });
    this.ghost.body.material = this.ghost.materials.ghost;
    this.ghost.renderOrder = 2;
    this.find("result").scene.add(this.ghost);
  }

  set(changes) {
    Object.assign(this.look, changes);
    const { colours, wireframe, overlay, dark } = this.look;
    for (const { subject, shadow } of this.views) {
      const measured = this.meter.measures(subject, colours);
      subject.setMaterials(measured ? "measured" : colours === "material" ? "material" : "clay");
      subject.showEdges(wireframe, dark ? "#ffffff" : "#241f1b");
      shadow.setTheme(dark);
    }
    if (this.ghost) this.ghost.visible = overlay;
    this.setTime(this.time);
    this.dispatchEvent(new Event("look"));
  }

  setTime(seconds) {
    this.time = seconds;
    for (const view of this.views) {
      if (view.panel.frames === 1 && view.posed) continue;
      view.posed = true;
      if (this.look.follow) projectOnFloor(view.panel.travel(seconds, view.travel), view.panel.turn);
      view.subject.pose(seconds, this.look.follow ? view.travel : null);
      view.stale = true;
    }
    if (this.ghost?.visible) this.ghost.pose(seconds, this.look.follow ? this.find("driving").travel : null);
    this.measure = this.meter?.paint(this.look.colours) ?? null;
    this.dispatchEvent(new Event("time"));
    this.render();
  }

  /** Show fixed points in a view (see Panel.setFixedPose), or its clip again with null. */
  setFixedPose(view, points) {
    view.panel.setFixedPose(points);
    view.posed = false;
    this.setTime(this.time);
  }

  resetView() {
    if (!this.views.length) return;
    const aspect = Math.min(...this.views.map(({ box }) => box.clientWidth / Math.max(box.clientHeight - CAPTION, 1)));
    fitView(this.camera, this.orbit, this.scene.panels, this.look.follow, aspect || 1);
    this.fitted = true;
    this.touched = false;
    this.render();
  }

  resized() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, this.software ? 1 : 2));
    this.renderer.setSize(width, height, false);
    if (this.fitted && !this.touched) this.resetView();
    this.render();
  }

  /** Draw with the next frame of the browser, once however often it is called. */
  render() {
    this.pending ??= requestAnimationFrame(() => {
      this.pending = undefined;
      this.draw();
    });
  }

  draw() {
    const { renderer, camera } = this;
    const stageBox = this.element.getBoundingClientRect();
    renderer.setScissorTest(false);
    renderer.setRenderTarget(null);
    renderer.clear();
    for (const view of this.views) {
      const box = view.box.getBoundingClientRect();
      view.scene.updateMatrixWorld();
      if (view.stale) this.castShadow(view);
      renderer.setScissorTest(true);
      const viewport = [box.left - stageBox.left, stageBox.bottom - box.bottom, box.width, box.height];
      renderer.setViewport(...viewport);
      renderer.setScissor(...viewport);
      this.aim(box);
      renderer.render(view.scene, camera);
    }
    this.dispatchEvent(new Event("drawn"));
  }

  /** Set the camera up for a panel's box. */
  aim({ width, height }) {
    this.camera.aspect = width / (height - CAPTION);
    this.camera.setViewOffset(width, height - CAPTION, 0, 0, width, height);
  }

  /** Return where points ([x, y, z] in the file's coordinates of a view's mesh) are in its panel: [x, y] in pixels. */
  project(view, points) {
    const box = view.box.getBoundingClientRect();
    this.aim(box);
    return points.map((point) => {
      const at = this.toStage(view, point).project(this.camera);
      return [((at.x + 1) / 2) * box.width, ((1 - at.y) / 2) * box.height];
    });
  }

  /** Move a point ([x, y, z] in the file's coordinates) parallel to the picture by pixels of a view's panel. */
  drag(view, point, right, down) {
    const box = view.box.getBoundingClientRect();
    this.aim(box);
    const at = this.toStage(view, point).project(this.camera);
    at.x += (2 * right) / box.width;
    at.y -= (2 * down) / box.height;
    at.unproject(this.camera).applyMatrix4(view.subject.matrix.clone().invert());
    return at.toArray().map((x, k) => x + view.panel.anchor[k]);
  }

  toStage({ panel, subject }, point) {
    return new THREE.Vector3(...point.map((x, k) => x - panel.anchor[k])).applyMatrix4(subject.matrix);
  }

  /** Draw the contact shadow of a subject in its current pose, without wireframe and translucent driving mesh. */
  castShadow(view) {
    const { subject, scene, panel, shadow } = view;
    this.renderer.setScissorTest(false);
    const others = [subject.edges, this.ghost].filter((other) => other?.visible);
    for (const other of others) other.visible = false;
    const centre = subject.centre(this.time, this.look.follow ? view.travel : null);
    shadow.cast(this.renderer, scene, subject.body, this.floorOf(panel), centre.x, centre.z);
    for (const other of others) other.visible = true;
    view.stale = false;
  }

  /** Return the height of the floor on the stage: that of the lowest point of the clip. */
  floorOf(panel) {
    panel.floor ??= lowestPoint(panel);
    return panel.floor;
  }

  clear() {
    for (const { subject, shadow, box } of this.views) {
      subject.dispose();
      shadow.dispose();
      box.remove();
    }
    for (const texture of this.textures ?? []) texture.dispose();
    this.ghost?.dispose();
    this.ghost = undefined;
    this.views = [];
  }

  dispose() {
    this.resizing.disconnect();
    cancelAnimationFrame(this.pending);
    this.clear();
    this.orbit.dispose();
    this.renderer.dispose();
    this.canvas.remove();
    this.grid.remove();
  }
}

/** Whether the browser draws without a graphics card: antialiasing would then take 135 instead of 57 ms per frame. */
function drawsInSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  let name = gl?.getParameter(gl.RENDERER) ?? "";
  // Chrome and Safari have the name in an extension, of which Firefox warns.
  const info = /webkit/i.test(name) && gl.getExtension("WEBGL_debug_renderer_info");
  if (info) name = gl.getParameter(info.UNMASKED_RENDERER_WEBGL);
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

/** Read a PNG or JPEG as a texture, v counted from the lower edge; null if the browser cannot read it. */
async function readTexture({ type, bytes }) {
  const image = new Image();
  const url = URL.createObjectURL(new Blob([bytes], { type }));
  image.src = url;
  const readable = await image.decode().then(() => true, () => false);
  URL.revokeObjectURL(url);
  if (!readable) return null;
  const texture = new THREE.Texture(image);
  Object.assign(texture, { colorSpace: THREE.SRGBColorSpace, wrapS: THREE.RepeatWrapping, wrapT: THREE.RepeatWrapping });
  Object.assign(texture, { anisotropy: 4, needsUpdate: true });
  return texture;
}

/** Compute how far the centroid of a panel's subject moves along the floor, in sizes of the subject. */
function travelDistance(panel) {
  const offset = [0, 0, 0];
  let largest = 0;
  for (let k = 0; k < panel.frames; k++) {
    projectOnFloor(panel.travel(k / panel.fps, offset), panel.turn);
    largest = Math.max(largest, Math.hypot(...offset) / panel.size);
  }
  return largest;
}

/** Remove the component along the panel's up axis from a vector, in place. */
function projectOnFloor(vector, turn) {
  const height = turn[3] * vector[0] + turn[4] * vector[1] + turn[5] * vector[2];
  for (let k = 0; k < 3; k++) vector[k] -= height * turn[3 + k];
  return vector;
}

/** Find the lowest height of a panel's points over 24 frames, in stage units. */
function lowestPoint(panel) {
  const [, , , a, b, c] = panel.turn;
  const points = new Float32Array(3 * panel.vertices);
  const count = Math.min(panel.frames, 24);
  let low = Infinity;
  for (let k = 0; k < count; k++) {
    panel.sample((k / Math.max(count - 1, 1)) * panel.duration, points);
    for (let p = 0; p < points.length; p += 3) low = Math.min(low, a * points[p] + b * points[p + 1] + c * points[p + 2]);
  }
  return low / panel.size;
}
