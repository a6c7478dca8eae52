// Dropped or chosen files as {file, name}; names of files in folders are their paths.

/** List the files of an <input type="file">. */
export function chosenFiles(input) {
  return [...input.files].map((file) => ({ file, name: file.webkitRelativePath || file.name }));
}

/** List the files of a drop, with those in its folders. */
export async function droppedFiles(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.length) return [...transfer.files].map((file) => ({ file, name: file.name }));
  return (await Promise.all(entries.map((entry) => filesBelow(entry, "")))).flat();
}

async function filesBelow(entry, path) {
  const name = path + entry.name;
  if (entry.isFile) {
    const file = await new Promise((done, fail) => entry.file(done, fail));
    return [{ file, name }];
  }
  const found = [];
  const reader = entry.createReader();
  for (;;) {
    // A reader returns at most a hundred entries per call.
    const batch = await new Promise((done, fail) => reader.readEntries(done, fail));
    if (!batch.length) return found;
    for (const child of batch) found.push(...(await filesBelow(child, `${name}/`)));
  }
}

/** Show drop targets while files are dragged over the window; `take(role, files)` is called with dropped ones. */
export function acceptDrops(overlay, take) {
  const hasFiles = (event) => event.dataTransfer?.types.includes("Files");
  let depth = 0; // enter and leave events fire for every child element, too
  const show = (on) => {
    depth = on ? depth : 0;
    overlay.hidden = !on;
    for (const target of overlay.children) target.classList.remove("over");
  };
  addEventListener("dragenter", (event) => {
    if (!hasFiles(event)) return;
    depth += 1;
    if (overlay.hidden) show(true);
  });
  addEventListener("dragleave", () => {
    depth -= 1;
    if (depth <= 0) show(false);
  });
  addEventListener("dragover", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    for (const target of overlay.children) target.classList.toggle("over", target.contains(event.target));
  });
  addEventListener("drop", async (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    const target = event.target.closest?.("[data-role]");
    show(false);
    if (target) take(target.dataset.role, await droppedFiles(event.dataTransfer));
  });
}
