// What the page says to the server. Every call throws an Error whose message is the server's one line.
const JSON_TYPE = { "content-type": "application/json" };
const LOST = "The studio does not answer: it has ended, or the computer sleeps. Start it again with mimesh studio.";

/** Send a small object and get one back. */
export async function call(method, path, given) {
  const answer = await send(method, path, given === undefined ? undefined : JSON.stringify(given));
  return answer.json();
}

/** Positions of a mesh in one frame, as a Float32Array; null where the wish was dropped for a newer one. */
export async function askPose(number, frame, signal) {
  const response = await fetch(`/api/meshes/${number}/pose`, {
    method: "POST", headers: JSON_TYPE, body: JSON.stringify({ frame }), signal,
  });
  return response.ok ? new Float32Array(await response.arrayBuffer()) : null;
}

async function send(method, path, body) {
  let response;
  try {
    response = await fetch(path, { method, headers: body === undefined ? {} : JSON_TYPE, body });
  } catch {
    throw new Error(LOST);
  }
  if (!response.ok) throw new Error(await wordsOf(response));
  return response;
}

async function wordsOf(response) {
  const text = await response.text();
  if (response.headers.get("content-type")?.startsWith("application/json")) return JSON.parse(text).error;
  return text.trim() || `The studio answered ${response.status}.`;
}

/** Call `seen` with the state, now and after every change, until the page ends; `lost` where there is no answer. */
export async function watch(seen, lost) {
  let version = "";
  for (;;) {
    try {
      const state = await call("GET", `/api/state?since=${version}`);
      version = state.version;
      seen(state);
    } catch (error) {
      lost(error.message);
      await new Promise((done) => setTimeout(done, 1500));
    }
  }
}

/** Upload files ({file, name} each) that belong together, for a role; `told` gets the share that is sent. */
export async function upload(role, files, limit, told) {
  const large = files.find(({ file }) => file.size > limit);
  if (large) {
    const [found, most] = [large.file.size, limit].map((bytes) => Math.round(bytes / 2 ** 20).toLocaleString("en"));
    throw new Error(`${large.name}: expected ${most} MiB or less, found ${found}; start mimesh studio with a larger --limit`);
  }
  const { upload: number } = await call("POST", "/api/uploads");
  const whole = files.reduce((sum, { file }) => sum + file.size, 0) || 1;
  let sent = 0;
  try {
    for (const { file, name } of files) {
      await put(`/api/uploads/${number}?name=${encodeURIComponent(name)}`, file, (done) => told((sent + done) / whole));
      sent += file.size;
    }
    return await call("POST", `/api/uploads/${number}/${role}`);
  } catch (error) {
    await call("DELETE", `/api/uploads/${number}`).catch(() => {});
    throw error;
  }
}

/** XMLHttpRequest, since fetch does not tell how much it has sent. */
function put(path, file, told) {
  return new Promise((done, fail) => {
    const request = new XMLHttpRequest();
    request.open("PUT", path);
    request.upload.addEventListener("progress", (event) => told(event.loaded));
    request.addEventListener("error", () => fail(new Error(`${file.name}: the studio stopped taking it`)));
    request.addEventListener("load", () => {
      if (request.status < 300) return done();
      const json = request.getResponseHeader("content-type")?.startsWith("application/json");
      fail(new Error(json ? JSON.parse(request.responseText).error : request.responseText.trim()));
    });
    request.send(file);
  });
}
