// Decodes the output of `mimesh.view.pack.pack_scene`. No three.js here: plain arrays in, plain arrays out.
//
// decodeScene(packed) -> Promise<Scene>
//   Scene: { title, model, notes[], left_out[], panels: Panel[], surfaces: Surface[], images: [{type, bytes}], duration }
//   Panel: the clip of one panel; panel.sample(seconds, out) writes its points at a time.
//   Surface: { corners (3 F), origin (R), smooth (R), uv (2 R) | null, colors (4 V) | null, groups: [{start, stop,
//     material: {color: [r, g, b, a] linear, image: number | null} | null}], smoothCount }
//     R render vertices, F faces, V vertices. corners: render vertex of each face corner; origin: vertex of each render
//     vertex; smooth: smoothing group, whose render vertices share a normal; groups: ranges of faces with one material.
//
// Packed fields of a panel: role, name, vertices, triangles, frames and fps (after dropping frames), surface (its index),
// turn (rotation with rows right, up, front of the subject), anchor (point on the floor below it), size (length that is 1
// on the stage), centre (3 numbers per frame), low, unit, index (position of each vertex among those of the stream, which
// has one of equal vertices; null: it has all) and stream (positions, see `Panel`).

/** Decode base64 to bytes. */
export function fromBase64(text) {
  const characters = atob(text);
  const bytes = new Uint8Array(characters.length);
  for (let k = 0; k < characters.length; k++) bytes[k] = characters.charCodeAt(k);
  return bytes;
}

/** Decompress bytes in zlib format. */
export async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Decode the output of `mimesh.view.encoding.pack_array` to a flat Uint32Array or Float32Array. */
export async function unpack(packed) {
  const planes = await inflate(fromBase64(packed.data));
  const count = planes.length / 4;
  const values = new Uint32Array(count);
  for (let k = 0; k < count; k++) {
    values[k] = planes[k] | (planes[count + k] << 8) | (planes[2 * count + k] << 16) | (planes[3 * count + k] << 24);
  }
  // Integers are zigzag-coded differences: 0, -1, 1, -2, ... are stored as 0, 1, 2, 3, ...
  if (packed.type === "f32") return new Float32Array(values.buffer);
  for (let k = 0, before = 0; k < count; k++) {
    before = (before + ((values[k] >>> 1) ^ -(values[k] & 1))) >>> 0;
    values[k] = before;
  }
  return values;
}

/** Decode a packed scene. */
export async function decodeScene(packed) {
  if (packed.format !== "mimesh-scene" || packed.version !== 1) {
    throw new Error(`expected a mimesh-scene of version 1, found ${packed.format} ${packed.version}`);
  }
  const surfaces = await Promise.all(packed.surfaces.map(decodeSurface));
  const panels = await Promise.all(packed.panels.map((panel) => Panel.decode(panel)));
  const images = packed.images.map(({ type, data }) => ({ type, bytes: fromBase64(data) }));
  const duration = Math.max(...panels.map((panel) => panel.duration));
  return { ...packed, surfaces, panels, images, duration };
}

async function decodeSurface({ corners, origin, smooth, uv, colors, groups }) {
  const optional = (array) => (array ? unpack(array) : null);
  const [c, o, s, u, v] = await Promise.all([unpack(corners), unpack(origin), unpack(smooth), optional(uv), optional(colors)]);
  return { corners: c, origin: o, smooth: s, uv: u, colors: v, groups, smoothCount: s.reduce((a, b) => Math.max(a, b), -1) + 1 };
}

/** A clip in one panel: 16-bit positions of every frame, as planes x, y, z. */
export class Panel {
  static async decode(packed) {
    const bytes = await inflate(fromBase64(packed.stream));
    if (!packed.index) return new Panel(packed, decodeFrames(bytes, packed.vertices));
    const index = await unpack(packed.index);
    const count = bytes.length / 6 / packed.frames;
    return new Panel(packed, expand(decodeFrames(bytes, count), count, index));
  }

  constructor(packed, frames) {
    Object.assign(this, packed);
    this.stream = null;
    this.data = frames;
  }

  /** Seconds from the first frame to the last. */
  get duration() {
    return (this.frames - 1) / this.fps;
  }

  /** Write the points (3 V: x, y, z, x ...) at a time, relative to the anchor, in the file's axes; linear in time. */
  sample(seconds, out) {
    if (this.fixedPose) return this.writeFixedPose(out);
    const at = Math.min(Math.max(seconds * this.fps, 0), this.frames - 1);
    const frame = Math.min(Math.floor(at), Math.max(this.frames - 2, 0));
    const share = at - frame;
    const next = Math.min(frame + 1, this.frames - 1);
    const count = this.vertices;
    const { data, unit } = this;
    for (let axis = 0; axis < 3; axis++) {
      const [a, b] = [this.centre[3 * frame + axis], this.centre[3 * next + axis]];
      const offset = a + (b - a) * share + this.low[axis] - this.anchor[axis];
      const first = (3 * frame + axis) * count;
      const second = (3 * next + axis) * count;
      for (let k = 0, o = axis; k < count; k++, o += 3) {
        const q = data[first + k];
        out[o] = offset + unit * (q + (data[second + k] - q) * share);
      }
    }
    return out;
  }

  /** Show these points (3 V: x, y, z, x ..., in the file's coordinates) at all times; null for the clip again. */
  setFixedPose(points) {
    this.fixedPose = points;
    if (points) this.fixedCentre = [0, 1, 2].map((axis) => mean(points, axis));
  }

  writeFixedPose(out) {
    for (let k = 0; k < out.length; k++) out[k] = this.fixedPose[k] - this.anchor[k % 3];
    return out;
  }

  /** Write the offset of the centroid at a time from that of the first frame, into a vector of three. */
  travel(seconds, out) {
    if (this.fixedPose) return Object.assign(out, this.fixedCentre.map((at, axis) => at - this.centre[axis]));
    const at = Math.min(Math.max(seconds * this.fps, 0), this.frames - 1);
    const frame = Math.floor(at);
    const next = Math.min(frame + 1, this.frames - 1);
    for (let axis = 0; axis < 3; axis++) {
      const [a, b] = [this.centre[3 * frame + axis], this.centre[3 * next + axis]];
      out[axis] = a + (b - a) * (at - frame) - this.centre[axis];
    }
    return out;
  }
}

/** Mean of one coordinate (0, 1, 2) of points: the centroid, as in a packed frame. */
function mean(points, axis) {
  let sum = 0;
  for (let k = axis; k < points.length; k += 3) sum += points[k];
  return (3 * sum) / points.length;
}

/** Copy planes of `count` numbers to planes of one number for each vertex. */
function expand(values, count, index) {
  const planes = values.length / count;
  const out = new Uint16Array(planes * index.length);
  for (let plane = 0; plane < planes; plane++) {
    for (let k = 0; k < index.length; k++) out[plane * index.length + k] = values[plane * count + index[k]];
  }
  return out;
}

/**
 * Decode frames of 16-bit numbers. A frame has all low bytes, then all high bytes, of zigzag differences to the frame
 * before; the first frame, to the number before.
 */
function decodeFrames(bytes, vertices) {
  const count = 3 * vertices;
  const values = new Uint16Array(bytes.length / 2);
  for (let frame = 0; frame * count < values.length; frame++) {
    const base = frame * count;
    for (let k = 0; k < count; k++) {
      const coded = bytes[2 * base + k] | (bytes[2 * base + count + k] << 8);
      const before = frame ? values[base + k - count] : k ? values[k - 1] : 0;
      values[base + k] = before + ((coded >>> 1) ^ -(coded & 1));
    }
  }
  return values;
}
