// Elements of the explorables: SVG, photographs, controls, and measured responses.
import { median } from "./algebra.js";

export const COLOURS = {
  camera1: "#0072B2", camera2: "#D55E00", line: "#F0E442", plane: "#56B4E9", epipole: "#CC79A7",
  right: "#009E73", wrong: "#999999", sample: "#E69F00", ink: "#222222",
};

const SVG = "http://www.w3.org/2000/svg";

export function svg(name, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

export function html(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

const points = (x) => x.map((p) => `${p[0].toFixed(3)},${p[1].toFixed(3)}`).join(" ");
const THIN = { "vector-effect": "non-scaling-stroke" };

export const polyline = (x, attributes) =>
  svg("polyline", { points: points(x), fill: "none", ...THIN, ...attributes });
export const polygon = (x, attributes) => svg("polygon", { points: points(x), ...THIN, ...attributes });
export const circle = (x, r, attributes) =>
  svg("circle", { cx: x[0].toFixed(3), cy: x[1].toFixed(3), r, ...THIN, ...attributes });
export const text = (x, words, attributes) => {
  const element = svg("text", { x: x[0].toFixed(1), y: x[1].toFixed(1), ...attributes });
  element.textContent = words;
  return element;
};

// A line with a black casing, visible on any photograph.
export const casedLine = (x, colour, name) => [
  polyline(x, { stroke: "#000000", "stroke-width": 4, "stroke-opacity": 0.7 }),
  polyline(x, { stroke: colour, "stroke-width": 2, class: name }),
];

// A ring with a black casing.
export const ring = (x, r, colour, name) => [
  circle(x, r, { fill: "none", stroke: "#000000", "stroke-width": 5, "stroke-opacity": 0.7 }),
  circle(x, r, { fill: "none", stroke: colour, "stroke-width": 2.5, class: name }),
];

// A picture with an overlay whose user units are the photograph's pixels, and a canvas of as many
// pixels below it. `pressed` gets the pixel of every click and drag and the event.
export function photograph({ size: [w, h], href }, title, pressed) {
  const surface = svg("svg", { viewBox: `-0.5 -0.5 ${w} ${h}`, class: "photograph" });
  const canvas = html("canvas", { width: w, height: h });
  const picture = svg("image", { x: -0.5, y: -0.5, width: w, height: h, preserveAspectRatio: "none" });
  if (href) picture.setAttribute("href", href);
  const overlay = svg("g");
  surface.append(picture, overlay);
  if (pressed) dragging(surface, (event, from) => pressed(pixelOf(surface, event), event, from));
  const caption = html("figcaption", {}, title);
  const box = html("div", { class: "stack" }, canvas, surface);
  return { figure: html("figure", {}, caption, box), canvas, surface, picture, overlay, caption };
}

export function pixelOf(surface, event) {
  const p = new DOMPoint(event.clientX, event.clientY);
  const q = p.matrixTransform(surface.getScreenCTM().inverse());
  return [q.x, q.y];
}

// Call `moved(event, first)` when the pointer is pressed on the element and while it is dragged;
// `first` is the event of the press.
export function dragging(element, moved) {
  let first = null;
  element.addEventListener("pointerdown", (event) => {
    first = event;
    try {
      element.setPointerCapture(event.pointerId);
    } catch {
      // events made by scripts have no active pointer
    }
    event.preventDefault();
    moved(event, first);
  });
  element.addEventListener("pointermove", (event) => first && moved(event, first));
  for (const end of ["pointerup", "pointercancel"])
    element.addEventListener(end, () => { first = null; });
}

// A labelled slider; returns an object whose `set` shows a value without an event.
export function slider({ label, min, max, step, value, unit = "", digits = 1 }, changed) {
  const input = html("input", { type: "range", min, max, step, "aria-label": label });
  const output = html("output");
  const show = (v) => { output.textContent = `${v.toFixed(digits)}${unit}`; };
  const set = (v) => { input.value = v; show(v); };
  input.addEventListener("input", (event) => {
    show(Number(input.value));
    changed(Number(input.value), event);
  });
  set(value);
  return { element: html("label", { class: "slider" }, html("span", {}, label), input, output), set };
}

export function button(label, pressed) {
  const element = html("button", { type: "button" }, label);
  element.addEventListener("click", pressed);
  return element;
}

// Buttons of which one is chosen.
export function choice(options, chosen, changed) {
  const buttons = Object.entries(options).map(([key, label]) => {
    const element = button(label, (event) => { set(key); changed(key, event); });
    element.dataset.key = key;
    return element;
  });
  const set = (key) => buttons.forEach((b) => b.setAttribute("aria-pressed", b.dataset.key === key));
  set(chosen);
  return { element: html("div", { class: "choice" }, ...buttons), set };
}

export function legend(entries) {
  const items = entries.map(([colour, words, shape = "line"]) =>
    html("span", {}, html("i", { class: shape, style: `--colour: ${colour}` }), words));
  return html("div", { class: "legend" }, ...items);
}

// The root of an explorable. `update(event)` draws the state; the milliseconds from the event to
// the end of the drawing are kept in `root.explorable.responses`.
export function mount(el, model, title, parts, state, update) {
  const root = html("div", { class: "sfmkit-explorable" }, html("h4", {}, title), ...parts);
  const responses = [];
  let pending = null;
  const report = () => {
    pending = null;
    model.set("state", JSON.parse(JSON.stringify(state)));
    model.save_changes();
  };
  const refresh = (event) => {
    update();
    if (event) responses.push(performance.now() - event.timeStamp);
    if (pending === null) pending = setTimeout(report, 200); // the kernel is informed rarely
  };
  root.explorable = { state, responses, median: () => median(responses), refresh };
  el.append(root);
  refresh();
  return refresh;
}
