// Reads what `mimesh.view.scene.pack_scene` packed. No three.js here: plain arrays in, plain arrays out.
//
// decodeScene(packed) -> Promise<Scene>
//   Scene: { title, model, notes[], left_out[], panels: Panel[], surfaces: Surface[], images: [{type, bytes}], duration }
//   Panel: what is shown in one panel; panel.sample(seconds, out) writes its points at a time.
//   Surface: { corners (3 F), origin (R), smooth (R), uv (2 R) | null, colors (4 V) | null, groups: [{start, stop,
//     material: {color: [r, g, b, a] linear, image: number | null} | null}], smoothCount }
//     corners: render vertex of each face corner; origin: its vertex; smooth: render vertices with one number share a
//     normal; groups: runs of faces with one material.
//
// Packed fields of a panel: role, name, vertices, triangles, frames and fps (of what is here), surface (its number),
// turn (rows right, up, front of the subject), anchor (where it stands), size (what is 1 on the stage), centre (3 numbers
// a frame), low, unit and stream (positions, see `Panel`).

/** Bytes of a base64 text. */
export function fromBase64(text) {
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let k = 0; k < letters.length; k++) bytes[k] = letters.charCodeAt(k);
  return bytes;
}

/** Bytes that zlib deflated, as they were. */
export async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** An array that `mimesh.view.stream.packed` packed: a Uint32Array or a Float32Array, flat. */
export async function unpack(packed) {
  const planes = await inflate(fromBase64(packed.data));
  const count = planes.length / 4;
  const values = new Uint32Array(count);
  for (let k = 0; k < count; k++) {
    values[k] = planes[k] | (planes[count + k] << 8) | (planes[2 * count + k] << 16) | (planes[3 * count + k] << 24);
  }
  if (packed.type === "f32") return new Float32Array(values.buffer);
  for (let k = 0, before = 0; k < count; k++) {
    before = (before + ((values[k] >>> 1) ^ -(values[k] & 1))) >>> 0;
    values[k] = before;
  }
  return values;
}

/** Everything in a packed scene, decoded. */
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
  const some = (array) => (array ? unpack(array) : null);
  const [c, o, s, u, v] = await Promise.all([unpack(corners), unpack(origin), unpack(smooth), some(uv), some(colors)]);
  return { corners: c, origin: o, smooth: s, uv: u, colors: v, groups, smoothCount: s.reduce((a, b) => Math.max(a, b), -1) + 1 };
}

/** A clip in one panel: 16-bit positions of every frame, as planes x, y, z. */
export class Panel {
  static async decode(packed) {
    return new Panel(packed, decodeFrames(await inflate(fromBase64(packed.stream)), packed.vertices));
  }

  constructor(packed, frames) {
    Object.assign(this, packed);
    this.stream = null;
    this.data = frames;
  }

  /** Seconds from the first frame that is here to the last. */
  get duration() {
    return (this.frames - 1) / this.fps;
  }

  /** Write the points (3 V: x, y, z, x ...) at a time, relative to the anchor, in the file's axes and unit. */
  sample(seconds, out) {
    if (this.held) return this.writeHeld(out);
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

  /** Show these points (3 V: x, y, z, x ..., as the file has them) at all times, until null is held. */
  hold(points) {
    this.held = points;
    if (points) this.heldMiddle = [0, 1, 2].map((axis) => mean(points, axis));
  }

  writeHeld(out) {
    for (let k = 0; k < out.length; k++) out[k] = this.held[k] - this.anchor[k % 3];
    return out;
  }

  /** Write the middle of the points at a time, relative to the first frame's, into a vector of three. */
  travel(seconds, out) {
    if (this.held) return Object.assign(out, this.heldMiddle.map((at, axis) => at - this.centre[axis]));
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

/** Mean of every third number: the middle that a packed frame has, too. */
function mean(points, axis) {
  let sum = 0;
  for (let k = axis; k < points.length; k += 3) sum += points[k];
  return (3 * sum) / points.length;
}

/** Frames of 16-bit numbers: low bytes, high bytes; differences from the frame before (the first: from its neighbour). */
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
