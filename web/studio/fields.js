// Small pieces of the side panel.
import { make } from "./player.js";

/** A labelled field in a grid; returns the field. */
export function field(grid, label, control) {
  control.id ||= `field-${label.toLowerCase().replaceAll(/\W+/g, "-")}-${Math.random().toString(36).slice(2, 7)}`;
  const words = make("label", "", { textContent: label, htmlFor: control.id });
  grid.append(words, control.closest(".with") ?? control);
  control.words = words;
  return control;
}

/** A choice; options are [value, words] pairs. */
export function choice(options, changed) {
  const select = make("select", "");
  fill(select, options);
  select.addEventListener("change", () => changed(select.value));
  return select;
}

/** Give a choice other options, if they are others, and keep what was chosen. */
export function fill(select, options) {
  const key = JSON.stringify(options);
  if (select.dataset.key === key) return;
  const { value } = select;
  select.dataset.key = key;
  select.replaceChildren(...options.map(([value, textContent, disabled]) => {
    return Object.assign(document.createElement("option"), { value, textContent, disabled: Boolean(disabled) });
  }));
  if (options.some((option) => option[0] === value)) select.value = value;
}

export function checkbox(changed) {
  const box = make("input", "", { type: "checkbox" });
  box.addEventListener("change", () => changed(box.checked));
  return box;
}

/** Show a value unless the user is just changing it. */
export function showValue(control, value) {
  if (control === document.activeElement && control.type !== "checkbox" && control.tagName !== "SELECT") return;
  if (control.type === "checkbox") control.checked = value;
  else control.value = value;
}

/** Switch a field and its label on or off; `why` is said where it is off. */
export function allow(control, on, why = "") {
  control.disabled = !on;
  control.words.classList.toggle("off", !on);
  control.title = control.words.title = on ? "" : why;
}

/** Show words, or nothing. */
export function say(element, words) {
  if (element.textContent !== words) element.textContent = words;
  element.hidden = !words;
}

/** Keep one child of a list for each thing of an array, known by its number. */
export function keep(list, things, build) {
  const rows = new Map([...list.children].map((row) => [Number(row.dataset.number), row]));
  for (const thing of things) {
    let row = rows.get(thing.number);
    if (!row) {
      row = make("li", "row");
      row.dataset.number = thing.number;
      row.show = build(row, thing);
      list.append(row);
    }
    rows.delete(thing.number);
    row.show(thing);
  }
  for (const row of rows.values()) row.remove();
}

export function megabytes(bytes) {
  return bytes < 2 ** 20 ? `${Math.max(1, Math.round(bytes / 1024))} KiB` : `${(bytes / 2 ** 20).toFixed(1)} MiB`;
}
