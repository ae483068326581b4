// The verdict of sfmkit.estimation.verdict: depth, a plane or a pure rotation, by Torr's criterion.
import {
  apply, determinant, homogeneous, inhomogeneous, inverse, median, multiply, svd, transpose, unit,
} from "./algebra.js";
import { sampson } from "./epipolar.js";
import { homographySampson } from "./homography.js";

const MIN_SIGMA = 0.1; // pixels

// Torr's criterion of squared residuals; smaller is better.
export function gric(squares, sigma, dimension, parameters) {
  const [n, r] = [squares.length, 4];
  const rho = squares.reduce(
    (sum, square) => sum + Math.min(square / sigma ** 2, 2 * (r - dimension)),
    0,
  );
  return rho + Math.log(r) * dimension * n + Math.log(r * n) * parameters;
}

// The rotation nearest to U V^T of a decomposition.
function rotationFrom({ U, V }) {
  const product = multiply(transpose(U), V);
  const sign = determinant(product);
  const signed = [U[0], U[1], U[2].map((v) => v * sign)];
  return multiply(transpose(signed), V);
}

export const nearestRotation = (A) =>
  rotationFrom(svd(A.map((row) => row.map((v) => v * Math.sign(determinant(A))))));

export function rotatePixel(R, x, K1inverse, K2) {
  return inhomogeneous(apply(K2, apply(R, apply(K1inverse, homogeneous(x)))));
}

// The rotation that turns the rays of x1 into those of x2: Kabsch with Cauchy weights.
export function fitRotation(x1, x2, K1, K2, start, scale) {
  const [K1inverse, K2inverse] = [inverse(K1), inverse(K2)];
  const f1 = x1.map((x) => unit(apply(K1inverse, homogeneous(x))));
  const f2 = x2.map((x) => unit(apply(K2inverse, homogeneous(x))));
  let R = start;
  for (let k = 0; k < 20; k++) {
    const M = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
    x1.forEach((x, n) => {
      const p = rotatePixel(R, x, K1inverse, K2);
      const w = 1 / (1 + ((p[0] - x2[n][0]) ** 2 + (p[1] - x2[n][1]) ** 2) / scale ** 2);
      for (let i = 0; i < 3; i++)
        for (let j = 0; j < 3; j++) M[i][j] += w * f2[n][i] * f1[n][j];
    });
    const next = rotationFrom(svd(M));
    const turned = multiply(next, transpose(R));
    R = next;
    if (Math.abs(turned[0][0] + turned[1][1] + turned[2][2] - 3) < 1e-14) break;
  }
  return R;
}

// Compare the explanations of matches for a fundamental matrix F and a homography H.
export function compare(x1, x2, K1, K2, F, H, threshold) {
  const rows = x1.map((_, k) => k);
  const eF = rows.map((k) => sampson(F, x1[k], x2[k]) ** 2);
  const eH = rows.map((k) => homographySampson(H, x1[k], x2[k]));
  const inliers = rows.filter((k) => eF[k] < threshold ** 2);
  const considered = rows.filter((k) => eF[k] < threshold ** 2 || eH[k] < threshold ** 2);
  const pick = (values, chosen) => chosen.map((k) => values[k]);
  const sigma = Math.max(1.4826 * median(pick(eF, inliers).map(Math.sqrt)), MIN_SIGMA);
  const start = nearestRotation(multiply(inverse(K2), multiply(H, K1)));
  const R = fitRotation(pick(x1, considered), pick(x2, considered), K1, K2, start, sigma);
  const HofR = multiply(K2, multiply(R, inverse(K1)));
  const eR = rows.map((k) => homographySampson(HofR, x1[k], x2[k]));
  const scores = {
    general: gric(pick(eF, considered), sigma, 3, 5),
    planar: gric(pick(eH, considered), sigma, 2, 8),
    rotation: gric(pick(eR, considered), sigma, 2, 3),
  };
  const off = (squares) =>
    pick(squares, inliers).filter((v) => v > (3 * sigma) ** 2).length / inliers.length;
  const verdict = Object.keys(scores).reduce((a, b) => (scores[b] < scores[a] ? b : a));
  return { verdict, scores, sigma, inliers, offPlane: off(eH), offRotation: off(eR) };
}
