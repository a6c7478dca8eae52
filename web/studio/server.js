// Requests to the server. Every function throws an Error with the server's message.
const JSON_TYPE = { "content-type": "application/json" };
const LOST = "The studio does not respond: it has ended, or the computer was asleep. Start it again with mimesh studio.";

/** Send an object as JSON and return that of the response; null if it was cancelled. */
export async function call(method, path, body) {
  const response = await send(method, path, body === undefined ? undefined : JSON.stringify(body));
  return response.status === 204 ? null : response.json();
}

/** Fetch positions of a mesh in one frame, as a Float32Array; null if it was cancelled: by a newer request or a removal. */
export async function fetchPose(number, frame, signal) {
  const response = await fetch(`/api/meshes/${number}/pose`, {
    method: "POST", headers: JSON_TYPE, body: JSON.stringify({ frame }), signal,
  });
  return response.status === 200 ? new Float32Array(await response.arrayBuffer()) : null;
}

async function send(method, path, body) {
  let response;
  try {
    response = await fetch(path, { method, headers: body === undefined ? {} : JSON_TYPE, body });
  } catch {
    throw new Error(LOST);
  }
  if (!response.ok) throw new Error(await messageOf(response));
  return response;
}

/** Read the error message of a response. */
async function messageOf(response) {
  const text = await response.text();
  if (response.headers.get("content-type")?.startsWith("application/json")) return JSON.parse(text).error;
  return text.trim() || `The studio responded with status ${response.status}.`;
}

/** Call `update` with the state, now and after every change (long polling), and `lost` if there is no response. */
export async function watchState(update, lost) {
  let version = "";
  for (;;) {
    let state;
    try {
      state = await call("GET", `/api/state?since=${version}`);
    } catch (error) {
      lost(error.message);
      version = ""; // the next response comes at once, so that the message goes
      await new Promise((done) => setTimeout(done, 1500));
      continue;
    }
    version = state.version;
    update(state);
  }
}

/** Upload files ({file, name} each) that belong together, for a role; `report` is called with the sent share. */
export async function upload(role, files, limit, report) {
  const large = files.find(({ file }) => file.size > limit);
  if (large) {
    const [found, allowed] = [large.file.size, limit].map((bytes) => Math.round(bytes / 2 ** 20).toLocaleString("en"));
    throw new Error(`${large.name}: expected ${allowed} MiB or less, found ${found}; start mimesh studio with a larger --limit`);
  }
  const { upload: number } = await call("POST", "/api/uploads");
  const total = files.reduce((sum, { file }) => sum + file.size, 0) || 1;
  let sent = 0;
  try {
    for (const { file, name } of files) {
      await put(`/api/uploads/${number}?name=${encodeURIComponent(name)}`, file, (done) => report((sent + done) / total));
      sent += file.size;
    }
    return await call("POST", `/api/uploads/${number}/${role}`);
  } catch (error) {
    await call("DELETE", `/api/uploads/${number}`).catch(() => {});
    throw error;
  }
}

/** Send a file with XMLHttpRequest, since fetch does not report upload progress. */
function put(path, file, report) {
  return new Promise((done, fail) => {
    const request = new XMLHttpRequest();
    request.open("PUT", path);
    request.upload.addEventListener("progress", (event) => report(event.loaded));
    request.addEventListener("error", () => fail(new Error(`${file.name}: the upload was interrupted; send it again`)));
    request.addEventListener("load", () => {
      if (request.status < 300) return done();
      const json = request.getResponseHeader("content-type")?.startsWith("application/json");
      fail(new Error(json ? JSON.parse(request.responseText).error : request.responseText.trim()));
    });
    request.send(file);
  });
}
