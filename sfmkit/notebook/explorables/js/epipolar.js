// Two-view geometry: X2 = R X1 + t, x2^T F x1 = 0, pixels with centres at integers.
import {
  apply, cross, determinant, dot, homogeneous, inhomogeneous, inverse, minus, multiply, norm,
  normalisation, plus, skew, svd, times, transpose,
} from "./algebra.js";

export const essential = (R, t) => multiply(skew(t), R);
export const fundamental = (R, t, K1, K2) =>
  multiply(transpose(inverse(K2)), multiply(essential(R, t), inverse(K1)));

// The line (a, b, c) in image 2 of a pixel of image 1, with a² + b² = 1.
export function lineOf(F, x) {
  const l = apply(F, homogeneous(x));
  return times(l, 1 / Math.hypot(l[0], l[1]));
}

export const distanceToLine = (l, x) => Math.abs(dot(l, homogeneous(x))) / Math.hypot(l[0], l[1]);

// The null vector of a 3x3 matrix of rank 2.
function nullVector(A) {
  const candidates = [cross(A[0], A[1]), cross(A[1], A[2]), cross(A[2], A[0])];
  return candidates.reduce((best, v) => (norm(v) > norm(best) ? v : best));
}

// Both epipoles, homogeneous pixels: F e1 = 0 and F^T e2 = 0.
export const epipoles = (F) => [nullVector(F), nullVector(transpose(F))];

// The signed Sampson distance of a match, pixels. Without arrays, because it is the inner loop.
export function sampson([f, g, h], [x, y], [u, v]) {
  const a = f[0] * x + f[1] * y + f[2];
  const b = g[0] * x + g[1] * y + g[2];
  const c = h[0] * x + h[1] * y + h[2];
  const d = f[0] * u + g[0] * v + h[0];
  const e = f[1] * u + g[1] * v + h[1];
  return (u * a + v * b + c) / Math.sqrt(a * a + b * b + d * d + e * e);
}

// The two points where a line enters and leaves an image of w x h pixels; null if it misses it.
export function clip(l, [w, h]) {
  const [a, b, c] = l;
  const [x0, y0, x1, y1] = [-0.5, -0.5, w - 0.5, h - 0.5];
  const found = [];
  const offer = (x, y) => {
    const inside = x >= x0 - 1e-9 && x <= x1 + 1e-9 && y >= y0 - 1e-9 && y <= y1 + 1e-9;
    if (inside && found.every((p) => Math.hypot(p[0] - x, p[1] - y) > 1e-6)) found.push([x, y]);
  };
  if (Math.abs(b) > 1e-12) for (const x of [x0, x1]) offer(x, -(a * x + c) / b);
  if (Math.abs(a) > 1e-12) for (const y of [y0, y1]) offer(-(b * y + c) / a, y);
  return found.length < 2 ? null : found.slice(0, 2);
}

// The point halfway between two viewing rays, in the frame of camera 1; null for parallel rays.
export function triangulate(K1, K2, R, t, x1, x2) {
  const d1 = apply(inverse(K1), homogeneous(x1));
  const d2 = apply(transpose(R), apply(inverse(K2), homogeneous(x2)));
  const centre = times(apply(transpose(R), t), -1);
  const [a, b, c] = [dot(d1, d1), dot(d1, d2), dot(d2, d2)];
  const determinantOfRays = a * c - b * b;
  if (determinantOfRays < 1e-12 * a * c) return null;
  const s = (c * dot(d1, centre) - b * dot(d2, centre)) / determinantOfRays;
  const u = (b * dot(d1, centre) - a * dot(d2, centre)) / determinantOfRays;
  return times(plus(times(d1, s), plus(centre, times(d2, u))), 0.5);
}

export const project = (K, X) => inhomogeneous(apply(K, X));
export const pointInCamera = (R, t, X) => plus(apply(R, X), t);

const equationsOf = (y1, y2) =>
  y1.map(([x, y], k) => {
    const [u, v] = y2[k];
    return [u * x, u * y, u, v * x, v * y, v, x, y, 1];
  });
const asMatrix = (f) => [f.slice(0, 3), f.slice(3, 6), f.slice(6, 9)];

function normalised(x1, x2) {
  const [T1, T2] = [normalisation(x1), normalisation(x2)];
  const moved = (T, x) => x.map((p) => inhomogeneous(apply(T, homogeneous(p))));
  return { T1, T2, equations: equationsOf(moved(T1, x1), moved(T2, x2)) };
}

// The normalised eight-point algorithm; null for fewer than eight matches.
export function fundamental8(x1, x2) {
  if (x1.length < 8) return null;
  const { T1, T2, equations } = normalised(x1, x2);
  const { U, s, V } = svd(asMatrix(svd(equations).V[8]));
  const F = [0, 1, 2].map((i) =>
    [0, 1, 2].map((j) => U[0][i] * s[0] * V[0][j] + U[1][i] * s[1] * V[1][j]),
  );
  return multiply(transpose(T2), multiply(F, T1));
}

// The one to three fundamental matrices of seven matches.
export function fundamental7(x1, x2) {
  const { T1, T2, equations } = normalised(x1, x2);
  const { V } = svd(equations);
  const [A, B] = [asMatrix(V[7]), asMatrix(V[8])];
  const mix = (a) => A.map((row, i) => row.map((v, j) => a * v + (1 - a) * B[i][j]));
  // det(a A + (1 - a) B) is a cubic in a; four of its values give its coefficients.
  const [d0, d1, d2, d3] = [0, 1, -1, 2].map((a) => determinant(mix(a)));
  const c2 = (d1 + d2) / 2 - d0;
  const c3 = (d3 - d0 - 4 * c2 - (d1 - d2)) / 6;
  const c1 = (d1 - d2) / 2 - c3;
  return realRoots(c3, c2, c1, d0).map((a) =>
    multiply(transpose(T2), multiply(mix(a), T1)),
  );
}

// The real roots of a x³ + b x² + c x + d.
export function realRoots(a, b, c, d) {
  const largest = Math.max(Math.abs(b), Math.abs(c), Math.abs(d));
  if (Math.abs(a) < 1e-12 * largest) {
    const root = Math.sqrt(c * c - 4 * b * d);
    return Math.abs(b) < 1e-12 * largest
      ? [-d / c]
      : [(-c + root) / (2 * b), (-c - root) / (2 * b)].filter(Number.isFinite);
  }
  [b, c, d] = [b / a, c / a, d / a];
  const q = (b * b - 3 * c) / 9;
  const r = (2 * b ** 3 - 9 * b * c + 27 * d) / 54;
  if (r * r < q ** 3) {
    const angle = Math.acos(r / Math.sqrt(q ** 3));
    return [0, 1, 2].map(
      (k) => -2 * Math.sqrt(q) * Math.cos((angle + 2 * Math.PI * k) / 3) - b / 3,
    );
  }
  const e = -Math.sign(r) * Math.cbrt(Math.abs(r) + Math.sqrt(r * r - q ** 3));
  return [e + (e === 0 ? 0 : q / e) - b / 3];
}
