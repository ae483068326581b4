// Homographies x2 = H x1 in pixels.
import {
  apply, dot, homogeneous, inhomogeneous, inverse, multiply, normalisation, plus, svd, times,
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

// The squared Sampson distance of a match, square pixels.
export function homographySampson(H, x1, x2) {
  const x = homogeneous(x1);
  const [a, b, w] = apply(H, x);
  const e = [a - x2[0] * w, b - x2[1] * w];
  const J = [0, 1].map((k) => [
    H[k][0] - x2[k] * H[2][0],
    H[k][1] - x2[k] * H[2][1],
    k === 0 ? -w : 0,
    k === 1 ? -w : 0,
  ]);
  const [p, q, r] = [dot(J[0], J[0]), dot(J[0], J[1]), dot(J[1], J[1])];
  return (r * e[0] ** 2 - 2 * q * e[0] * e[1] + p * e[1] ** 2) / (p * r - q * q);
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
