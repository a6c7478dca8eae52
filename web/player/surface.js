// The subject of one panel: geometry, normals of every frame, materials, and colours of measures.
//
// new Subject(panel, surface, textures): a three.js Group in the panel's stage coordinates (y up, size 1, on the floor at
// the origin). subject.pose(seconds) poses it; subject.setMaterials(name) chooses its materials.
import * as THREE from "three";
import { CLAY, SLATE, WHITE } from "./palette.js";

export class Subject extends THREE.Group {
  constructor(panel, surface, textures) {
    super();
    this.panel = panel;
    this.surface = surface;
    this.points = new Float32Array(3 * panel.vertices);
    this.geometry = buildGeometry(surface);
    this.materials = { material: fileMaterials(panel, surface, textures), clay: clay(panel), measured: measured() };
    this.body = surface.corners.length
      ? new THREE.Mesh(this.geometry, this.materials.clay)
      : new THREE.Points(this.geometry, dots(panel, surface));
    this.body.frustumCulled = false;
    this.add(this.body);
    this.stageMatrix = placement(panel);
    this.matrixAutoUpdate = false;
    this.matrix.copy(this.stageMatrix);
    if (surface.corners.length) this.normals = prepareNormals(surface);
  }

  /** Pose at a time in seconds; `travel` (three numbers in the file's axes) is subtracted, to follow the subject. */
  pose(seconds, travel = null) {
    this.panel.sample(seconds, this.points);
    this.matrix.copy(this.stageMatrix);
    if (travel) this.matrix.multiply(translation.makeTranslation(-travel[0], -travel[1], -travel[2]));
    this.matrixWorldNeedsUpdate = true;
    copyToRenderVertices(this.points, this.surface.origin, this.geometry.attributes.position);
    if (this.normals) writeNormals(this.points, this.normals, this.surface.smooth, this.geometry.attributes.normal);
  }

  /** Return the centroid of the points in stage coordinates. */
  centre(seconds, travel = null) {
    const { panel, stageMatrix } = this;
    const offset = panel.travel(seconds, [0, 0, 0]);
    const centre = offset.map((x, k) => x + panel.centre[k] - panel.anchor[k] - (travel ? travel[k] : 0));
    return new THREE.Vector3(...centre).applyMatrix4(stageMatrix);
  }

  /** Use the file's materials ("material"), plain "clay", or the colours that `paint` writes ("measured"). */
  setMaterials(name) {
    if (this.body.isMesh) this.body.material = this.materials[name];
  }

  /** Call a function for every render vertex that writes its linear colour: write(vertex, array, at). */
  paint(write) {
    const { origin } = this.surface;
    const attribute = this.geometry.attributes.measure ?? this.addMeasure();
    for (let r = 0; r < origin.length; r++) write(origin[r], attribute.array, 3 * r);
    attribute.needsUpdate = true;
  }

  addMeasure() {
    const attribute = new THREE.BufferAttribute(new Float32Array(3 * this.surface.origin.length), 3);
    this.geometry.setAttribute("measure", attribute.setUsage(THREE.DynamicDrawUsage));
    return attribute;
  }

  /** Show or hide the edges of its triangles. */
  showEdges(on, color) {
    if (!this.body.isMesh) return;
    if (on && !this.edges) {
      this.edges = edgeLines(this.geometry, this.surface);
      this.add(this.edges);
    }
    if (!this.edges) return;
    this.edges.visible = on;
    this.edges.material.color.set(color);
  }

  dispose() {
    this.geometry.dispose();
    this.edges?.geometry.dispose();
    for (const material of Object.values(this.materials).flat()) material.dispose();
  }
}

const translation = new THREE.Matrix4();

/** Return the matrix from the file's axes and unit, relative to the anchor, to the stage: y up, +z front, size 1. */
function placement(panel) {
  const [a, b, c, d, e, f, g, h, i] = panel.turn;
  const matrix = new THREE.Matrix4().set(a, b, c, 0, d, e, f, 0, g, h, i, 0, 0, 0, 0, 1);
  return matrix.premultiply(new THREE.Matrix4().makeScale(1 / panel.size, 1 / panel.size, 1 / panel.size));
}

function buildGeometry(surface) {
  const geometry = new THREE.BufferGeometry();
  const count = surface.origin.length;
  const moving = () => new THREE.BufferAttribute(new Float32Array(3 * count), 3).setUsage(THREE.DynamicDrawUsage);
  geometry.setAttribute("position", moving());
  if (surface.corners.length) {
    geometry.setAttribute("normal", moving());
    geometry.setIndex(new THREE.BufferAttribute(surface.corners, 1));
  }
  if (surface.uv) geometry.setAttribute("uv", new THREE.BufferAttribute(surface.uv, 2));
  if (surface.colors) geometry.setAttribute("color", expandColors(surface));
  surface.groups.forEach(({ start, stop }, k) => geometry.addGroup(3 * start, 3 * (stop - start), k));
  return geometry;
}

function expandColors({ origin, colors }) {
  const values = new Float32Array(3 * origin.length);
  origin.forEach((vertex, r) => {
    for (let c = 0; c < 3; c++) values[3 * r + c] = colors[4 * vertex + c] / 65535;
  });
  return new THREE.BufferAttribute(values, 3);
}

function matte(options) {
  return new THREE.MeshLambertMaterial({
    side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1, ...options,
  });
}

/** Make the file's materials, one per group; the tint for groups without one. */
function fileMaterials(panel, surface, textures) {
  const plain = surface.colors ? new THREE.Color(WHITE, WHITE, WHITE) : tint(panel);
  return surface.groups.map(({ material }) => {
    const color = material ? new THREE.Color(...material.color.slice(0, 3)).multiplyScalar(WHITE) : plain;
    const map = material && material.image !== null ? textures[material.image] : null;
    return matte({ color, map, vertexColors: Boolean(surface.colors) });
  });
}

function clay(panel) {
  return matte({ color: tint(panel) });
}

/** Return the colour of surfaces without a material: slate for the driving mesh, clay for all others. */
function tint(panel) {
  return new THREE.Color().setRGB(...(panel.role === "driving" ? SLATE : CLAY), THREE.SRGBColorSpace);
}

/** Make a material with colours from the attribute `measure`; the file's vertex colours are not overwritten. */
function measured() {
  const material = matte({});
  material.onBeforeCompile = (shader) => {
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", "#include <common>\nattribute vec3 measure;\nvarying vec3 vMeasure;")
      .replace("#include <begin_vertex>", "#include <begin_vertex>\nvMeasure = measure;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", "#include <common>\nvarying vec3 vMeasure;")
      .replace("#include <color_fragment>", "diffuseColor.rgb = vMeasure;");
  };
  return material;
}

/** Make a material that draws points as small shaded balls. */
function dots(panel, surface) {
  const side = 64;
  const canvas = Object.assign(document.createElement("canvas"), { width: side, height: side });
  const pen = canvas.getContext("2d");
  const ball = pen.createRadialGradient(side * 0.4, side * 0.36, 2, side / 2, side / 2, side / 2);
  for (const [at, shade] of [[0, "#fff"], [0.6, "#d8d8d8"], [1, "#8a8a8a"]]) ball.addColorStop(at, shade);
  pen.fillStyle = ball;
  pen.beginPath();
  pen.arc(side / 2, side / 2, side / 2 - 1, 0, 2 * Math.PI);
  pen.fill();
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const size = Math.min(Math.max(0.9 / Math.sqrt(panel.vertices), 0.004), 0.02);
  const color = surface.colors ? new THREE.Color(1, 1, 1) : tint(panel);
  return new THREE.PointsMaterial({ size, map, color, alphaTest: 0.5, vertexColors: Boolean(surface.colors) });
}

/** Make lines of each edge once, which share the positions of the surface. */
function edgeLines(geometry, { corners, origin }) {
  const added = new Set();
  const lines = [];
  for (let k = 0; k < corners.length; k++) {
    const [a, b] = [corners[k], corners[k % 3 === 2 ? k - 2 : k + 1]];
    const key = Math.min(a, b) * origin.length + Math.max(a, b);
    if (added.has(key)) continue;
    added.add(key);
    lines.push(a, b);
  }
  const shape = new THREE.BufferGeometry();
  shape.setAttribute("position", geometry.attributes.position);
  shape.setIndex(new THREE.BufferAttribute(new Uint32Array(lines), 1));
  const material = new THREE.LineBasicMaterial({ transparent: true, opacity: 0.35 });
  const edges = new THREE.LineSegments(shape, material);
  edges.frustumCulled = false;
  return edges;
}

/** Collect vertices and smoothing groups of all face corners for `writeNormals`. */
function prepareNormals({ corners, origin, smooth, smoothCount }) {
  const vertices = Uint32Array.from(corners, (r) => origin[r]);
  const groups = Uint32Array.from(corners, (r) => smooth[r]);
  return { vertices, groups, sums: new Float32Array(3 * smoothCount) };
}

/** Copy values of vertices (or of smoothing groups) to their render vertices. */
function copyToRenderVertices(points, origin, attribute) {
  const { array } = attribute;
  for (let r = 0, o = 0; r < origin.length; r++, o += 3) {
    const v = 3 * origin[r];
    array[o] = points[v];
    array[o + 1] = points[v + 1];
    array[o + 2] = points[v + 2];
  }
  attribute.needsUpdate = true;
}

/** Compute the normal of each smoothing group as the sum of its faces' normals, weighted by area, and write it. */
function writeNormals(points, { vertices, groups, sums }, smooth, attribute) {
  sums.fill(0);
  for (let k = 0; k < vertices.length; k += 3) {
    const a = 3 * vertices[k], b = 3 * vertices[k + 1], c = 3 * vertices[k + 2];
    const ux = points[b] - points[a], uy = points[b + 1] - points[a + 1], uz = points[b + 2] - points[a + 2];
    const vx = points[c] - points[a], vy = points[c + 1] - points[a + 1], vz = points[c + 2] - points[a + 2];
    const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
    for (let corner = k; corner < k + 3; corner++) {
      const g = 3 * groups[corner];
      sums[g] += nx;
      sums[g + 1] += ny;
      sums[g + 2] += nz;
    }
  }
  for (let g = 0; g < sums.length; g += 3) {
    const length = Math.hypot(sums[g], sums[g + 1], sums[g + 2]) || 1;
    sums[g] /= length;
    sums[g + 1] /= length;
    sums[g + 2] /= length;
  }
  copyToRenderVertices(sums, smooth, attribute);
}
