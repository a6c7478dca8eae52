// Puts the camera where every frame of every panel is seen whole, and as large as that allows.
import { MathUtils, Vector3 } from "three";

/** Degrees: a little from the side, a little from above. */
const AZIMUTH = -30;
const ELEVATION = 10;
const MARGIN = 0.86;
const FRAMES = 8;
const POINTS = 600;

export function fitView(camera, orbit, panels, follow, aspect) {
  const points = panels.flatMap((panel) => stagePoints(panel, follow));
  const [low, high] = [new Vector3(Infinity, Infinity, Infinity), new Vector3(-Infinity, -Infinity, -Infinity)];
  for (const point of points) {
    low.min(point);
    high.max(point);
  }
  const target = low.clone().add(high).multiplyScalar(0.5);
  const [azimuth, elevation] = [MathUtils.degToRad(AZIMUTH), MathUtils.degToRad(ELEVATION)];
  const back = new Vector3(Math.sin(azimuth) * Math.cos(elevation), Math.sin(elevation), Math.cos(azimuth) * Math.cos(elevation));
  const right = new Vector3(Math.cos(azimuth), 0, -Math.sin(azimuth));
  const up = new Vector3().crossVectors(back, right);
  const slope = Math.tan(MathUtils.degToRad(camera.fov / 2)) * MARGIN;
  let distance = 0;
  for (const point of points) {
    const away = point.clone().sub(target);
    const [x, y, z] = [Math.abs(away.dot(right)), Math.abs(away.dot(up)), away.dot(back)];
    distance = Math.max(distance, x / (slope * aspect) + z, y / slope + z);
  }
  orbit.target.copy(target);
  camera.position.copy(target).addScaledVector(back, distance);
  orbit.update();
}

/** Some points of some frames, on the stage. */
function stagePoints(panel, follow) {
  const [a, b, c, d, e, f, g, h, i] = panel.turn.map((x) => x / panel.size);
  const values = new Float32Array(3 * panel.vertices);
  const stride = 3 * Math.max(1, Math.floor(panel.vertices / POINTS));
  const count = Math.min(panel.frames, FRAMES);
  const found = [];
  for (let k = 0; k < count; k++) {
    const time = (k / Math.max(count - 1, 1)) * panel.duration;
    panel.sample(time, values);
    const way = panel.travel(time, [0, 0, 0]);
    const off = follow ? new Vector3(a * way[0] + b * way[1] + c * way[2], 0, g * way[0] + h * way[1] + i * way[2]) : null;
    for (let p = 0; p < values.length; p += stride) {
      const [x, y, z] = [values[p], values[p + 1], values[p + 2]];
      const point = new Vector3(a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z);
      found.push(off ? point.sub(off) : point);
    }
  }
  return found;
}
