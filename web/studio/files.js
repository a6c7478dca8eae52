// Files that are dropped or chosen, as {file, name}; folders keep the paths below them.

/** The files of an <input type="file">, of a folder with their paths. */
export function chosen(input) {
  return [...input.files].map((file) => ({ file, name: file.webkitRelativePath || file.name }));
}

/** The files of a drop, with those in its folders. */
export async function dropped(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.length) return [...transfer.files].map((file) => ({ file, name: file.name }));
  return (await Promise.all(entries.map((entry) => below(entry, "")))).flat();
}

async function below(entry, path) {
  const name = path + entry.name;
  if (entry.isFile) {
    const file = await new Promise((done, fail) => entry.file(done, fail));
    return [{ file, name }];
  }
  const found = [];
  const reader = entry.createReader();
  for (;;) {
    // A reader gives a hundred entries at a time.
    const some = await new Promise((done, fail) => reader.readEntries(done, fail));
    if (!some.length) return found;
    for (const each of some) found.push(...(await below(each, `${name}/`)));
  }
}

/** Show where files can be dropped while some are dragged over the window; `take(role, files)` gets them. */
export function acceptDrops(overlay, take) {
  const carries = (event) => event.dataTransfer?.types.includes("Files");
  let depth = 0;
  const show = (on) => {
    depth = on ? depth : 0;
    overlay.hidden = !on;
    for (const target of overlay.children) target.classList.remove("over");
  };
  addEventListener("dragenter", (event) => {
    if (!carries(event)) return;
    depth += 1;
    if (overlay.hidden) show(true);
  });
  addEventListener("dragleave", () => {
    depth -= 1;
    if (depth <= 0) show(false);
  });
  addEventListener("dragover", (event) => {
    if (!carries(event)) return;
    event.preventDefault();
    for (const target of overlay.children) target.classList.toggle("over", target.contains(event.target));
  });
  addEventListener("drop", async (event) => {
    if (!carries(event)) return;
    event.preventDefault();
    const target = event.target.closest?.("[data-role]");
    show(false);
    if (target) take(target.dataset.role, await dropped(event.dataTransfer));
  });
}
