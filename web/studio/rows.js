// Rows of the side panel: meshes to move, the driving clip, and exports.
import { make } from "./player.js";
import { choice, field, fill, formatBytes, setShown, showError, showValue } from "./fields.js";

const BODIES = { human: " as a person", quadruped: " as a four-legged animal", other: " as a creature", copied: " key by key" };
const quantity = (number, unit) => `${number.toLocaleString("en")} ${unit}`;

/** Add the head of a row: a name and a button to remove it. */
function head(row, name, label, removed) {
  const box = row.appendChild(make("div", "row-head"));
  const title = box.appendChild(make("b", "", { textContent: name, title: name }));
  const cross = box.appendChild(make("button", "icon", { type: "button", textContent: "×" }));
  cross.setAttribute("aria-label", label);
  cross.title = label;
  cross.addEventListener("click", removed);
  return { box, title };
}

/** Build the row of a mesh or clip; returns the function that shows its state. `act` has change, remove and stop. */
export function meshRow(row, mesh, act) {
  head(row, mesh.name, `Remove ${mesh.name}`, () => act.remove(mesh.number));
  const facts = row.appendChild(make("small", ""));
  const bar = row.appendChild(make("progress", "", { max: 1, hidden: true }));
  bar.setAttribute("aria-label", `Progress of ${mesh.name}`);
  const stop = row.appendChild(make("button", "plain stop", { type: "button", textContent: "Stop", hidden: true }));
  stop.title = `Stop moving ${mesh.name}; the result before stays`;
  stop.addEventListener("click", () => act.stop(mesh.number));
  const error = row.appendChild(make("p", "error", { hidden: true }));
  const notes = row.appendChild(make("div", ""));
  const showFacing = addFacing(row, mesh, act);
  return (now) => {
    const outcome = now.outcome;
    row.dataset.state = now.state === "ready" && outcome ? outcome.state : now.state;
    facts.textContent = factsOf(now);
    showProgress(bar, now);
    stop.hidden = outcome?.state !== "moving" || outcome.done === 0 || outcome.done > 0.98;
    showError(error, now.error || outcome?.error || "");
    const lines = [...correctionLines(now), ...(now.notes ?? []), ...(outcome?.notes ?? [])];
    const text = lines.join("\n");
    if (notes.dataset.text !== text) {
      notes.dataset.text = text;
      notes.replaceChildren(...lines.map((note) => make("p", "note", { textContent: note })));
    }
    showFacing(now);
  };
}

/** Say which joints are corrected, and why those of the file beside it are not. */
function correctionLines({ joints }) {
  const names = Object.keys(joints?.corrected ?? {});
  const which = names.length > 4 ? `${names.length} joints` : names.join(", ");
  return [...(names.length ? [`Corrected by hand: ${which}`] : []), ...(joints?.error ? [joints.error] : [])];
}

/** Say how sure the match of joints or of marks is, where one was made. */
function sureness({ confidence }) {
  return confidence === null ? "" : ` (confidence ${confidence.toFixed(2)})`;
}

function factsOf({ state, vertices, triangles, frames, fps, outcome, uploading }) {
  if (uploading !== undefined) return `uploading ${Math.round(100 * uploading)} %`;
  if (state === "reading") return "reading …";
  if (state === "failed") return "";
  const parts = [triangles ? quantity(vertices, "vertices") : quantity(vertices, "points, no faces")];
  if (frames > 1) parts.push(`${quantity(frames, "frames")}, ${+fps.toFixed(2)} per second`);
  if (frames === 1) parts.push("a pose");
  if (outcome?.state === "done") parts.push(`moved${BODIES[outcome.body] ?? ""}${sureness(outcome)} in ${outcome.seconds.toFixed(outcome.seconds < 10 ? 2 : 0)} s`);
  if (outcome?.state === "stopped") parts.push("stopped");
  return parts.join(" · ");
}

function showProgress(bar, { state, outcome, uploading }) {
  bar.hidden = uploading === undefined && state !== "reading" && outcome?.state !== "moving";
  const done = uploading ?? outcome?.done ?? 0;
  if (state === "reading" || !done) bar.removeAttribute("value");
  else bar.value = done;
}

/** Add fields for facing and part of a mesh, animation and frame rate of a clip; returns what shows their state. */
function addFacing(row, mesh, act) {
  const box = row.appendChild(make("details", ""));
  const summary = box.appendChild(make("summary", "", { title: "Correct which way the mesh faces, and choose what of it is meant" }));
  const grid = box.appendChild(make("div", "fields"));
  const change = (name) => (value) => act.change(mesh.number, { [name]: value || null });
  const axes = ["+x", "+y", "+z", "-x", "-y", "-z"];
  const options = (axis) => [["", axis ? `detected: ${axis}` : "detected"], ...axes.map((name) => [name, name])];
  const up = field(grid, "Up", choice(options(), change("up")), "Axis of the file that points up");
  const front = field(grid, "Front", choice(options(), change("front")), "Axis of the file that the mesh faces");
  const part = field(grid, "Part", choice([], change("part")), "Object, group or node of the file that is meant; all else stays where it is");
  const animation = field(grid, "Animation", choice([], change("animation")), "Which animation of the file drives");
  const rate = make("input", "", { type: "number", min: 1, max: 1000, step: "any" });
  const fps = field(grid, "Frames per second", rate, "Frame rate of the clip, instead of that of its file");
  fps.addEventListener("change", () => act.change(mesh.number, { fps: fps.value ? Number(fps.value) : null }));
  return (now) => {
    const ready = now.state === "ready";
    box.hidden = !ready;
    if (!ready) return;
    const unsure = now.facing.unsure;
    box.classList.toggle("unsure", unsure);
    if (unsure && !box.dataset.opened) box.open = Boolean((box.dataset.opened = "yes"));
    summary.textContent = `${unsure ? "Facing is uncertain: " : "Faces "}${now.facing.front}, up ${now.facing.up}`;
    fill(up, options(now.up ? "" : now.facing.up));
    fill(front, options(now.front ? "" : now.facing.front));
    showValue(up, now.up ?? "");
    showValue(front, now.front ?? "");
    setShown(part, now.parts.length > 0);
    fill(part, [["", "automatic"], ...now.parts.map((name) => [name, name])]);
    showValue(part, now.part ?? "");
    setShown(animation, now.animations.length > 1);
    fill(animation, [["", "the first"], ...now.animations.map((name) => [name, name])]);
    showValue(animation, now.animation ?? "");
    setShown(fps, now.frames > 1 && !now.shipped);
    fps.placeholder = `${+now.fps.toFixed(3)}`;
    showValue(fps, now.given_fps ?? "");
  };
}

/** Build the row of an export, a link once it is written; returns the function that shows its state. */
export function exportRow(row, entry, act) {
  const { box, title } = head(row, entry.suffix, "Remove this export", () => act.removeExport(entry.number));
  const link = make("a", "get", { href: `/api/exports/${entry.number}`, hidden: true, title: "Download this file again" });
  box.insertBefore(link, title);
  const bar = row.appendChild(make("progress", "", { max: 1 }));
  bar.setAttribute("aria-label", "Progress of this export");
  const error = row.appendChild(make("p", "error", { hidden: true }));
  const notes = row.appendChild(make("div", ""));
  return (now) => {
    row.dataset.state = now.state;
    title.hidden = now.state === "ready";
    title.textContent = now.state === "writing" ? `writing ${now.suffix} …` : now.suffix;
    link.hidden = now.state !== "ready";
    link.download = now.name;
    link.textContent = `${now.name} (${formatBytes(now.bytes)})`;
    bar.hidden = now.state !== "writing";
    if (now.done) bar.value = now.done;
    showError(error, now.error);
    if (notes.childElementCount !== now.notes.length) {
      notes.replaceChildren(...now.notes.map((note) => make("p", "note", { textContent: note })));
    }
    if (now.state === "ready" && act.takeDownload(now.number)) link.click();
  };
}
