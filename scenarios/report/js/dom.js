/* Elements of the page. Names are the user's: they enter it as text nodes and attributes, never as markup. */
export const $ = (id) => document.getElementById(id);
export const all = (selector, root = document) => [...root.querySelectorAll(selector)];
export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const NAMESPACE = new DOMParser().parseFromString("<svg></svg>", "text/html").querySelector("svg").namespaceURI;
const SVG = new Set(["svg", "g", "line", "text", "title", "circle", "path", "polygon", "polyline"]);
export function node(tag, attributes = {}, ...children) {
  const made = SVG.has(tag) ? document.createElementNS(NAMESPACE, tag) : document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}
