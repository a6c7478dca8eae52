// Rows of the side panel: a mesh to move or what to imitate, and an export.
import { make } from "./player.js";
import { choice, field, fill, megabytes, say, showValue } from "./fields.js";

const count = (number, word) => `${number.toLocaleString("en")} ${word}`;

/** The head of a row: a name and a cross. */
function head(row, name, label, removed) {
  const box = row.appendChild(make("div", "row-head"));
  const title = box.appendChild(make("b", "", { textContent: name, title: name }));
  const cross = box.appendChild(make("button", "icon", { type: "button", textContent: "×" }));
  cross.setAttribute("aria-label", label);
  cross.title = label;
  cross.addEventListener("click", removed);
  return { box, title };
}

/** Build the row of a mesh; the function that is returned shows it as it is. `act` has change, remove and stop. */
export function meshRow(row, mesh, act) {
  head(row, mesh.name, `Remove ${mesh.name}`, () => act.remove(mesh.number));
  const facts = row.appendChild(make("small", ""));
  const bar = row.appendChild(make("progress", "", { max: 1, hidden: true }));
  bar.setAttribute("aria-label", `Progress of ${mesh.name}`);
  const stop = row.appendChild(make("button", "plain stop", { type: "button", textContent: "Stop", hidden: true }));
  stop.addEventListener("click", () => act.stop(mesh.number));
  const error = row.appendChild(make("p", "error", { hidden: true }));
  error.setAttribute("role", "alert");
  const notes = row.appendChild(make("div", ""));
  const more = facing(row, mesh, act);
  return (now) => {
    const made = now.outcome;
    row.dataset.state = now.state === "ready" && made ? made.state : now.state;
    facts.textContent = factsOf(now);
    showProgress(bar, now);
    stop.hidden = made?.state !== "moving" || made.done === 0 || made.done > 0.98;
    say(error, now.error || made?.error || "");
    const words = (made?.notes ?? []).join("\n");
    if (notes.dataset.words !== words) {
      notes.dataset.words = words;
      notes.replaceChildren(...(made?.notes ?? []).map((note) => make("p", "note", { textContent: note })));
    }
    more(now);
  };
}

function factsOf({ state, vertices, triangles, frames, fps, outcome, uploading }) {
  if (uploading !== undefined) return `uploading ${Math.round(100 * uploading)} %`;
  if (state === "reading") return "reading …";
  if (state === "failed") return "";
  const parts = [triangles ? count(vertices, "vertices") : count(vertices, "points, no faces")];
  if (frames > 1) parts.push(`${count(frames, "frames")}, ${+fps.toFixed(2)} a second`);
  if (frames === 1) parts.push("a pose");
  if (outcome?.state === "done") parts.push(`moved in ${outcome.seconds.toFixed(outcome.seconds < 10 ? 2 : 0)} s`);
  if (outcome?.state === "stopped") parts.push("stopped");
  return parts.join(" · ");
}

function showProgress(bar, { state, outcome, uploading }) {
  bar.hidden = uploading === undefined && state !== "reading" && outcome?.state !== "moving";
  const done = uploading ?? outcome?.done ?? 0;
  if (state === "reading" || !done) bar.removeAttribute("value");
  else bar.value = done;
}

/** Which way a mesh faces, and animation and frame rate of a clip. */
function facing(row, mesh, act) {
  const box = row.appendChild(make("details", ""));
  const summary = box.appendChild(make("summary", ""));
  const grid = box.appendChild(make("div", "fields"));
  const change = (name) => (value) => act.change(mesh.number, { [name]: value || null });
  const axes = ["+x", "+y", "+z", "-x", "-y", "-z"];
  const found = (axis) => [["", axis ? `found: ${axis}` : "found"], ...axes.map((name) => [name, name])];
  const up = field(grid, "Up", choice(found(), change("up")));
  const front = field(grid, "Front", choice(found(), change("front")));
  const animation = field(grid, "Animation", choice([], change("animation")));
  const fps = field(grid, "Frames a second", make("input", "", { type: "number", min: 1, max: 1000, step: "any" }));
  fps.addEventListener("change", () => act.change(mesh.number, { fps: fps.value ? Number(fps.value) : null }));
  return (now) => {
    const ready = now.state === "ready";
    box.hidden = !ready;
    if (!ready) return;
    const unsure = now.facing.unsure;
    box.classList.toggle("unsure", unsure);
    if (unsure && !box.dataset.opened) box.open = Boolean((box.dataset.opened = "yes"));
    summary.textContent = `${unsure ? "Facing is uncertain: " : "Faces "}${now.facing.front}, up ${now.facing.up}`;
    fill(up, found(now.up ? "" : now.facing.up));
    fill(front, found(now.front ? "" : now.facing.front));
    showValue(up, now.up ?? "");
    showValue(front, now.front ?? "");
    animation.hidden = animation.words.hidden = now.animations.length < 2;
    fill(animation, [["", "the first"], ...now.animations.map((name) => [name, name])]);
    showValue(animation, now.animation ?? "");
    fps.hidden = fps.words.hidden = !(now.frames > 1) || now.shipped;
    fps.placeholder = `${+now.fps.toFixed(3)}`;
    showValue(fps, now.given_fps ?? "");
  };
}

/** Build the row of an export; a link once it is written. */
export function exportRow(row, made, act) {
  const { box, title } = head(row, made.suffix, "Remove this export", () => act.removeExport(made.number));
  const link = make("a", "get", { href: `/api/exports/${made.number}`, hidden: true });
  box.insertBefore(link, title);
  const bar = row.appendChild(make("progress", "", { max: 1 }));
  const error = row.appendChild(make("p", "error", { hidden: true }));
  error.setAttribute("role", "alert");
  const notes = row.appendChild(make("div", ""));
  return (now) => {
    row.dataset.state = now.state;
    title.hidden = now.state === "ready";
    title.textContent = now.state === "writing" ? `writing ${now.suffix} …` : now.suffix;
    link.hidden = now.state !== "ready";
    link.download = now.name;
    link.textContent = `${now.name} (${megabytes(now.bytes)})`;
    bar.hidden = now.state !== "writing";
    if (now.done) bar.value = now.done;
    say(error, now.error);
    if (notes.childElementCount !== now.notes.length) {
      notes.replaceChildren(...now.notes.map((note) => make("p", "note", { textContent: note })));
    }
    if (now.state === "ready" && act.takeOnce(now.number)) link.click();
  };
}
