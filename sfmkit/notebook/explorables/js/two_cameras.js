// Two cameras: the epipolar geometry of a pose that is chosen with sliders and by dragging.
import {
  anglesOf, apply, cross, homogeneous, inhomogeneous, inverse, median, norm, plus, rotationOf, times,
  transpose,
} from "./algebra.js";
import {
  COLOURS, casedLine, choice, circle, dragging, html, legend, mount, photograph, pixelOf, polygon,
  polyline, ring, slider, svg, text,
} from "./draw.js";
import {
  clip, distanceToLine, epipoles, fundamental, lineOf, pointInCamera, project, sampson, triangulate,
} from "./epipolar.js";
import { frustum, sceneView } from "./scene3d.js";

const MOTIONS = {
  estimated: "estimated", sideways: "sideways", forward: "forward", rotating: "rotating",
};

function render({ model, el }) {
  const data = model.get("data");
  const { images, points, colours, matches, K1 } = data;
  const depth = median(points.map((X) => X[2]));
  const start = { angles: anglesOf(data.R), t: data.t };
  const reach = 0.02 * images[0].size[0];
  const state = {
    motion: "estimated", ...structuredClone(start), f: 1, active: 1, pixel: data.pixel,
    shown: "photograph", orbit: { yaw: 25, pitch: 35 },
  };
  const motions = {
    estimated: start,
    sideways: { angles: [0, 0, 0], t: [-1, 0, 0] },
    forward: { angles: [0, 0, 0], t: [0, 0, -1] },
    rotating: { angles: [0, 8, 0], t: [0, 0, 0] },
  };

  const press = (active) => (pixel, event) => {
    const [w, h] = images[active - 1].size;
    state.active = active;
    state.pixel = [Math.min(w - 1, Math.max(0, pixel[0])), Math.min(h - 1, Math.max(0, pixel[1]))];
    refresh(event);
  };
  const left = photograph(images[0], "image 1: click or drag", press(1));
  const right = photograph(images[1], "image 2: click or drag", press(2));
  const scene = sceneView(state.orbit, [0, -0.07 * depth, 0.45 * depth], 1.25 * depth, (event) => refresh(event));
  const solid = svg("g");
  const handle = svg("g", { class: "handle" }); // stays in the document while it is dragged
  scene.surface.append(solid, handle);

  const words = html("p", { class: "words" });
  const judge = html("p", { class: "judge" });
  const motionChoice = choice(MOTIONS, state.motion, (key, event) => {
    state.motion = key;
    Object.assign(state, structuredClone(motions[key]), {
      f: 1, shown: key === "estimated" ? "photograph" : "points",
    });
    showControls();
    refresh(event);
  });
  const shownChoice = choice(
    { photograph: "the photograph", points: "what camera 2 sees" }, state.shown,
    (key, event) => { state.shown = key; refresh(event); },
  );
  const sliders = [
    ...["x", "y", "z"].map((axis, k) => slider(
      { label: `rotation ${axis}`, min: -40, max: 40, step: 0.1, value: 0, unit: "°" },
      (v, event) => { state.angles[k] = v; changed(event); },
    )),
    ...["x", "y", "z"].map((axis, k) => slider(
      { label: `t ${axis}`, min: -2, max: 2, step: 0.01, value: 0, digits: 2 },
      (v, event) => { state.t[k] = v; changed(event); },
    )),
    slider(
      { label: "focal length 2", min: 0.5, max: 2, step: 0.01, value: 1, unit: "×", digits: 2 },
      (v, event) => { state.f = v; changed(event); },
    ),
  ];
  function showControls() {
    [...state.angles, ...state.t, state.f].forEach((v, k) => sliders[k].set(v));
    motionChoice.set(state.motion);
    shownChoice.set(state.shown);
  }
  function changed(event) {
    state.motion = "";
    motionChoice.set("");
    refresh(event);
  }
  dragging(handle, (event) => {
    event.stopPropagation();
    const R = rotationOf(state.angles);
    const centre = times(apply(transpose(R), state.t), -1);
    const X = scene.onGround(pixelOf(scene.surface, event), centre[1]);
    if (X === null || norm(X) > 3) return;
    state.t = times(apply(R, X), -1);
    showControls();
    changed(event);
  });

  // Everything that follows from the motion; it is kept while only the pixel changes.
  let kept = { key: null };
  function geometry() {
    const key = JSON.stringify([state.angles, state.t, state.f, state.shown]);
    if (kept.key !== key) {
      kept = { key, ...newGeometry() };
      drawPoints(kept.seen);
    }
    return kept;
  }

  function newGeometry() {
    const R = rotationOf(state.angles);
    const { t } = state;
    const K2 = data.K2.map((row, i) => (i < 2 ? row.map((v, j) => (j < 2 ? v * state.f : v)) : row));
    const moved = norm(t) > 1e-9;
    const F = moved ? fundamental(R, t, K1, K2) : null;
    const seen = state.shown === "photograph"
      ? matches.map((m) => m.slice(2, 4))
      : points.map((X) => {
        const Y = pointInCamera(R, t, X);
        return Y[2] > 0.01 * depth ? project(K2, Y) : null;
      });
    const residuals = moved ? matches.flatMap((m, n) =>
      (seen[n] === null ? [] : [Math.abs(sampson(F, m, seen[n]))])) : [];
    return { R, t, K2, moved, F, seen, residuals };
  }

  function nearestMatch(seen) {
    const offset = ([x, y]) => Math.hypot(x - state.pixel[0], y - state.pixel[1]);
    let best = null;
    matches.forEach((m, k) => {
      const mine = state.active === 1 ? m : seen[k];
      if (mine === null || seen[k] === null) return;
      const off = offset(mine);
      if (off < reach && (best === null || off < best.off)) best = { k, off };
    });
    return best === null ? null : best.k;
  }

  function update() {
    const g = geometry();
    const k = nearestMatch(g.seen);
    const x1 = k === null ? (state.active === 1 ? state.pixel : null) : matches[k].slice(0, 2);
    const x2 = k === null ? (state.active === 2 ? state.pixel : null) : g.seen[k];
    drawPhotographs(g, k, x1, x2);
    drawScene(g, k, x1, x2);
    explain(g, k, x1, x2);
  }

  function linesOf(g, x1, x2) {
    if (!g.moved) return [null, null];
    const [e1, e2] = epipoles(g.F);
    if (state.active === 1) {
      const through = cross(e1, homogeneous(x1));
      return [times(through, 1 / Math.hypot(through[0], through[1])), lineOf(g.F, x1)];
    }
    const through = cross(e2, homogeneous(x2));
    return [lineOf(transpose(g.F), x2), times(through, 1 / Math.hypot(through[0], through[1]))];
  }

  function drawPhotographs(g, k, x1, x2) {
    const lines = linesOf(g, x1, x2);
    state.line = lines[state.active === 1 ? 1 : 0];
    const size = images[0].size[0] / 90;
    const e = g.moved ? epipoles(g.F).map(inhomogeneous) : [null, null];
    [[left, x1, 0], [right, x2, 1]].forEach(([view, x, i]) => {
      const { size: [w, h] } = images[i];
      const drawn = [];
      const ends = lines[i] && clip(lines[i], [w, h]);
      if (ends) drawn.push(...casedLine(ends, COLOURS.line, "chosen-line"));
      if (e[i] && e[i][0] > 0 && e[i][1] > 0 && e[i][0] < w && e[i][1] < h)
        drawn.push(
          circle(e[i], size, { fill: COLOURS.epipole, stroke: "#000000", class: "epipole" }),
          label([e[i][0] + 1.5 * size, e[i][1] - size], i ? "e₂" : "e₁", w),
        );
      if (x) drawn.push(...ring(x, size, k === null ? COLOURS.line : "#FFFFFF", "chosen-pixel"));
      view.overlay.replaceChildren(...drawn);
    });
    if (!g.moved && x1) {
      const p = inhomogeneous(apply(g.K2, apply(g.R, apply(inverse(K1), homogeneous(x1)))));
      right.overlay.append(...ring(p, size, COLOURS.line, "rotated"));
    }
    const photographs = state.shown === "photograph";
    right.picture.style.display = photographs ? "" : "none";
    right.caption.textContent = photographs
      ? "image 2: click or drag" : "image 2, the cloud as camera 2 sees it: click or drag";
  }

  // The cloud as camera 2 sees it. Image 1 has no canvas to draw.
  left.canvas.style.visibility = "hidden";
  let empty = true;
  function drawPoints(seen) {
    const context = right.canvas.getContext("2d");
    // A canvas that is cleared is painted again, also where it was empty.
    if (!empty) context.clearRect(0, 0, right.canvas.width, right.canvas.height);
    empty = state.shown === "photograph";
    right.canvas.style.visibility = empty ? "hidden" : "";
    if (empty) return;
    seen.forEach((x, n) => {
      if (x === null) return;
      context.fillStyle = colours[n];
      context.fillRect(x[0] - 2.5, x[1] - 2.5, 6, 6); // pixel centres are at integers
    });
  }

  const label = (x, words_, w) => text(x, words_, {
    "font-size": w / 32, fill: "#FFFFFF", stroke: "#000000", "stroke-width": w / 250,
    "paint-order": "stroke",
  });

  function drawScene(g, k, x1, x2) {
    scene.dots(points, colours);
    const drawn = [];
    const add = (X, make) => {
      const placed = scene.placeAll(X);
      if (placed) drawn.push(make(placed));
    };
    const identity = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    const cameras = [
      frustum(K1, identity, [0, 0, 0], images[0].size, 0.16 * depth),
      frustum(g.K2, g.R, g.t, images[1].size, 0.16 * depth),
    ];
    const X = worldPoint(g, k, x1, x2);
    const centres = cameras.map((camera) => camera.centre);
    if (g.moved) {
      add([centres[0], centres[1], X], (p) => polygon(p, {
        fill: COLOURS.plane, "fill-opacity": 0.35, stroke: COLOURS.plane, class: "epipolar-plane",
      }));
      add(centres, (p) => polyline(p, { stroke: COLOURS.epipole, "stroke-width": 3 }));
    } else add([centres[0], X], (p) => polyline(p, { stroke: COLOURS.plane, "stroke-width": 2 }));
    const lines = linesOf(g, x1, x2);
    const e = g.moved ? epipoles(g.F).map(inhomogeneous) : [null, null];
    cameras.forEach((camera, i) => {
      const colour = i ? COLOURS.camera2 : COLOURS.camera1;
      add([...camera.corners, camera.corners[0]], (p) => polygon(p, {
        fill: "#FFFFFF", "fill-opacity": 0.55, stroke: colour, "stroke-width": 2,
      }));
      camera.corners.forEach((corner) => add([camera.centre, corner], (p) =>
        polyline(p, { stroke: colour, "stroke-width": 1 })));
      const ends = lines[i] && clip(lines[i], images[i].size);
      if (ends) {
        const inSpace = ends.map(camera.onPlane);
        add(inSpace, (p) => polyline(p, { stroke: "#000000", "stroke-width": 4 }));
        add(inSpace, (p) => polyline(p, { stroke: COLOURS.line, "stroke-width": 2.5 }));
      }
      const [w, h] = images[i].size;
      const near = e[i] && Math.abs(e[i][0] - w / 2) < 1.5 * w && Math.abs(e[i][1] - h / 2) < 1.5 * h;
      if (near) add([camera.onPlane(e[i])], ([p]) =>
        circle(p, 5, { fill: COLOURS.epipole, stroke: "#000000" }));
      add([camera.centre], ([p]) => text([p[0] - 30, p[1] + 20], `camera ${i + 1}`, {
        fill: colour, "font-size": 14, "font-weight": 600, "paint-order": "stroke",
        stroke: "#FFFFFF", "stroke-width": 3,
      }));
    });
    add([X], ([p]) => circle(p, 5, { fill: "#000000", stroke: "#FFFFFF", class: "chosen-point" }));
    const grip = scene.place(centres[1]);
    handle.replaceChildren(...(grip
      ? [circle(grip, 8, { fill: COLOURS.camera2, stroke: "#FFFFFF", "stroke-width": 2 })] : []));
    solid.replaceChildren(...drawn);
  }

  // The point of the match, or a point of typical depth on the ray of the pixel.
  function worldPoint(g, k, x1, x2) {
    if (k !== null && state.shown === "points") return points[k];
    if (k !== null && g.moved) {
      const X = triangulate(K1, g.K2, g.R, g.t, x1, x2);
      if (X !== null && X[2] > 0 && X[2] < 4 * depth) return X;
    }
    if (x1) return times(apply(inverse(K1), homogeneous(x1)), depth);
    const ray = apply(transpose(g.R), apply(inverse(g.K2), homogeneous(x2)));
    return plus(times(apply(transpose(g.R), g.t), -1), times(ray, depth));
  }

  function explain(g, k, x1, x2) {
    if (!g.moved) {
      state.distance = null;
      state.median = null;
      words.textContent = "The centres coincide: no baseline, no epipolar plane. "
        + "A pixel of image 1 has one position in image 2 (yellow), whatever its depth, "
        + "and depth cannot be recovered.";
      judge.textContent = "";
      return;
    }
    const [e1, e2] = epipoles(g.F).map(inhomogeneous).map((p) => (Math.hypot(...p) < 1e6
      ? `at (${p.map((v) => v.toFixed(0)).join(", ")}) px` : "at infinity"));
    const l2 = x1 && lineOf(g.F, x1);
    state.distance = k === null ? null : distanceToLine(l2, x2);
    words.textContent = `epipole 1 ${e1}, epipole 2 ${e2}. `
      + (k === null ? "No match near the pixel." : `The match is ${state.distance.toFixed(2)} px `
        + "from its epipolar line in image 2.");
    const { residuals } = g;
    state.median = median(residuals);
    const share = residuals.filter((v) => v <= 2).length / residuals.length;
    judge.textContent = `${(100 * share).toFixed(0)} % of ${residuals.length} matches lie within 2 px `
      + `of this geometry; median distance ${state.median.toFixed(2)} px.`;
    judge.style.setProperty("--share", `${100 * share}%`);
  }

  const controls = html(
    "div", { class: "controls" },
    html("div", {}, html("b", {}, "motion "), motionChoice.element),
    html("div", {}, html("b", {}, "image 2 shows "), shownChoice.element),
    html("div", { class: "sliders four" }, ...[0, 1, 2, 6, 3, 4, 5].map((k) => sliders[k].element)),
    judge, words,
  );
  const entries = [
    [COLOURS.camera1, "camera 1", "square"], [COLOURS.camera2, "camera 2 (drag its centre)", "square"],
    [COLOURS.plane, "epipolar plane", "square"], [COLOURS.line, "epipolar line"],
    [COLOURS.epipole, "baseline, epipole"], ["#FFFFFF", "match", "ring"],
  ];
  const below = html("div", { class: "pair" },
    html("figure", {}, html("figcaption", {}, "the scene: drag to turn it"), scene.box), controls);
  const refresh = mount(el, model, "Two cameras", [
    legend(entries), html("div", { class: "pair" }, left.figure, right.figure), below,
  ], state, update);
  showControls();
}

export default { render };
