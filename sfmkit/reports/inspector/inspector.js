"use strict";
// The page of a recording: dots in both photographs, the cloud, and the life of what is clicked.
const data = JSON.parse(document.getElementById("data").textContent);
const KINDS = { "<f4": Float32Array, "<i4": Int32Array, "|u1": Uint8Array };
function unpacked({ kind, data: text }) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new KINDS[kind](bytes.buffer);
}
const table = (packed) =>
  Object.fromEntries(Object.entries(packed).map(([name, value]) => [name, unpacked(value)]));
const operators = data.operators.map((o) => ({ ...o, keypoints: o.keypoints.map(table) }));
const matches = table(data.matches);
const points = table(data.points);
const element = (id) => document.getElementById(id);

// As Python rounds: ties to the even digit. The product is exact for float32 and up to four digits.
function fixed(value, digits) {
  const scaled = Math.abs(value) * 10 ** digits;
  if (scaled % 1 !== 0.5) return value.toFixed(digits);
  return ((Math.sign(value) * 2 * Math.round(scaled / 2)) / 10 ** digits).toFixed(digits);
}

// Python's str.format for the specifications "", ",", ".Nf" and ",.Nf".
function words(name, values) {
  return data.words[name].replace(/\{(\w+)(?::(,)?(?:\.(\d+)f)?)?\}/g, (_, key, comma, digits) => {
    const value = values[key];
    if (digits === undefined && !comma) return String(value);
    const [whole, rest] = (digits === undefined ? String(value) : fixed(value, +digits)).split(".");
    const grouped = comma ? whole.replace(/\B(?=(\d{3})+$)/g, ",") : whole;
    return rest === undefined ? grouped : `${grouped}.${rest}`;
  });
}

function detected(o, image, n) {
  const k = operators[o].keypoints[image - 1];
  return words("detected", {
    operator: operators[o].name, image, keypoint: n, x: k.xy[2 * n], y: k.xy[2 * n + 1],
    scale: k.scale[n], angle: k.angle[n], response: k.response[n],
  });
}
function matched(o, image, n) {
  const k = operators[o].keypoints[image - 1];
  const [other, partner] = [3 - image, k.partner[n]];
  const { xy } = operators[o].keypoints[other - 1];
  const text = words("matched", {
    partner, other, x: xy[2 * partner], y: xy[2 * partner + 1], distance: k.distance[n],
  });
  return text + (Number.isFinite(k.ratio[n]) ? words("ratio", { ratio: k.ratio[n] }) : "");
}
const fateOf = (row) => data.fates[matches.fate[row]];
const keptBy = (row) => operators[matches.kept[row]].name;
function kept(row) {
  const found = operators.filter((_, k) => (matches.mask[row] >> k) & 1).map((o) => o.name);
  return words("kept", { kept: keptBy(row), operators: found.join(", ") });
}
function estimated(row) {
  const [fate, distance, n] = [fateOf(row), matches.distance[row], matches.point[row]];
  const why = data.reasons[fate] ?? "";
  if (fate !== "point" && !fate.startsWith("inlier")) {
    const kind = Number.isFinite(distance) ? "outlier" : "no geometry";
    const reason = fate.replace(/^outlier: /, "");
    return [["estimated", words(kind, { reason, distance, why })]];
  }
  const steps = [["estimated", words("inlier", { distance })]];
  if (n < 0) return [...steps, ["triangulated", words("no point", { why })]];
  const [x, y, z] = points.xyz.subarray(3 * n, 3 * n + 3);
  const residual = points.residual[n];
  const worse = (100 * points.residual.filter((r) => r > residual).length) / points.residual.length;
  let quality = words("quality", { residual, worse, parallax: points.parallax[n] });
  const sigma = points.sigma[n];
  if (Number.isFinite(sigma)) quality += words("sigma", { sigma, share: (100 * sigma) / z });
  return [...steps, ["triangulated", words("triangulated", { point: n, x, y, z })],
    ["quality", quality]];
}
function keypointLife(o, image, n) {
  const k = operators[o].keypoints[image - 1];
  const title = words("keypoint", { operator: operators[o].name, keypoint: n, image });
  const steps = [["detected", detected(o, image, n)]];
  if (k.partner[n] < 0) {
    steps.push(["matched", words("unmatched", { rule: operators[o].rule })]);
    return { title, fate: "unmatched", steps, row: -1 };
  }
  steps.push(["matched", matched(o, image, n)]);
  const row = k.match[n];
  const end = row < 0 ? "" : fateOf(row);
  let fate = end;
  if (k.merged[n]) {
    const by = row < 0 ? "-" : keptBy(row);
    steps.push(["fused", words("merged", { match: row, kept: by, radius: data.radius })]);
    fate = row < 0 ? "merged" : `merged into a duplicate; ${end}`;
  } else steps.push(["fused", kept(row)]);
  if (row >= 0) steps.push(...estimated(row));
  return { title, fate, steps, row };
}
function matchLife(row) {
  const o = matches.kept[row];
  const [first, second] = [matches.keypoint1[row], matches.keypoint2[row]];
  const steps = [["detected", detected(o, 1, first)], ["", detected(o, 2, second)],
    ["matched", matched(o, 1, first)], ["fused", kept(row)]];
  for (const operator of operators) {
    const k = operator.keypoints[0];
    k.match.forEach((m, n) => {
      if (m !== row || !k.merged[n]) return;
      const [partner, { xy }] = [k.partner[n], operator.keypoints[1]];
      steps.push(["", words("joined", {
        operator: operator.name, keypoint1: n, keypoint2: partner, x1: k.xy[2 * n],
        y1: k.xy[2 * n + 1], x2: xy[2 * partner], y2: xy[2 * partner + 1],
      })]);
    });
  }
  const title = words("match", { match: row, total: matches.kept.length });
  return { title, fate: fateOf(row), steps: [...steps, ...estimated(row)], row };
}

function pointLife(n) {
  const life = matchLife(matches.point.indexOf(n));
  const title = words("point", { point: n, total: points.residual.length });
  return { ...life, title: `${title}, ${life.title}` };
}

// Dots of the photographs.
const state = { chosen: null, point: -1, dots: [[], []], cells: [], most: 1 };
const shows = {
  keypoints: () => true,
  unmatched: (k, n) => k.partner[n] < 0,
  before: (k, n) => k.partner[n] >= 0,
  merged: (k, n) => k.merged[n] === 1,
  after: (k, n) => k.partner[n] >= 0 && !k.merged[n],
  inliers: (k, n) => k.match[n] >= 0 && !k.merged[n] && !rejected(k.match[n]),
  rejected: (k, n) => k.match[n] >= 0 && !k.merged[n] && rejected(k.match[n]),
};
const rejected = (row) => fateOf(row) !== "point" && !fateOf(row).startsWith("inlier");
const checked = () =>
  [...document.querySelectorAll("[data-operator]")].map((box) => box.checked);

function collect() {
  const [on, test] = [checked(), shows[element("stage").value]];
  state.dots = [0, 1].map((i) => operators.flatMap((o, k) => {
    const some = [];
    if (on[k]) o.keypoints[i].match.forEach((_, n) => {
      if (test(o.keypoints[i], n)) some.push([k, n]);
    });
    return some;
  }));
  const n = state.dots[0].length;
  element("count").textContent = `${n.toLocaleString("en")} in image 1, `
    + `${state.dots[1].length.toLocaleString("en")} in image 2`;
  countCells();
}
// Coverage: marks per square cell, CELLS of them along the width, on one scale for both images.
const CELLS = 40;
const shade = (count) => Math.log1p(count) / Math.log1p(state.most);
function countCells() {
  state.cells = state.dots.map((dots, i) => {
    const [cells, side] = [new Map(), data.sizes[i][0] / CELLS];
    for (const [k, n] of dots) {
      const { xy } = operators[k].keypoints[i];
      const column = Math.min(CELLS - 1, Math.floor((xy[2 * n] + 0.5) / side));
      const cell = CELLS * Math.floor((xy[2 * n + 1] + 0.5) / side) + column;
      cells.set(cell, (cells.get(cell) ?? 0) + 1);
    }
    return cells;
  });
  state.most = Math.max(1, ...state.cells.flatMap((cells) => [...cells.values()]));
  const bar = element("bar");
  bar.hidden = !element("heat").checked;
  const steps = [...Array(33).keys()].map((k) => shade(1) + (k / 32) * (1 - shade(1)));
  bar.querySelector(".ramp").style.background =
    `linear-gradient(to right, ${steps.map((v) => `rgb(${ramp(v).join(" ")})`).join(", ")})`;
  const at = (count) => state.most === 1 ? 0 : (shade(count) - shade(1)) / (1 - shade(1));
  const round = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000]
    .filter((count) => count === 1 || at(count) < 0.85);
  bar.querySelector(".ticks").replaceChildren(...[...new Set([...round, state.most])].map((count) => {
    const tick = document.createElement("span");
    tick.textContent = count.toLocaleString("en");
    tick.style.left = `${100 * at(count)}%`;
    return tick;
  }));
  const what = element("stage").selectedOptions[0].textContent;
  const sides = [...new Set(data.sizes.map(([w]) => (w / CELLS).toFixed(0)))]
    .map((side) => `${side} x ${side}`).join(" and ");
  bar.querySelector("figcaption").textContent =
    `${what}: number per cell of ${sides} pixels; a cell without a colour has none`;
}
const boxes = [1, 2].map((n) => document.querySelector(`#photo${n} canvas`));
function ramp(v) { // dark blue to yellow
  const stops = [[0, 32, 77], [87, 93, 109], [165, 156, 116], [255, 234, 70]];
  const at = Math.min(2.999, Math.max(0, 3 * v));
  const [a, b] = [stops[Math.floor(at)], stops[Math.floor(at) + 1]];
  return a.map((c, i) => Math.round(c + (at % 1) * (b[i] - c)));
}
function drawPhoto(i) {
  const canvas = boxes[i];
  const sharp = window.devicePixelRatio || 1;
  canvas.width = canvas.clientWidth * sharp;
  canvas.height = canvas.clientHeight * sharp;
  const context = canvas.getContext("2d");
  const scale = canvas.width / data.sizes[i][0];
  const place = (k, n) => {
    const { xy } = operators[k].keypoints[i];
    return [(xy[2 * n] + 0.5) * scale, (xy[2 * n + 1] + 0.5) * scale];
  };
  if (element("heat").checked) {
    const side = canvas.width / CELLS;
    for (const [cell, count] of state.cells[i]) {
      const [x, y] = [cell % CELLS, Math.floor(cell / CELLS)];
      context.fillStyle = `rgb(${ramp(shade(count)).join(" ")} / .75)`;
      context.fillRect(x * side, y * side, side, side);
    }
  } else {
    const size = sharp * Math.min(2.2, Math.max(0.6, 130 / Math.sqrt(state.dots[i].length + 1)));
    for (const [k, n] of state.dots[i]) {
      const [x, y] = place(k, n);
      const row = operators[k].keypoints[i].match[n];
      context.strokeStyle = context.fillStyle = operators[k].colour;
      if (row >= 0 && element("stage").value !== "keypoints" && rejected(row)) {
        context.beginPath();
        context.moveTo(x - 1.6 * size, y - 1.6 * size);
        context.lineTo(x + 1.6 * size, y + 1.6 * size);
        context.moveTo(x + 1.6 * size, y - 1.6 * size);
        context.lineTo(x - 1.6 * size, y + 1.6 * size);
        context.stroke();
      } else context.fillRect(x - size, y - size, 2 * size, 2 * size);
    }
  }
  const n = state.chosen === null ? -1 : state.chosen.at[i];
  if (n >= 0) {
    const [x, y] = place(state.chosen.operator, n);
    for (const [colour, width] of [["#000", 5], ["#ffe000", 2.5]]) {
      context.beginPath();
      context.arc(x, y, 9 * sharp, 0, 7);
      context.strokeStyle = colour;
      context.lineWidth = width * sharp;
      context.stroke();
    }
    context.lineWidth = 1;
  }
}
function told(life) {
  const width = Math.max(...life.steps.map(([stage]) => stage.length));
  const lines = life.steps.map(([stage, text]) => `  ${stage.padEnd(width)}  ${text}`);
  return [`${life.title}: ${life.fate}`, ...lines].join("\n");
}
function show(life, operator, at) {
  element("life").textContent = told(life);
  state.chosen = { operator, at };
  state.point = life.row >= 0 ? matches.point[life.row] : -1;
  redraw();
}
function showKeypoint(o, image, n) {
  const partner = operators[o].keypoints[image - 1].partner[n];
  show(keypointLife(o, image, n), o, image === 1 ? [n, partner] : [partner, n]);
}
const showLife = (life) => show(life, matches.kept[life.row],
  [matches.keypoint1[life.row], matches.keypoint2[life.row]]);
const showMatch = (row) => showLife(matchLife(row));
const showPoint = (n) => showLife(pointLife(n));
boxes.forEach((canvas, i) => canvas.addEventListener("click", (event) => {
  const box = canvas.getBoundingClientRect();
  const scale = data.sizes[i][0] / box.width;
  const [x, y] = [(event.clientX - box.left) * scale - 0.5, (event.clientY - box.top) * scale - 0.5];
  let [best, least] = [null, (12 * scale) ** 2];
  for (const [k, n] of state.dots[i]) {
    const { xy } = operators[k].keypoints[i];
    const d = (xy[2 * n] - x) ** 2 + (xy[2 * n + 1] - y) ** 2;
    if (d < least) [best, least] = [[k, n], d];
  }
  if (best) showKeypoint(best[0], i + 1, best[1]);
  else element("life").textContent = `(${x.toFixed(0)}, ${y.toFixed(0)}) of image ${i + 1}: `
    + "nothing that is shown lies here; choose \"all keypoints\" above to see the others";
}));
element("go").addEventListener("submit", (event) => {
  event.preventDefault();
  const [match, point] = ["match", "point"].map((id) => element(id).value);
  if (match !== "" && +match < matches.kept.length) showMatch(+match);
  else if (point !== "" && +point < points.residual.length) showPoint(+point);
  else element("life").textContent = `There are matches 0 to ${matches.kept.length - 1} and points `
    + `0 to ${points.residual.length - 1}.`;
});
element("match").addEventListener("input", () => { element("point").value = ""; });
element("point").addEventListener("input", () => { element("match").value = ""; });

// The cloud, turned about the median of its points.
const cloud = element("scene");
const eye = { yaw: 0.35, pitch: 0.25, zoom: 1 };
const total = points.residual.length;
const median = (axis) => [...Array(total).keys()].map((n) => points.xyz[3 * n + axis])
  .sort((a, b) => a - b)[total >> 1] ?? 0;
const centre = [0, 1, 2].map(median);
const distance = Math.max(centre[2], 1e-9);
let placed = [];
// The point that is seen at a place of the canvas: the front one of those whose square covers it,
// else the one whose centre is nearest, within 10 pixels; -1 for none.
function pointAt(x, y) {
  const half = window.devicePixelRatio || 1;
  let [best, least] = [-1, (10 * half) ** 2];
  for (const [[u, v], n] of placed) { // far points first
    const covers = Math.abs(u - x) <= half && Math.abs(v - y) <= half;
    const d = covers ? 0 : (u - x) ** 2 + (v - y) ** 2;
    if (d <= least) [best, least] = [n, d];
  }
  return best;
}
function drawCloud() {
  if (!cloud) return;
  const sharp = window.devicePixelRatio || 1;
  const [w, h] = [cloud.width, cloud.height] = [cloud.clientWidth * sharp, cloud.clientHeight * sharp];
  const context = cloud.getContext("2d");
  const [cy, sy, cp, sp] = [Math.cos(eye.yaw), Math.sin(eye.yaw), Math.cos(eye.pitch),
    Math.sin(eye.pitch)];
  const at = (X, Y, Z) => {
    const [x, y, z] = [X - centre[0], Y - centre[1], Z - centre[2]];
    const [u, d] = [cy * x + sy * z, cy * z - sy * x];
    const depth = cp * d + sp * -y + 1.4 * distance;
    if (depth < 0.05 * distance) return null;
    const s = (1.3 * Math.min(w, 1.6 * h) * eye.zoom) / depth;
    return [w / 2 + s * u, h / 2 + s * (cp * y + sp * d), depth];
  };
  const on = checked();
  const mine = element("colour").value === "operator";
  placed = [];
  for (let row = 0; row < matches.point.length; row++) {
    const n = matches.point[row];
    if (n < 0 || !on.some((yes, k) => yes && (matches.mask[row] >> k) & 1)) continue;
    const p = at(...points.xyz.subarray(3 * n, 3 * n + 3));
    if (!p || p[0] < 0 || p[1] < 0 || p[0] > w || p[1] > h) continue;
    placed.push([p, n, mine ? operators[matches.kept[row]].colour
      : `rgb(${points.rgb.subarray(3 * n, 3 * n + 3).join(" ")})`]);
  }
  placed.sort((a, b) => b[0][2] - a[0][2]);
  for (const [[x, y], , colour] of placed) {
    context.fillStyle = colour;
    context.fillRect(x - sharp, y - sharp, 2 * sharp, 2 * sharp);
  }
  const size = 0.08 * distance;
  [[0, 0, 0], ...(data.centre2 ? [data.centre2] : [])].forEach(([x, y, z], i) => {
    const corners = [at(x, y - size / 2, z), at(x - size / 2, y + size / 2, z),
      at(x + size / 2, y + size / 2, z)];
    if (corners.some((c) => c === null)) return;
    context.strokeStyle = context.fillStyle = "#fff";
    context.beginPath();
    corners.forEach(([u, v]) => context.lineTo(u, v));
    context.closePath();
    context.stroke();
    context.font = `${12 * sharp}px sans-serif`;
    context.fillText(`camera ${i + 1}`, corners[2][0] + 4 * sharp, corners[2][1]);
  });
  const chosen = placed.find(([, n]) => n === state.point);
  if (chosen) {
    context.strokeStyle = "#ffe000";
    context.lineWidth = 2.5 * sharp;
    context.beginPath();
    context.arc(chosen[0][0], chosen[0][1], 8 * sharp, 0, 7);
    context.stroke();
  }
}
if (cloud) {
  const fingers = new Map();
  let moved = 0;
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  };
  const zoom = (factor) => { eye.zoom = Math.min(20, Math.max(0.2, eye.zoom * factor)); };
  cloud.addEventListener("pointerdown", (event) => {
    if (fingers.size === 0) moved = 0;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    cloud.setPointerCapture(event.pointerId);
  });
  cloud.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const before = fingers.size === 2 ? spread() : 0;
    const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
    moved += Math.hypot(dx, dy);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (fingers.size === 2) zoom(spread() / Math.max(before, 1));
    else {
      eye.yaw += 0.007 * dx;
      eye.pitch = Math.max(-1.5, Math.min(1.5, eye.pitch + 0.007 * dy));
    }
    requestAnimationFrame(drawCloud);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    cloud.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }
  cloud.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-0.001 * event.deltaY));
    drawCloud();
  }, { passive: false });
  cloud.addEventListener("click", (event) => {
    if (moved > 5) return;
    const [box, sharp] = [cloud.getBoundingClientRect(), window.devicePixelRatio || 1];
    const [x, y] = [(event.clientX - box.left) * sharp, (event.clientY - box.top) * sharp];
    const n = pointAt(x, y);
    if (n >= 0) showPoint(n);
    else element("life").textContent = "no point of the cloud is drawn within 10 pixels of this place";
  });
  element("colour").addEventListener("change", drawCloud);
}
function redraw() {
  drawPhoto(0);
  drawPhoto(1);
  drawCloud();
}
function renew() {
  collect();
  redraw();
}
document.querySelectorAll("[data-operator], #stage, #heat").forEach((box) =>
  box.addEventListener("change", renew));
window.addEventListener("resize", redraw);
window.addEventListener("load", renew);
