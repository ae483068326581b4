// Homography or depth? Matches of a scene that can be bent, and the verdict of the library on them.
import {
  apply, homogeneous, inhomogeneous, inverse, plus, rotationOf, times, unit,
} from "./algebra.js";
import {
  COLOURS, choice, circle, dragging, html, legend, mount, photograph, pixelOf, polyline,
  slider, svg, text,
} from "./draw.js";
import { fundamental, pointInCamera, project } from "./epipolar.js";
import { robustHomography } from "./homography.js";
import { gaussian, random } from "./robust.js";
import { compare } from "./verdict.js";

const SIZE = [640, 480];
const CAMERA = [[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1]];
const NORMAL = unit([0.12, -0.06, 1]);
const DISTANCE = 6; // of the plane n · X = d, in metres like everything in the scene
const MOST = 120; // matches
const THRESHOLD = 1; // pixels
const STEP = 1.2; // metres between the levels of the scene with depth

const CASES = { plane: "a plane", depth: "depth", rotation: "rotation only" };
const VERDICTS = { general: "depth", planar: "a plane", rotation: "a pure rotation" };
const BARS = { general: COLOURS.right, planar: COLOURS.camera1, rotation: COLOURS.camera2 };

function render({ model, el }) {
  const state = {
    scene: "plane", count: 60, baseline: 0.6, turn: 3, noise: 0.3, group: 20,
    offsets: Array(MOST).fill(0), chosen: 0,
  };
  const generator = random(5);
  const pixels = Array.from({ length: MOST }, () => [
    30 + (SIZE[0] - 60) * generator(), 30 + (SIZE[1] - 60) * generator(),
  ]);
  const noise = pixels.map(() => [0, 1, 2, 3].map(() => gaussian(generator)));
  const rays = pixels.map((x) => apply(inverse(CAMERA), homogeneous(x)));
  const onPlane = (ray) => DISTANCE / (NORMAL[0] * ray[0] + NORMAL[1] * ray[1] + NORMAL[2]);
  const depthOf = (k) => onPlane(rays[k]) + state.offsets[k];

  function preset(key) {
    state.scene = key;
    state.baseline = key === "rotation" ? 0 : 0.6;
    state.offsets = pixels.map((_, k) => (key === "depth" ? STEP * ((k % 3) - 1) : 0));
    showControls();
  }

  // The chosen point and the points nearest to it in image 1, which move together.
  function groupOf(k) {
    const offset = (i) => Math.hypot(pixels[i][0] - pixels[k][0], pixels[i][1] - pixels[k][1]);
    return pixels.slice(0, state.count).map((_, i) => i)
      .sort((i, j) => offset(i) - offset(j)).slice(0, state.group);
  }

  function matches() {
    const R = rotationOf([0, state.turn, 0]);
    const t = times(apply(R, [1, 0, 0]), -state.baseline);
    const x1 = [];
    const x2 = [];
    for (let k = 0; k < state.count; k++) {
      const [a, b, c, d] = times(noise[k], state.noise);
      const seen = project(CAMERA, pointInCamera(R, t, times(rays[k], depthOf(k))));
      x1.push(plus(pixels[k], [a, b]));
      x2.push(plus(seen, [c, d]));
    }
    // Without a baseline every direction of t explains the matches; sideways is one of them.
    const direction = state.baseline > 0 ? t : times(apply(R, [1, 0, 0]), -1);
    return { x1, x2, F: fundamental(R, direction, CAMERA, CAMERA) };
  }

  const press = (x, event, first) => {
    if (event === first) {
      const offset = (k) => Math.hypot(pixels[k][0] - x[0], pixels[k][1] - x[1]);
      state.chosen = pixels.slice(0, state.count).map((_, k) => k)
        .reduce((a, b) => (offset(b) < offset(a) ? b : a));
    }
    refresh(event);
  };
  const image1 = photograph({ size: SIZE }, "image 1: click a point to choose it", press);
  const image2 = photograph({ size: SIZE }, "image 2: arrows from the homography to the match, × 5", null);
  const above = svg("svg", { viewBox: "0 0 640 330", class: "plot above" });
  const bars = svg("svg", { viewBox: "0 0 640 150", class: "plot" });
  const words = html("div", { class: "words" });

  const place = (X) => [320 + 66 * X[0], 306 - 33 * X[2]]; // seen from above, pixels of the figure
  let grabbed = null;
  dragging(above, (event, first) => {
    const p = pixelOf(above, event);
    if (event === first) {
      const offset = (k) => {
        const q = place(times(rays[k], depthOf(k)));
        return Math.hypot(q[0] - p[0], q[1] - p[1]);
      };
      grabbed = rays.slice(0, state.count).map((_, k) => k)
        .reduce((a, b) => (offset(b) < offset(a) ? b : a));
      if (offset(grabbed) > 25) grabbed = null;
      else state.chosen = grabbed;
    } else if (grabbed !== null) {
      const depth = Math.max(2, Math.min(9, (306 - p[1]) / 33));
      const moved = depth - depthOf(grabbed);
      groupOf(grabbed).forEach((k) => {
        state.offsets[k] = Math.max(2, Math.min(9, depthOf(k) + moved)) - onPlane(rays[k]);
      });
      state.scene = "";
      showControls();
    }
    refresh(event);
  });

  const sceneChoice = choice(CASES, state.scene, (key, event) => { preset(key); refresh(event); });
  const control = (label, name, min, max, step, more = {}) => slider(
    { label, min, max, step, value: state[name], ...more },
    (v, event) => { state[name] = v; refresh(event); },
  );
  const sliders = {
    baseline: control("baseline", "baseline", 0, 1, 0.02, { unit: " m", digits: 2 }),
    turn: control("rotation", "turn", -8, 8, 0.5, { unit: "°" }),
    noise: control("noise", "noise", 0, 1, 0.05, { unit: " px", digits: 2 }),
    count: control("matches", "count", 12, MOST, 1, { digits: 0 }),
    group: control("points moved", "group", 1, MOST, 1, { digits: 0 }),
  };
  function showControls() {
    sceneChoice.set(state.scene);
    Object.entries(sliders).forEach(([name, s]) => s.set(state[name]));
  }

  function update() {
    const found = matches();
    const H = robustHomography(found.x1, found.x2, THRESHOLD);
    const verdict = compare(found.x1, found.x2, CAMERA, CAMERA, found.F, H, THRESHOLD);
    state.chosen = Math.min(state.chosen, state.count - 1);
    Object.assign(state, {
      x1: found.x1, x2: found.x2, F: found.F, H, K: CAMERA, threshold: THRESHOLD,
      verdict: verdict.verdict, scores: verdict.scores, sigma: verdict.sigma,
      offPlane: verdict.offPlane, offRotation: verdict.offRotation,
    });
    drawImages(found, H);
    drawAbove();
    drawBars(verdict);
    explain(verdict);
  }

  function drawImages({ x1, x2 }, H) {
    const group = new Set(groupOf(state.chosen));
    const colour = (k) => (group.has(k) ? COLOURS.sample : COLOURS.camera1);
    image1.overlay.replaceChildren(...x1.map((x, k) => circle(x, 5, {
      fill: colour(k), stroke: k === state.chosen ? "#000000" : "none", "stroke-width": 3,
      class: "match",
    })));
    image2.overlay.replaceChildren(...x2.flatMap((x, k) => {
      const predicted = inhomogeneous(apply(H, homogeneous(x1[k])));
      const end = plus(predicted, times([x[0] - predicted[0], x[1] - predicted[1]], 5));
      return [
        polyline([predicted, end], { stroke: COLOURS.epipole, "stroke-width": 3 }),
        circle(predicted, 4, { fill: colour(k) }),
      ];
    }));
  }

  function drawAbove() {
    const group = new Set(groupOf(state.chosen));
    const ends = [-4.6, 4.6].map((x) => place([x, 0, (DISTANCE - NORMAL[0] * x) / NORMAL[2]]));
    const drawn = [
      svg("rect", { x: 0.5, y: 0.5, width: 639, height: 329, fill: "#ffffff", stroke: "#888888" }),
      polyline(ends, { stroke: "#888888", "stroke-width": 2, "stroke-dasharray": "6 4" }),
    ];
    [[0, COLOURS.camera1, "camera 1"], [state.baseline, COLOURS.camera2, "camera 2"]].forEach(
      ([x, colour, name], i) => {
        const [u, v] = place([x, 0, 0]);
        const angle = i ? (-state.turn * Math.PI) / 180 : 0;
        const edge = (side) => {
          const a = angle + side * 0.49;
          return [u + 44 * Math.sin(a), v - 44 * Math.cos(a)];
        };
        drawn.push(
          polyline([edge(-1), [u, v], edge(1)], { stroke: colour, "stroke-width": 2.5 }),
          text([i ? u + 12 : u - 74, v + 8], name, { fill: colour, "font-size": 14, "font-weight": 600 }),
        );
      },
    );
    for (let k = 0; k < state.count; k++) {
      const p = place(times(rays[k], depthOf(k)));
      drawn.push(circle(p, k === state.chosen ? 7 : 4.5, {
        fill: group.has(k) ? COLOURS.sample : COLOURS.camera1,
        stroke: k === state.chosen ? "#000000" : "none", class: "scene-point",
      }));
    }
    above.replaceChildren(...drawn);
  }

  function drawBars({ scores, verdict }) {
    const values = Object.values(scores);
    const largest = Math.max(...values);
    const drawn = Object.entries(scores).flatMap(([name, value], k) => {
      const y = 16 + 44 * k;
      const won = name === verdict;
      const style = { "font-size": 16, fill: COLOURS.ink, "font-weight": won ? 700 : 400 };
      return [
        text([0, y + 19], VERDICTS[name], style),
        svg("rect", {
          x: 140, y, width: Math.max(2, (400 * Math.max(0, value)) / Math.max(largest, 1)), height: 28,
          fill: BARS[name], "fill-opacity": won ? 1 : 0.35,
        }),
        text([552, y + 19], value.toFixed(1), style),
      ];
    });
    bars.replaceChildren(...drawn);
  }

  function explain({ verdict, scores, sigma, offPlane }) {
    const general = scores.general;
    const best = Math.min(scores.planar, scores.rotation);
    words.replaceChildren(
      html("p", { class: "verdict" }, `verdict: ${VERDICTS[verdict]}`),
      html("p", {}, `${(100 * offPlane).toFixed(0)} % of the inliers lie off the best plane, by more `
        + `than three times the noise of ${sigma.toFixed(2)} px. Depth costs ${Math.abs(general - best).toFixed(1)} `
        + `${general > best ? "more" : "less"} than the best simpler explanation.`),
      html("p", {}, "A match costs its squared distance in units of the noise, up to a limit (2 for "
        + "depth, 4 for the others), plus log 4 for each dimension of the model (3 or 2), plus "
        + "log 4n for each of its parameters (5, 8 or 3). The smallest sum is the verdict."),
    );
  }

  const controls = html(
    "div", { class: "controls" },
    html("div", {}, html("b", {}, "scene "), sceneChoice.element),
    html("div", { class: "sliders" }, ...Object.values(sliders).map((s) => s.element)),
    html("b", {}, "Torr's criterion (GRIC), smaller is better"), bars, words,
  );
  const below = html("div", { class: "pair" }, html("figure", {},
    html("figcaption", {}, "the scene from above: drag a point off the plane"), above), controls);
  const entries = [
    [COLOURS.camera1, "points", "dot"], [COLOURS.sample, "points that move together", "dot"],
    [COLOURS.epipole, "distance from the homography, × 5"], ["#888888", "the plane"],
  ];
  const refresh = mount(el, model, "Homography or depth?", [
    legend(entries), html("div", { class: "pair" }, image1.figure, image2.figure), below,
  ], state, update);
  showControls();
}

export default { render };
