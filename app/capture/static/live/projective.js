// Maps between planes: (u, v) -> (x, y) by a 3 x 3 matrix, row-major.

/** Least-squares homography from places to pixels, each [[x, y], ...] of four or more; null: they lie on a line. */
export function fitHomography(places, pixels) {
  const [a, b] = [normalisation(places), normalisation(pixels)];
  if (a === null || b === null) return null;
  const normal = Array.from({ length: 8 }, () => new Float64Array(9)); // A^T A | A^T b of h11 ... h32, h33 = 1
  const add = (row, value) => {
    for (let i = 0; i < 8; i += 1) {
      for (let j = 0; j < 8; j += 1) normal[i][j] += row[i] * row[j];
      normal[i][8] += row[i] * value;
    }
  };
  for (let n = 0; n < places.length; n += 1) {
    const [u, v] = [(places[n][0] - a.x) * a.scale, (places[n][1] - a.y) * a.scale];
    const [x, y] = [(pixels[n][0] - b.x) * b.scale, (pixels[n][1] - b.y) * b.scale];
    add([u, v, 1, 0, 0, 0, -u * x, -v * x], x);
    add([0, 0, 0, u, v, 1, -u * y, -v * y], y);
  }
  const h = solve(normal);
  if (h === null) return null;
  const before = [a.scale, 0, -a.x * a.scale, 0, a.scale, -a.y * a.scale, 0, 0, 1];
  const after = [1 / b.scale, 0, b.x, 0, 1 / b.scale, b.y, 0, 0, 1];
  return product(after, product([...h, 1], before));
}

function normalisation(points) {
  const mean = [0, 1].map((k) => points.reduce((sum, point) => sum + point[k], 0) / points.length);
  const spread = points.reduce((sum, point) => sum + Math.hypot(point[0] - mean[0], point[1] - mean[1]), 0);
  return spread > 0 ? { x: mean[0], y: mean[1], scale: (Math.SQRT2 * points.length) / spread } : null;
}

/** Solves a system given as rows [coefficients, right side] by elimination with pivots; null: singular. Changes the rows. */
export function solve(rows) {
  const n = rows.length;
  for (let i = 0; i < n; i += 1) {
    let pivot = i;
    for (let k = i + 1; k < n; k += 1) if (Math.abs(rows[k][i]) > Math.abs(rows[pivot][i])) pivot = k;
    [rows[i], rows[pivot]] = [rows[pivot], rows[i]];
    if (!(Math.abs(rows[i][i]) > 1e-9)) return null;
    for (let k = 0; k < n; k += 1) {
      const factor = k === i ? 0 : rows[k][i] / rows[i][i];
      if (factor !== 0) for (let j = i; j <= n; j += 1) rows[k][j] -= factor * rows[i][j];
    }
  }
  return rows.map((row, i) => row[n] / row[i]);
}

export function product(a, b) {
  return Array.from({ length: 9 }, (_, k) => {
    const [i, j] = [3 * Math.floor(k / 3), k % 3];
    return a[i] * b[j] + a[i + 1] * b[j + 3] + a[i + 2] * b[j + 6];
  });
}

/** Area of a polygon of [x, y] whose corners are clockwise, y down; negative: counter-clockwise. */
export function areaPx(corners) {
  return corners.reduce((sum, [x, y], k) => sum + (corners.at(k - 1)[0] * y - x * corners.at(k - 1)[1]) / 2, 0);
}

/** [x, y] of a place; not finite at or beyond the horizon. */
export function mapped(h, u, v) {
  const w = h[6] * u + h[7] * v + h[8];
  return [(h[0] * u + h[1] * v + h[2]) / w, (h[3] * u + h[4] * v + h[5]) / w];
}
