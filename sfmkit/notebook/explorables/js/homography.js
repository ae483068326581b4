// Homographies x2 = H x1 in pixels.
import {
  apply, homogeneous, inhomogeneous, inverse, multiply, normalisation, plus, svd, times,
} from "./algebra.js";
import { draw, random } from "./robust.js";

// K2 (R + t n^T / d) K1^-1: the homography of the plane n · X1 = d.
export const homographyOfPlane = (R, t, n, d, K1, K2) =>
  multiply(K2, multiply(R.map((row, i) => plus(row, times(n, t[i] / d))), inverse(K1)));

// The normalised direct linear transform of four or more matches.
export function homographyDlt(x1, x2) {
  const [T1, T2] = [normalisation(x1), normalisation(x2)];
  const equations = x1.flatMap((p, k) => {
    const [x, y] = inhomogeneous(apply(T1, homogeneous(p)));
    const [u, v] = inhomogeneous(apply(T2, homogeneous(x2[k])));
    return [
      [x, y, 1, 0, 0, 0, -u * x, -u * y, -u],
      [0, 0, 0, x, y, 1, -v * x, -v * y, -v],
    ];
  });
  const h = svd(equations).V[8];
  const H = [h.slice(0, 3), h.slice(3, 6), h.slice(6, 9)];
  return multiply(inverse(T2), multiply(H, T1));
}

// The squared Sampson distance of a match, square pixels: e^T (J J^T)^-1 e of the two equations
// e = (a - u w, b - v w) with (a, b, w) = H x1. Without arrays, because it is the inner loop.
export function homographySampson([f, g, h], [x, y], [u, v]) {
  const w = h[0] * x + h[1] * y + h[2];
  const d = f[0] * x + f[1] * y + f[2] - u * w;
  const e = g[0] * x + g[1] * y + g[2] - v * w;
  const [a1, a2] = [f[0] - u * h[0], f[1] - u * h[1]];
  const [b1, b2] = [g[0] - v * h[0], g[1] - v * h[1]];
  const p = a1 * a1 + a2 * a2 + w * w;
  const q = a1 * b1 + a2 * b2;
  const r = b1 * b1 + b2 * b2 + w * w;
  return (r * d * d - 2 * q * d * e + p * e * e) / (p * r - q * q);
}

// The homography that most matches support, from samples of four and fits to the consensus set.
export function robustHomography(x1, x2, threshold, samples = 60) {
  const generator = random(7);
  const pick = (x, rows) => rows.map((k) => x[k]);
  const cost = (H) =>
    x1.reduce(
      (sum, p, k) => sum + Math.min(homographySampson(H, p, x2[k]) / threshold ** 2 || 0, 1),
      0,
    );
  let best = null;
  const consider = (H) => {
    const c = cost(H);
    if (Number.isFinite(c) && (best === null || c < best.cost)) best = { H, cost: c };
  };
  for (let k = 0; k < samples; k++) {
    const rows = draw(generator, x1.length, 4);
    consider(homographyDlt(pick(x1, rows), pick(x2, rows)));
  }
  for (let k = 0; k < 5; k++) {
    const inside = x1
      .map((_, i) => i)
      .filter((i) => homographySampson(best.H, x1[i], x2[i]) < threshold ** 2);
    if (inside.length < 4) break;
    consider(homographyDlt(pick(x1, inside), pick(x2, inside)));
  }
  return best.H;
}
