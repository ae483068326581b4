// RANSAC: samples, scores, the stopping rule, and a search that proceeds one sample at a time.

// A reproducible generator of numbers between 0 and 1 (mulberry32).
export function random(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let z = state;
    z = Math.imul(z ^ (z >>> 15), z | 1);
    z ^= z + Math.imul(z ^ (z >>> 7), z | 61);
    return ((z ^ (z >>> 14)) >>> 0) / 4294967296;
  };
}

// A number with zero mean and unit variance (Box and Muller).
export const gaussian = (generator) =>
  Math.sqrt(-2 * Math.log(1 - generator())) * Math.cos(2 * Math.PI * generator());

// s different numbers below n.
export function draw(generator, n, s) {
  const chosen = [];
  while (chosen.length < s) {
    const k = Math.floor(generator() * n);
    if (!chosen.includes(k)) chosen.push(k);
  }
  return chosen;
}

// N = log(1 - p) / log(1 - w^s), rounded up.
export function samplesNeeded(p, w, s) {
  const allInliers = w ** s;
  if (allInliers <= 0) return Infinity;
  if (allInliers >= 1) return 1;
  return Math.ceil(Math.log1p(-p) / Math.log1p(-allInliers));
}

const QUANTILE = 3.643721; // 99 % of chi with 4 degrees of freedom
const LARGEST = QUANTILE ** 2 / 2;
const GAMMA = Math.sqrt(Math.PI) / 2; // Γ(3/2)

// The lower incomplete gamma function γ(3/2, u), from its series.
function incompleteGamma(u) {
  let term = u ** 1.5 * Math.exp(-u) / 1.5;
  let sum = term;
  for (let k = 1; k < 60; k++) {
    term *= u / (1.5 + k);
    sum += term;
  }
  return sum;
}

const CUT = GAMMA - incompleteGamma(LARGEST);
const MAXIMUM = 1.5 * (GAMMA - CUT) - LARGEST ** 1.5 * Math.exp(-LARGEST);

// The marginal score of MAGSAC++: 1 at distance 0, 0 from the threshold on.
export function marginalScore(square, threshold) {
  const u = Math.min((square * LARGEST) / threshold ** 2, LARGEST);
  const lower = incompleteGamma(u);
  const loss = u * (GAMMA - CUT - lower) + 1.5 * lower - u ** 1.5 * Math.exp(-u);
  return 1 - loss / MAXIMUM;
}

export const SCORES = {
  count: (square, threshold) => (square <= threshold ** 2 ? 1 : 0),
  marginal: marginalScore,
};

// The score of a model over all matches, and its consensus set.
export function evaluate(problem, model, settings) {
  const score = SCORES[settings.score];
  const consensus = [];
  let total = 0;
  problem.squares(model).forEach((square, k) => {
    total += score(square, settings.threshold);
    if (square <= settings.threshold ** 2) consensus.push(k);
  });
  return { model, total, consensus };
}

// A search without samples. A problem has n, sampleSize, solve(rows) -> models,
// squares(model) -> squared distances, and fit(rows) -> a least-squares model or null.
export const newSearch = (seed) => ({
  generator: random(seed), drawn: 0, last: null, best: null, needed: Infinity, history: [],
});

// Draw one sample; keep its best model if it scores higher than the best so far.
export function step(search, problem, settings) {
  const sample = draw(search.generator, problem.n, problem.sampleSize);
  search.drawn += 1;
  const candidates = problem.solve(sample).map((model) => evaluate(problem, model, settings));
  const top = candidates.reduce((a, b) => (a === null || b.total > a.total ? b : a), null);
  search.last = { sample, ...(top ?? { model: null, total: 0, consensus: [] }), improved: false };
  if (top === null || (search.best !== null && top.total <= search.best.total)) return;
  search.last.improved = true;
  search.best = { ...top, drawn: search.drawn, optimised: false };
  if (settings.optimise) optimise(search, problem, settings);
  search.needed = samplesNeeded(
    settings.confidence, search.best.consensus.length / problem.n, problem.sampleSize,
  );
  search.history.push({
    drawn: search.drawn, consensus: search.best.consensus.length, needed: search.needed,
  });
}

// Local optimisation: fit to the consensus set while the score increases.
function optimise(search, problem, settings) {
  for (let k = 0; k < 5; k++) {
    const model = problem.fit(search.best.consensus);
    if (model === null) return;
    const fitted = evaluate(problem, model, settings);
    if (fitted.total <= search.best.total) return;
    Object.assign(search.best, fitted, { optimised: true });
  }
}

export const finished = (search) => search.drawn >= search.needed;

// A whole search, of at most `limit` samples.
export function runSearch(problem, settings, seed, limit = 2000) {
  const search = newSearch(seed);
  while (!finished(search) && search.drawn < limit) step(search, problem, settings);
  return search;
}
