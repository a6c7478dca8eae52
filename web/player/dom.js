/** Create an element with a class and properties. */
export function make(tag, className, properties = {}) {
  return Object.assign(document.createElement(tag), { className, ...properties });
}
