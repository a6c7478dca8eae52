// Measures the result in every frame and colours it: stretch of edges against the identity, or distance to the truth.
import { errorScale, stretchScale } from "./palette.js";

/** Ratio of lengths, or of its inverse, at the ends of the stretch scale. */
const MAX_RATIO = 1.5;
const LIMIT = Math.log(MAX_RATIO);
/** Frames, evenly spaced, from which the scale of errors is computed. */
const SAMPLED = 24;

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

  /** Whether a subject is coloured by a measure. */
  measures(subject, colours) {
    return subject === this.result && ((colours === "stretch" && this.hasStretch) || (colours === "error" && this.hasError));
  }

  /** Colour the result in its current pose; returns the data of the legend, or null. */
  paint(colours) {
    if (colours === "stretch" && this.hasStretch) return this.paintStretch();
    if (colours === "error" && this.hasError) return this.paintError();
    return null;
  }

  /** Colour each vertex by the total length of its edges relative to the identity, on a logarithmic scale. */
  paintStretch() {
    const { result } = this;
    this.restLengths ??= edgeLengths(this.rest, this.rest.panel.sample(0, new Float32Array(result.points.length)));
    this.lengths = edgeLengths(result, result.points, this.lengths);
    const { lengths, restLengths } = this;
    let [mean, largest, count] = [0, 0, 0];
    for (let v = 0; v < lengths.length; v++) {
      if (!(restLengths[v] > 0)) continue;
      const ratio = lengths[v] / restLengths[v];
      mean += Math.abs(ratio - 1);
      largest = Math.max(largest, Math.abs(ratio - 1));
      count++;
    }
    result.paint((v, out, at) => {
      const ratio = restLengths[v] > 0 ? lengths[v] / restLengths[v] : 1;
      stretchScale.paint(0.5 + Math.log(Math.max(ratio, 1e-6)) / (2 * LIMIT), out, at);
    });
    return { what: "stretch", limit: MAX_RATIO, css: stretchScale.css, mean: mean / Math.max(count, 1), largest };
  }

  /** Colour each vertex by its distance to the same vertex of the truth. */
  paintError() {
    const { result, truth } = this;
    this.limit ??= this.findLimit();
    const distance = this.distances();
    let [mean, largest] = [0, 0];
    for (let v = 0; v < distance.length; v++) {
      mean += distance[v];
      largest = Math.max(largest, distance[v]);
    }
    result.paint((v, out, at) => errorScale.paint(distance[v] / this.limit, out, at));
    mean /= distance.length;
    const size = truth.panel.size;
    return { what: "error", limit: this.limit, css: errorScale.css, mean, largest, size };
  }

  /** Compute the distance of every vertex of the result to the truth, in their current poses or at the given points. */
  distances(a = this.result.points, b = this.truth.points) {
    const { result, truth } = this;
    this.distanceBuffer ??= new Float32Array(result.panel.vertices);
    const [dx, dy, dz] = [0, 1, 2].map((k) => result.panel.anchor[k] - truth.panel.anchor[k]);
    for (let v = 0, o = 0; v < this.distanceBuffer.length; v++, o += 3) {
      this.distanceBuffer[v] = Math.hypot(a[o] - b[o] + dx, a[o + 1] - b[o + 1] + dy, a[o + 2] - b[o + 2] + dz);
    }
    return this.distanceBuffer;
  }

  /** Compute the 99th percentile of distances over the clip: one scale for all frames. */
  findLimit() {
    const { panel } = this.result;
    const count = this.result.panel.vertices;
    const samples = Math.min(SAMPLED, panel.frames);
    const all = new Float32Array(samples * count);
    const [a, b] = [new Float32Array(3 * count), new Float32Array(3 * count)];
    for (let k = 0; k < samples; k++) {
      const seconds = samples > 1 ? (k / (samples - 1)) * panel.duration : 0;
      all.set(this.distances(panel.sample(seconds, a), this.truth.panel.sample(seconds, b)), k * count);
    }
    all.sort();
    return all[Math.floor(0.99 * (all.length - 1))] || this.truth.panel.size / 1000;
  }
}

/** Sum the lengths of the edges at each vertex; edges of two faces count twice. */
function edgeLengths({ normals }, points, out = new Float32Array(points.length / 3)) {
  const { vertices } = normals;
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
