// Measures results in every frame, and colours them by it: edges against the identity's, distances to the truth.
import { errorScale, stretchScale } from "./palette.js";

/** Edges that are so many times as long as at rest, or as short, have the deepest colours. */
const MOST = 1.5;
const LIMIT = Math.log(MOST);
/** Frames, evenly spread, that the scale of errors is taken from. */
const LOOKS = 24;

export class Meter {
  constructor(subjects) {
    const find = (role) => subjects.find(({ panel }) => panel.role === role);
    const result = find("result");
    const same = (other) => (other && result && other.panel.vertices === result.panel.vertices ? other : undefined);
    this.result = result;
    this.rest = same(find("identity"));
    this.truth = same(find("truth"));
    this.hasStretch = Boolean(this.rest && result.surface.corners.length);
    this.hasError = Boolean(this.truth);
  }

  /** Whether a subject is coloured by its measure. */
  measures(subject, colours) {
    return subject === this.result && ((colours === "stretch" && this.hasStretch) || (colours === "error" && this.hasError));
  }

  /** Colour the result as it stands; returns what the legend says, or null. */
  paint(colours) {
    if (colours === "stretch" && this.hasStretch) return this.paintStretch();
    if (colours === "error" && this.hasError) return this.paintError();
    return null;
  }

  /** Each vertex by the summed length of its edges over what it is at rest. */
  paintStretch() {
    const { result } = this;
    this.restLengths ??= edgeLengths(this.rest, this.rest.panel.sample(0, new Float32Array(result.points.length)));
    this.lengths = edgeLengths(result, result.points, this.lengths);
    const { lengths, restLengths } = this;
    let [mean, most, seen] = [0, 0, 0];
    for (let v = 0; v < lengths.length; v++) {
      if (!(restLengths[v] > 0)) continue;
      const ratio = lengths[v] / restLengths[v];
      mean += Math.abs(ratio - 1);
      most = Math.max(most, Math.abs(ratio - 1));
      seen++;
    }
    result.paint((v, out, at) => {
      const ratio = restLengths[v] > 0 ? lengths[v] / restLengths[v] : 1;
      stretchScale.paint(0.5 + Math.log(Math.max(ratio, 1e-6)) / (2 * LIMIT), out, at);
    });
    return { what: "stretch", limit: MOST, css: stretchScale.css, mean: mean / Math.max(seen, 1), most };
  }

  /** Each vertex by its distance to the same vertex of the truth. */
  paintError() {
    const { result, truth } = this;
    this.limit ??= this.findLimit();
    const distance = this.distances();
    let [mean, most] = [0, 0];
    for (let v = 0; v < distance.length; v++) {
      mean += distance[v];
      most = Math.max(most, distance[v]);
    }
    result.paint((v, out, at) => errorScale.paint(distance[v] / this.limit, out, at));
    mean /= distance.length;
    const size = truth.panel.size;
    return { what: "error", limit: this.limit, css: errorScale.css, mean, most, size };
  }

  /** Of every vertex of the result, as it stands or at these points, to the truth. */
  distances(a = this.result.points, b = this.truth.points) {
    const { result, truth } = this;
    this.far ??= new Float32Array(result.panel.vertices);
    const [dx, dy, dz] = [0, 1, 2].map((k) => result.panel.anchor[k] - truth.panel.anchor[k]);
    for (let v = 0, o = 0; v < this.far.length; v++, o += 3) {
      this.far[v] = Math.hypot(a[o] - b[o] + dx, a[o + 1] - b[o + 1] + dy, a[o + 2] - b[o + 2] + dz);
    }
    return this.far;
  }

  /** The distance that 99 of 100 vertices stay below over the clip: one scale for all of it. */
  findLimit() {
    const { panel } = this.result;
    const count = this.result.panel.vertices;
    const looks = Math.min(LOOKS, panel.frames);
    const all = new Float32Array(looks * count);
    const [a, b] = [new Float32Array(3 * count), new Float32Array(3 * count)];
    for (let k = 0; k < looks; k++) {
      const seconds = looks > 1 ? (k / (looks - 1)) * panel.duration : 0;
      all.set(this.distances(panel.sample(seconds, a), this.truth.panel.sample(seconds, b)), k * count);
    }
    all.sort();
    return all[Math.floor(0.99 * (all.length - 1))] || this.truth.panel.size / 1000;
  }
}

/** Summed length of the edges at each vertex, those of two faces twice. */
function edgeLengths({ solid }, points, out = new Float32Array(points.length / 3)) {
  const { vertices } = solid;
  out.fill(0);
  for (let k = 0; k < vertices.length; k++) {
    const a = vertices[k];
    const b = vertices[k % 3 === 2 ? k - 2 : k + 1];
    const length = Math.hypot(points[3 * a] - points[3 * b], points[3 * a + 1] - points[3 * b + 1], points[3 * a + 2] - points[3 * b + 2]);
    out[a] += length;
    out[b] += length;
  }
  return out;
}
