// RANSAC step by step: samples, models, consensus sets and the stopping rule, for lines and for F.
import { cross, homogeneous, median, svd, times } from "./algebra.js";
import {
  COLOURS, button, casedLine, choice, circle, html, legend, mount, photograph, polygon, polyline,
  slider, svg, text,
} from "./draw.js";
import { clip, fundamental7, fundamental8, lineOf, sampson } from "./epipolar.js";
import {
  finished, gaussian, newSearch, random, runSearch, samplesNeeded, step,
} from "./robust.js";

const COUNT = 100; // points of the line problem
const TRUE_LINE = [-0.5, 1, -2].map((v) => v / Math.hypot(0.5, 1));
const CONFIDENCE = 0.99;
const LIMIT = 500; // samples of one search of the comparison

// Points near a line, of which the first share * COUNT are elsewhere.
function linePoints(share) {
  const generator = random(1);
  return Array.from({ length: COUNT }, (_, k) => {
    const [a, b] = [10 * generator(), 10 * generator()];
    const noise = 0.1 * gaussian(generator);
    return k < Math.round(share * COUNT) ? [a, b] : [a, 0.5 * a + 2 + noise];
  });
}

// The total least-squares line of points.
export function fitLine(x) {
  const centre = [0, 1].map((k) => x.reduce((sum, p) => sum + p[k], 0) / x.length);
  const normal = svd(x.map((p) => [p[0] - centre[0], p[1] - centre[1]])).V[1];
  return [...normal, -normal[0] * centre[0] - normal[1] * centre[1]];
}

function lineProblem(x) {
  const at = ([a, b, c], p) => a * p[0] + b * p[1] + c;
  return {
    n: x.length,
    sampleSize: 2,
    solve: ([i, j]) => {
      const l = cross(homogeneous(x[i]), homogeneous(x[j]));
      return [times(l, 1 / Math.hypot(l[0], l[1]))];
    },
    squares: (l) => x.map((p) => at(l, p) ** 2),
    fit: (rows) => (rows.length < 2 ? null : fitLine(rows.map((k) => x[k]))),
    error: (l) => (Math.acos(Math.min(1, Math.abs(l[0] * TRUE_LINE[0] + l[1] * TRUE_LINE[1])))
      * 180) / Math.PI,
  };
}

function matchProblem({ right, wrong }, share) {
  const count = Math.min(right.length, wrong.length);
  const bad = Math.round(share * count);
  const matches = [...wrong.slice(0, bad), ...right.slice(bad, count)];
  const [x1, x2] = [matches.map((m) => m.slice(0, 2)), matches.map((m) => m.slice(2, 4))];
  const pick = (x, rows) => rows.map((k) => x[k]);
  const squares = (F) => x1.map((x, k) => sampson(F, x, x2[k]) ** 2);
  return {
    n: count, sampleSize: 7, x1, x2, squares,
    solve: (rows) => fundamental7(pick(x1, rows), pick(x2, rows)),
    fit: (rows) => fundamental8(pick(x1, rows), pick(x2, rows)),
    error: (F) => median(squares(F).slice(bad).map(Math.sqrt)),
  };
}

const PROBLEMS = { line: "a line, 2 points", fundamental: "F, 7 matches" };
const SCORES_SHOWN = { count: "size of the consensus set", marginal: "marginal score" };

function render({ model, el }) {
  const data = model.get("data");
  const state = {
    problem: "line", wrong: 0.4, threshold: { line: 0.3, fundamental: 1 }, score: "count",
    optimise: false, shown: "last", seed: 3, comparison: null,
  };
  let problem = null;
  let search = null;

  const settings = () => ({
    threshold: state.threshold[state.problem], score: state.score, optimise: state.optimise,
    confidence: CONFIDENCE,
  });
  function restart() {
    problem = state.problem === "line"
      ? lineProblem(linePoints(state.wrong)) : matchProblem(data, state.wrong);
    search = newSearch(state.seed);
    state.comparison = null;
  }
  const draws = (count) => (event) => {
    for (let k = 0; k < count && search.drawn < 5000; k++) {
      if (count > 1 && finished(search)) break;
      step(search, problem, settings());
    }
    refresh(event);
  };

  const plot = svg("svg", { viewBox: "0 0 420 420", class: "plot" });
  const lineFigure = html("figure", {}, html("figcaption", {}, "the points"), plot);
  const [left, right] = data.images.map((image, i) => photograph(image, `image ${i + 1}`, null));
  const pictures = html("div", { class: "photographs" }, left.figure, right.figure);
  const rule = svg("svg", { viewBox: "0 0 520 250", class: "plot" });
  const words = html("div", { class: "words" });
  const table = html("div");

  const problemChoice = choice(PROBLEMS, state.problem, (key, event) => {
    state.problem = key;
    thresholdSlider.set(state.threshold[key]);
    restart();
    refresh(event);
  });
  const scoreChoice = choice(SCORES_SHOWN, state.score, (key, event) => {
    state.score = key;
    restart();
    refresh(event);
  });
  const optimiseChoice = choice({ no: "off", yes: "on" }, "no", (key, event) => {
    state.optimise = key === "yes";
    restart();
    refresh(event);
  });
  const shownChoice = choice({ last: "this sample", best: "the best so far" }, "last", (key, event) => {
    state.shown = key;
    refresh(event);
  });
  const wrongSlider = slider(
    { label: "share wrong", min: 0, max: 0.8, step: 0.05, value: state.wrong, digits: 2 },
    (v, event) => { state.wrong = v; restart(); refresh(event); },
  );
  const thresholdSlider = slider(
    { label: "threshold", min: 0.1, max: 3, step: 0.1, value: 0.3 },
    (v, event) => { state.threshold[state.problem] = v; restart(); refresh(event); },
  );
  const buttons = html(
    "div", { class: "choice" },
    button("draw a sample", draws(1)), button("draw 10", draws(10)),
    button("draw until N", draws(5000)),
    button("restart", (event) => { state.seed += 1; restart(); refresh(event); }),
  );

  // Searches with all combinations of score and local optimisation, a few at a time.
  function compare(event) {
    const searches = state.problem === "line" ? 100 : 20;
    const rows = [];
    for (const score of Object.keys(SCORES_SHOWN))
      for (const optimise of [false, true]) rows.push({ score, optimise, errors: [], drawn: [] });
    state.comparison = { searches, rows: [], done: 0 };
    const [current, chosen] = [problem, { ...settings() }];
    let seed = 0;
    const work = () => {
      if (problem !== current || state.comparison === null) return;
      const until = performance.now() + 30;
      while (seed < searches && performance.now() < until) {
        seed += 1;
        for (const row of rows) {
          const done = runSearch(
            current, { ...chosen, score: row.score, optimise: row.optimise }, 1000 + seed, LIMIT,
          );
          if (done.best === null) continue;
          row.errors.push(current.error(done.best.model));
          row.drawn.push(done.drawn);
        }
      }
      state.comparison = {
        searches, done: seed,
        rows: rows.map((row) => ({
          score: row.score, optimise: row.optimise, error: median(row.errors),
          drawn: median(row.drawn),
        })),
      };
      refresh();
      if (seed < searches) setTimeout(work, 0);
    };
    refresh(event);
    setTimeout(work, 0);
  }

  function update() {
    const { last, best } = search;
    Object.assign(state, {
      drawn: search.drawn,
      needed: Number.isFinite(search.needed) ? search.needed : null,
      sample: last && last.sample,
      consensus: last && last.consensus.length,
      best: best && { consensus: best.consensus.length, drawn: best.drawn, model: best.model },
    });
    lineFigure.style.display = state.problem === "line" ? "" : "none";
    pictures.style.display = state.problem === "line" ? "none" : "";
    if (state.problem === "line") drawLine(); else drawMatches();
    drawRule();
    explain();
  }

  const shownModel = () => (state.shown === "best" ? search.best : search.last);
  const colourOf = (members, k) => (members.has(k) ? COLOURS.camera1 : COLOURS.wrong);

  function drawLine() {
    const place = ([x, y]) => [10 + 40 * x, 410 - 40 * y];
    const drawn = [svg("rect", {
      x: 10, y: 10, width: 400, height: 400, fill: "#ffffff", stroke: "#888888",
    })];
    const ends = (l) => {
      const clipped = clip([l[0], l[1], l[2] + 0.5 * (l[0] + l[1])], [10, 10]);
      return clipped && clipped.map(([x, y]) => place([x + 0.5, y + 0.5]));
    };
    const shown = shownModel();
    if (shown && shown.model) {
      const [a, b, c] = shown.model;
      const band = state.threshold.line;
      const edges = [ends([a, b, c - band]), ends([a, b, c + band])];
      if (edges[0] && edges[1]) {
        const [[p, q], [r, s]] = edges;
        const crossing = (q[0] - p[0]) * (s[0] - r[0]) + (q[1] - p[1]) * (s[1] - r[1]) > 0;
        drawn.push(polygon(crossing ? [p, q, s, r] : [p, q, r, s], {
          fill: COLOURS.sample, "fill-opacity": 0.18,
        }));
      }
    }
    const bestEnds = search.best && ends(search.best.model);
    if (bestEnds) drawn.push(polyline(bestEnds, {
      stroke: COLOURS.right, "stroke-width": 4, class: "best-line",
    }));
    const lastEnds = shown && shown.model && state.shown === "last" && ends(shown.model);
    if (lastEnds) drawn.push(polyline(lastEnds, {
      stroke: COLOURS.sample, "stroke-width": 2, class: "sample-line",
    }));
    const members = new Set(shown ? shown.consensus : []);
    linePoints(state.wrong).forEach((p, k) => drawn.push(
      circle(place(p), 4, { fill: colourOf(members, k), class: "datum" }),
    ));
    if (search.last && state.shown === "last") {
      const x = linePoints(state.wrong);
      search.last.sample.forEach((k) => drawn.push(circle(place(x[k]), 8, {
        fill: COLOURS.sample, stroke: "#000000", class: "sample",
      })));
    }
    plot.replaceChildren(...drawn);
  }

  function drawMatches() {
    const shown = shownModel();
    const members = new Set(shown ? shown.consensus : []);
    const sample = state.shown === "last" && search.last ? search.last.sample : [];
    const size = data.images[0].size[0] / 110;
    [[left, problem.x1, 0], [right, problem.x2, 1]].forEach(([view, x, i]) => {
      const drawn = [];
      const marked = sample.length || !shown ? sample : shown.consensus.filter((_, k) => k % 12 === 0);
      if (shown && shown.model && i === 1)
        marked.forEach((k) => {
          const ends = clip(lineOf(shown.model, problem.x1[k]), data.images[1].size);
          if (ends) drawn.push(...casedLine(ends, COLOURS.line, "model-line"));
        });
      x.forEach((p, k) => drawn.push(circle(p, 0.8 * size, {
        fill: members.has(k) ? COLOURS.plane : COLOURS.wrong, stroke: "#000000",
      })));
      sample.forEach((k) => drawn.push(circle(x[k], 1.5 * size, {
        fill: COLOURS.sample, stroke: "#000000", class: "sample",
      })));
      view.overlay.replaceChildren(...drawn);
    });
  }

  // The number of samples over the share of wrong matches, for the common sample sizes.
  function drawRule() {
    const [x0, y0, width, height] = [58, 20, 340, 186];
    const place = (share, n) => [
      x0 + (width * share) / 0.8, y0 + height - (height * Math.log10(n)) / 6,
    ];
    const drawn = [svg("rect", {
      x: x0, y: y0, width, height, fill: "#ffffff", stroke: "#888888",
    })];
    const note = (x, words_, more = {}) => text(x, words_, {
      "font-size": 13, fill: COLOURS.ink, ...more,
    });
    [0, 1, 2, 3, 4, 5, 6].forEach((k) => {
      const [x, y] = place(0, 10 ** k);
      drawn.push(
        polyline([[x, y], [x + width, y]], { stroke: "#dddddd", "stroke-width": 1 }),
        note([x - 8, y + 4], k < 3 ? String(10 ** k) : `10${"⁰¹²³⁴⁵⁶"[k]}`, { "text-anchor": "end" }),
      );
    });
    [0, 0.2, 0.4, 0.6, 0.8].forEach((v) => drawn.push(note(
      [place(v, 1)[0], y0 + height + 16], v.toFixed(1), { "text-anchor": "middle" },
    )));
    drawn.push(
      note([x0 + width / 2, y0 + height + 34], "share of wrong matches, 1 - w", {
        "text-anchor": "middle",
      }),
      note([x0, y0 - 7], "number of samples N, for p = 0.99"),
    );
    [[2, "line, s = 2"], [4, "H, s = 4"], [5, "E, s = 5"], [7, "F, s = 7"]].forEach(([s, name]) => {
      const curve = Array.from({ length: 41 }, (_, k) => 0.02 * k)
        .map((v) => place(v, Math.max(1, samplesNeeded(CONFIDENCE, 1 - v, s))));
      const mine = s === problem.sampleSize;
      drawn.push(
        polyline(curve, {
          stroke: mine ? COLOURS.camera2 : "#888888", "stroke-width": mine ? 3 : 1.5,
        }),
        note([curve[40][0] + 6, curve[40][1] + 4], name, { "font-weight": mine ? 700 : 400 }),
      );
    });
    drawn.push(circle(place(state.wrong, samplesNeeded(CONFIDENCE, 1 - state.wrong, problem.sampleSize)),
      6, { fill: COLOURS.camera2, stroke: "#000000" }));
    if (search.best) {
      const w = search.best.consensus.length / problem.n;
      const shown = Math.min(0.8, 1 - w);
      drawn.push(circle(place(shown, Math.min(1e6, samplesNeeded(CONFIDENCE, 1 - shown, problem.sampleSize))),
        6, { fill: COLOURS.right, stroke: "#000000" }));
    }
    rule.replaceChildren(...drawn);
  }

  function explain() {
    const { last, best } = search;
    const unit_ = state.problem === "line" ? "points" : "matches";
    const lines = [];
    if (last === null) lines.push("Draw a sample: the model through it, and its consensus set.");
    else lines.push(`Sample ${search.drawn}: ${last.consensus.length} of ${problem.n} ${unit_} `
      + `in the consensus set${last.improved ? ", the best so far" : ""}.`);
    if (best !== null) {
      const w = best.consensus.length / problem.n;
      lines.push(`Best so far: ${best.consensus.length} ${unit_}, from sample ${best.drawn}`
        + `${best.optimised ? " after local optimisation" : ""}; `
        + `error ${errorOf(problem.error(best.model))}.`);
      lines.push(`N = log(1 - ${CONFIDENCE}) / log(1 - ${w.toFixed(2)}^${problem.sampleSize}) = `
        + `${search.needed.toLocaleString("en")}: `
        + (finished(search) ? "the search may stop." : `${search.needed - search.drawn} more samples.`));
    }
    words.replaceChildren(...lines.map((line) => html("p", {}, line)));
    drawComparison();
  }

  const errorOf = (v) => (state.problem === "line" ? `${v.toFixed(2)}°` : `${v.toFixed(2)} px`);

  function drawComparison() {
    const compared = state.comparison;
    if (compared === null) {
      table.replaceChildren(button("compare many searches", compare));
      return;
    }
    const cell = (words_, kind = "td") => html(kind, {}, words_);
    const head = ["score", "local optimisation", "median samples", "median error"];
    table.replaceChildren(html(
      "table", {},
      html("tr", {}, ...head.map((name) => cell(name, "th"))),
      ...compared.rows.map((row) => html(
        "tr", {}, cell(SCORES_SHOWN[row.score]), cell(row.optimise ? "on" : "off"),
        cell(String(row.drawn)), cell(errorOf(row.error)),
      )),
    ), html("small", {}, `${compared.done} of ${compared.searches} searches`
      + `${state.problem === "line" ? "" : `, at most ${LIMIT} samples each`}`));
  }

  const row = (label, control) => html("div", {}, html("b", {}, `${label} `), control.element);
  const controls = html(
    "div", { class: "controls" },
    row("model", problemChoice), buttons,
    html("div", { class: "sliders" }, wrongSlider.element, thresholdSlider.element),
    row("local optimisation", optimiseChoice), row("score", scoreChoice), row("show", shownChoice),
    words, rule, table,
  );
  restart();
  const entries = [
    [COLOURS.sample, "sample and its model", "dot"], [COLOURS.camera1, "consensus set", "dot"],
    [COLOURS.wrong, "outliers", "dot"], [COLOURS.right, "best so far"],
    [COLOURS.camera2, "N for the true share", "dot"], [COLOURS.right, "N for the best so far", "dot"],
  ];
  const refresh = mount(el, model, "RANSAC, step by step", [
    legend(entries), html("div", { class: "pair" }, html("div", {}, lineFigure, pictures), controls),
  ], state, update);
}

export default { render };
