// Shows frames of a live stream on a stage: `GET address?after=N` answers with the newest frame once it is another than
// the one with number N. Its number is in the header x-frame, its body the positions of all panels one after the other,
// (x, y, z) of every vertex in the file's coordinates as little-endian float32. 204: nothing new yet, ask again.
//
// The page asks again when a frame is there, so a slow page skips frames and never falls behind.

/** Milliseconds until the server is asked again after it could not be reached. */
const RETRY = 1000;

/** Follow a stream until the page is closed; `told` is called with true when a frame comes, with false when none can. */
export async function followStream(stage, address, told) {
  for (let shown = ""; ; ) {
    try {
      const response = await fetch(`${address}?after=${shown}`);
      if (!response.ok) throw new Error(`the server answered ${response.status}`);
      if (response.status === 204) continue;
      showFrame(stage, new Float32Array(await response.arrayBuffer()));
      shown = response.headers.get("x-frame");
      told(true, shown);
    } catch (error) {
      told(false, error.message);
      await new Promise((done) => setTimeout(done, RETRY));
    }
  }
}

function showFrame(stage, points) {
  const expected = stage.views.reduce((sum, { panel }) => sum + 3 * panel.vertices, 0);
  if (points.length !== expected) throw new Error(`expected ${expected} numbers in a frame, found ${points.length}`);
  let start = 0;
  for (const view of stage.views) {
    const stop = start + 3 * view.panel.vertices;
    stage.setFixedPose(view, points.subarray(start, stop));
    start = stop;
  }
}
