// Small dense linear algebra. A vector is an array, a matrix an array of rows.

export const dot = (a, b) => {
  let sum = 0;
  for (let k = 0; k < a.length; k++) sum += a[k] * b[k];
  return sum;
};
export const norm = (a) => Math.sqrt(dot(a, a));
export const plus = (a, b) => a.map((v, k) => v + b[k]);
export const minus = (a, b) => a.map((v, k) => v - b[k]);
export const times = (a, factor) => a.map((v) => v * factor);
export const unit = (a) => times(a, 1 / norm(a));
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const homogeneous = (x) => [x[0], x[1], 1];
export const inhomogeneous = (x) => [x[0] / x[2], x[1] / x[2]];

export const identity = (n) =>
  Array.from({ length: n }, (_, i) => Array.from({ length: n }, (_, j) => (i === j ? 1 : 0)));
export const transpose = (A) => A[0].map((_, j) => A.map((row) => row[j]));
export const apply = (A, x) => A.map((row) => dot(row, x));
export const multiply = (A, B) => {
  const columns = transpose(B);
  return A.map((row) => columns.map((column) => dot(row, column)));
};
export const determinant = (A) => dot(A[0], cross(A[1], A[2]));

// The inverse of a 3x3 matrix.
export function inverse(A) {
  const [a, b, c] = A;
  const columns = [cross(b, c), cross(c, a), cross(a, b)];
  return transpose(columns.map((column) => times(column, 1 / determinant(A))));
}

// [t]x, the matrix with skew(t) x = t × x.
export const skew = ([x, y, z]) => [
  [0, -z, y],
  [z, 0, -x],
  [-y, x, 0],
];

const RADIANS = Math.PI / 180;

// The rotation Rz(c) Ry(b) Rx(a) of three angles in degrees.
export function rotationOf(angles) {
  const [sa, sb, sc] = angles.map((v) => Math.sin(v * RADIANS));
  const [ca, cb, cc] = angles.map((v) => Math.cos(v * RADIANS));
  return [
    [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
    [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
    [-sb, cb * sa, cb * ca],
  ];
}

// The angles in degrees of a rotation; the second one is between -90 and 90.
export function anglesOf(R) {
  const b = -Math.asin(Math.max(-1, Math.min(1, R[2][0])));
  return [Math.atan2(R[2][1], R[2][2]), b, Math.atan2(R[1][0], R[0][0])].map((v) => v / RADIANS);
}

// Singular value decomposition A = U diag(s) V^T by one-sided Jacobi rotations, s descending.
// Returns the columns of U and V as rows.
export function svd(A) {
  const columns = transpose(A).map((column) => column.slice());
  const n = columns.length;
  const V = identity(n);
  for (let sweep = 0; sweep < 30; sweep++) {
    let rotated = false;
    for (let p = 0; p < n - 1; p++) {
      for (let q = p + 1; q < n; q++) {
        const a = dot(columns[p], columns[p]);
        const b = dot(columns[q], columns[q]);
        const c = dot(columns[p], columns[q]);
        if (Math.abs(c) <= 1e-14 * Math.sqrt(a * b) || a * b < 1e-56) continue;
        rotated = true;
        const zeta = (b - a) / (2 * c);
        const tangent = Math.sign(zeta || 1) / (Math.abs(zeta) + Math.sqrt(1 + zeta * zeta));
        const cosine = 1 / Math.sqrt(1 + tangent * tangent);
        for (const M of [columns, V]) {
          const [x, y] = [M[p], M[q]];
          for (let k = 0; k < x.length; k++) {
            const v = x[k];
            x[k] = cosine * (v - tangent * y[k]);
            y[k] = cosine * (y[k] + tangent * v);
          }
        }
      }
    }
    if (!rotated) break;
  }
  const values = columns.map(norm);
  const order = values.map((_, k) => k).sort((i, j) => values[j] - values[i]);
  return {
    U: order.map((k) => times(columns[k], 1 / (values[k] || 1))),
    s: order.map((k) => values[k]),
    V: order.map((k) => V[k]),
  };
}

export const median = (values) => {
  if (!values.length) return NaN;
  const sorted = Float64Array.from(values).sort();
  return sorted[(sorted.length - 1) >> 1]; // the lower one of two, like torch.median
};

// Hartley's normalisation: the similarity that moves the centroid of points to the origin and makes
// their root mean square distance from it √2.
export function normalisation(x) {
  const centre = [0, 1].map((k) => x.reduce((sum, p) => sum + p[k], 0) / x.length);
  const square = x.reduce((sum, p) => sum + (p[0] - centre[0]) ** 2 + (p[1] - centre[1]) ** 2, 0);
  const s = Math.sqrt((2 * x.length) / (square || 2 * x.length));
  return [
    [s, 0, -s * centre[0]],
    [0, s, -s * centre[1]],
    [0, 0, 1],
  ];
}
