// Content of the page, and elements made by the script.
const content = JSON.parse(document.getElementById("run-content").textContent);
const SVG = "http://www.w3.org/2000/svg";
const PAGE = 20; // charts added at a time
const MARGIN = { left: 46, right: 12, top: 22, bottom: 36 };
const byId = (id) => document.getElementById(id);

function element(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

function shape(name, attributes = {}, text = "") {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text) node.textContent = text;
  return node;
}
