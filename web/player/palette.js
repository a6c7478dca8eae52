// Colours of surfaces and scales; sRGB in 0..1 unless stated otherwise.
import { Color, SRGBColorSpace } from "three";

/** Surfaces without a material, and the driving mesh. */
export const CLAY = [0.8, 0.76, 0.715];
export const SLATE = [0.6, 0.68, 0.76];
/** Linear albedo of what a file calls white: a little darker than the background, so that its shading is visible. */
export const WHITE = 0.82;

/** Edges shorter than the identity's are blue, longer red, unchanged grey. */
const STRETCH = [[0.13, 0.28, 0.55], [0.38, 0.58, 0.78], [0.86, 0.84, 0.81], [0.92, 0.56, 0.38], [0.66, 0.13, 0.16]];
/** From no error to the limit; lightness falls throughout. */
const ERROR = [[0.86, 0.85, 0.83], [0.97, 0.82, 0.53], [0.95, 0.56, 0.27], [0.78, 0.23, 0.24], [0.45, 0.07, 0.28]];

const STEPS = 256;

/** Interpolate evenly spaced sRGB stops to a table of 256 linear colours (3 numbers each). */
function table(stops) {
  const values = new Float32Array(3 * STEPS);
  const color = new Color();
  for (let k = 0; k < STEPS; k++) {
    const at = (k / (STEPS - 1)) * (stops.length - 1);
    const from = Math.min(Math.floor(at), stops.length - 2);
    const mixed = [0, 1, 2].map((c) => stops[from][c] + (stops[from + 1][c] - stops[from][c]) * (at - from));
    color.setRGB(...mixed, SRGBColorSpace).toArray(values, 3 * k);
  }
  return values;
}

/** A colour scale: `paint(share, out, at)` writes the linear colour of a share in 0..1; `css` is its gradient. */
class Scale {
  constructor(stops) {
    this.table = table(stops);
    const parts = stops.map((stop) => `rgb(${stop.map((x) => Math.round(255 * x)).join(" ")})`);
    this.css = `linear-gradient(90deg, ${parts.join(", ")})`;
  }

  paint(share, out, at) {
    const k = 3 * Math.min(Math.max(Math.round(share * (STEPS - 1)), 0), STEPS - 1);
    out[at] = this.table[k];
    out[at + 1] = this.table[k + 1];
    out[at + 2] = this.table[k + 2];
  }
}

export const stretchScale = new Scale(STRETCH);
export const errorScale = new Scale(ERROR);
