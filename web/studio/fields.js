// Form fields and lists of the side panel.
import { make } from "./player.js";

/** Add a labelled field with a tooltip to a grid; returns the field. */
export function field(grid, label, control, help) {
  control.id ||= `field-${label.toLowerCase().replaceAll(/\W+/g, "-")}-${Math.random().toString(36).slice(2, 7)}`;
  const caption = make("label", "", { textContent: label, htmlFor: control.id });
  grid.append(caption, control.closest(".with") ?? control);
  Object.assign(control, { caption, help });
  control.title = caption.title = help;
  return control;
}

/** Make a select; options are [value, text, disabled] lists. */
export function choice(options, changed) {
  const select = make("select", "");
  fill(select, options);
  select.addEventListener("change", () => changed(select.value));
  return select;
}

/** Replace the options of a select if they differ, and keep its value if it is still offered. */
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

/** Make a checkbox. */
export function checkbox(changed) {
  const box = make("input", "", { type: "checkbox" });
  box.addEventListener("change", () => changed(box.checked));
  return box;
}

/** Show a value, unless the user is editing the field. */
export function showValue(control, value) {
  if (control === document.activeElement && control.type !== "checkbox" && control.tagName !== "SELECT") return;
  if (control.type === "checkbox") control.checked = value;
  else control.value = value;
}

/** Enable or disable a field and its label; `reason` is added to the tooltip if disabled. */
export function setEnabled(control, on, reason) {
  control.disabled = !on;
  control.caption.classList.toggle("off", !on);
  control.title = control.caption.title = on ? control.help : `${control.help}. ${reason}`;
}

/** Show or hide a field with its label. */
export function setShown(control, on) {
  control.hidden = control.caption.hidden = !on;
}

/** Show a text, or hide the element if it is empty. */
export function showText(element, text) {
  if (element.textContent !== text) element.textContent = text;
  element.hidden = !text;
}

/** Show an error beside what it is about, and scroll there if it is new. */
export function showError(element, text) {
  const fresh = text && element.textContent !== text;
  showText(element, text);
  if (fresh) (element.closest(".row") ?? element).scrollIntoView({ block: "nearest" });
}

/**
 * Show one row of a list for each entry of an array. Rows are found again by the entry's number, so that open details
 * and the focus stay; `build(row, entry)` fills a new row and returns the function that shows later states.
 */
export function updateList(list, entries, build) {
  const rows = new Map([...list.children].map((row) => [Number(row.dataset.number), row]));
  for (const entry of entries) {
    let row = rows.get(entry.number);
    if (!row) {
      row = make("li", "row");
      row.dataset.number = entry.number;
      row.show = build(row, entry);
      list.append(row);
    }
    rows.delete(entry.number);
    row.show(entry);
  }
  for (const row of rows.values()) row.remove();
}

/** Format a size. */
export function formatBytes(bytes) {
  return bytes < 2 ** 20 ? `${Math.max(1, Math.round(bytes / 1024))} KiB` : `${(bytes / 2 ** 20).toFixed(1)} MiB`;
}
