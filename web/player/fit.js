// Fits the camera so that every frame of every panel is completely visible and as large as possible.
import { MathUtils, Vector3 } from "three";

/** Degrees about the up axis; 0 looks at the front. */
const AZIMUTH = -30;
/** Degrees above the horizon. */
const ELEVATION = 10;
/** Share of the picture that the subject may fill. */
const FILL = 0.86;
/** Frames and points per frame that stand for a clip, evenly spaced. */
const FRAMES = 8;
const POINTS = 600;

/**
 * Place camera and orbit target; `aspect` is that of a panel, `follow` removes the subject's travel along the floor.
 * For each point, |x| <= slope * aspect * (distance - z) and |y| <= slope * (distance - z) give the least distance.
 */
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
  const slope = Math.tan(MathUtils.degToRad(camera.fov / 2)) * FILL;
  let distance = 0;
  for (const point of points) {
    const offset = point.clone().sub(target);
    const [x, y, z] = [Math.abs(offset.dot(right)), Math.abs(offset.dot(up)), offset.dot(back)];
    distance = Math.max(distance, x / (slope * aspect) + z, y / slope + z);
  }
  orbit.target.copy(target);
  camera.position.copy(target).addScaledVector(back, distance);
  orbit.update();
}

/** Sample points of a panel's frames, in stage coordinates. */
function stagePoints(panel, follow) {
  const [a, b, c, d, e, f, g, h, i] = panel.turn.map((x) => x / panel.size);
  const values = new Float32Array(3 * panel.vertices);
  const stride = 3 * Math.max(1, Math.floor(panel.vertices / POINTS));
  const count = Math.min(panel.frames, FRAMES);
  const points = [];
  for (let k = 0; k < count; k++) {
    const time = (k / Math.max(count - 1, 1)) * panel.duration;
    panel.sample(time, values);
    const [u, v, w] = panel.travel(time, [0, 0, 0]);
    const travel = follow ? new Vector3(a * u + b * v + c * w, 0, g * u + h * v + i * w) : null;
    for (let p = 0; p < values.length; p += stride) {
      const [x, y, z] = [values[p], values[p + 1], values[p + 2]];
      const point = new Vector3(a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z);
      points.push(travel ? point.sub(travel) : point);
    }
  }
  return points;
}
