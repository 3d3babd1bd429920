// Corners at which two dark and two light squares meet: saddle points of the grey levels.

const MIN_STEP = 10; // grey levels between dark and light
const LEAST_OF_STRONG = 0.15; // of the strong ones' step: a part of a board that lies in a shadow; grain is weaker
const STRONG = 9; // points; the smallest board that is found has as many
const MOST_POINTS = 700; // the strongest are kept
const SMOOTH_VARIANCE = 1.25; // px^2, of `smoothed` and a pixel's own aperture
const RING_PX = 3; // a corner's surroundings change four times between dark and light on a circle of this radius
const RING_STEP = Math.PI / 8;
const RING = Array.from({ length: 16 }, (_, k) => [RING_PX * Math.cos(k * RING_STEP), RING_PX * Math.sin(k * RING_STEP)]);

/** The frame blurred by (1 4 6 4 1) / 16 along rows and columns: Float32Array. */
export function smoothed(gray, width, height) {
  const rows = new Float32Array(width * height);
  const out = new Float32Array(width * height);
  for (let y = 0; y < height; y += 1) {
    const at = y * width;
    for (let x = 2; x < width - 2; x += 1) {
      const i = at + x;
      rows[i] = (gray[i - 2] + gray[i + 2] + 4 * (gray[i - 1] + gray[i + 1]) + 6 * gray[i]) / 16;
    }
    for (const x of [0, 1, width - 2, width - 1]) rows[at + x] = gray[at + x];
  }
  out.set(rows);
  for (let i = 2 * width; i < (height - 2) * width; i += 1) {
    out[i] = (rows[i - 2 * width] + rows[i + 2 * width] + 4 * (rows[i - width] + rows[i + width]) + 6 * rows[i]) / 16;
  }
  return out;
}

/** Bilinear grey level; NaN outside. */
export function levelAt({ data, width, height }, x, y) {
  if (!(x >= 0 && y >= 0 && x < width - 1 && y < height - 1)) return NaN;
  const [left, top] = [Math.floor(x), Math.floor(y)];
  const [u, v] = [x - left, y - top];
  const i = top * width + left;
  return (1 - v) * ((1 - u) * data[i] + u * data[i + 1]) + v * ((1 - u) * data[i + width] + u * data[i + width + 1]);
}

/**
 * The strongest saddle points of a smoothed image {data, width, height}: {x, y, step, axes}.
 * step: grey levels between dark and light of an ideal corner as curved. axes: four unit vectors [x, y] along the edges
 * that meet, by increasing angle; between axes 0 and 1 and between 2 and 3 it is light.
 */
export function saddlePoints(image) {
  const { data, width, height } = image;
  const strength = new Float32Array(width * height);
  const least = (MIN_STEP / (Math.PI * SMOOTH_VARIANCE)) ** 2;
  for (let y = 3; y < height - 3; y += 1) {
    for (let i = y * width + 3, end = (y + 1) * width - 3; i < end; i += 1) {
      const twice = 2 * data[i];
      const xx = data[i - 1] + data[i + 1] - twice;
      const yy = data[i - width] + data[i + width] - twice;
      const xy = (data[i - width - 1] + data[i + width + 1] - data[i - width + 1] - data[i + width - 1]) / 4;
      const determinant = xy * xy - xx * yy;
      if (determinant > least) strength[i] = determinant;
    }
  }
  const peaks = [];
  for (let y = 3; y < height - 3; y += 1) {
    for (let i = y * width + 3, end = (y + 1) * width - 3; i < end; i += 1) {
      if (strength[i] > 0 && isPeak(strength, width, i)) peaks.push(i);
    }
  }
  peaks.sort((a, b) => strength[b] - strength[a]);
  const points = [];
  for (const i of peaks) {
    const point = cornerAt(image, i % width, Math.floor(i / width));
    if (point !== null) points.push(point);
    const isWeak = points.length >= STRONG && strength[i] < LEAST_OF_STRONG ** 2 * strength[peaks[STRONG - 1]];
    if (isWeak || points.length === MOST_POINTS) break;
  }
  return points;
}

function isPeak(strength, width, i) {
  const value = strength[i];
  for (let dy = -2; dy <= 2; dy += 1) {
    for (let j = i + dy * width - 2; j <= i + dy * width + 2; j += 1) {
      if (strength[j] > value || (strength[j] === value && j < i)) return false;
    }
  }
  return true;
}

/** The corner near a place as in saddlePoints, by the quadratic surface through 5 x 5 levels; null: there is none within 2 px. */
export function cornerAt(image, x0, y0) {
  const { data, width, height } = image;
  let [x, y] = [Math.round(x0), Math.round(y0)];
  let surface = null;
  for (let round = 0; round < 3; round += 1) {
    if (!(x >= 2 && y >= 2 && x < width - 2 && y < height - 2)) return null;
    surface = quadratic(data, width, y * width + x);
    const { gx, gy, xx, xy, yy } = surface;
    const determinant = xx * yy - xy * xy;
    if (determinant >= 0) return null;
    surface.dx = (xy * gy - yy * gx) / determinant;
    surface.dy = (xy * gx - xx * gy) / determinant;
    const [nextX, nextY] = [x + Math.round(surface.dx), y + Math.round(surface.dy)];
    if (nextX === x && nextY === y) break;
    if (Math.abs(surface.dx) > 2 || Math.abs(surface.dy) > 2) return null;
    if (round < 2) [x, y] = [nextX, nextY];
  }
  const { xx, xy, yy, dx, dy } = surface;
  if (Math.hypot(x + dx - x0, y + dy - y0) > 2) return null;
  const axes = edgesAround(image, x + dx, y + dy);
  if (axes === null) return null;
  return { x: x + dx, y: y + dy, step: Math.PI * SMOOTH_VARIANCE * Math.sqrt(xy * xy - xx * yy), axes };
}

/** Directions in which edges leave a corner, the first one from dark to light by increasing angle; null: not four. */
function edgesAround(image, x, y) {
  const levels = RING.map(([dx, dy]) => levelAt(image, x + dx, y + dy));
  const middle = (Math.max(...levels) + Math.min(...levels)) / 2; // NaN where one is: no level lies above
  const edges = [];
  for (let k = 0; k < RING.length; k += 1) {
    const [before, after] = [levels[k], levels[(k + 1) % RING.length]];
    if (before > middle === after > middle) continue;
    const angle = (k + (middle - before) / (after - before)) * RING_STEP;
    edges.push({ axis: [Math.cos(angle), Math.sin(angle)], isToLight: after > before });
  }
  if (edges.length !== 4) return null;
  if (!edges[0].isToLight) edges.push(edges.shift());
  return edges.map(({ axis }) => axis);
}

/** Gradient and second derivatives at the middle of the least-squares quadratic of 5 x 5 levels. */
function quadratic(data, width, i) {
  let [all, gx, gy, x2, y2, xy] = [0, 0, 0, 0, 0, 0];
  for (let dy = -2; dy <= 2; dy += 1) {
    for (let dx = -2; dx <= 2; dx += 1) {
      const level = data[i + dy * width + dx];
      all += level;
      gx += dx * level;
      gy += dy * level;
      x2 += dx * dx * level;
      y2 += dy * dy * level;
      xy += dx * dy * level;
    }
  }
  return { gx: gx / 50, gy: gy / 50, xx: (x2 - 2 * all) / 35, yy: (y2 - 2 * all) / 35, xy: xy / 100 };
}

/**
 * [x, y] where the edges that leave a corner meet: each gradient within `reach` px stands at right angles to the line from there
 * (Foerstner and Guelch, 1987), also where the dark squares differ. The start if it is farther than a px away.
 */
export function refinedCorner({ data, width, height }, start, reach) {
  let [x, y] = start;
  for (let round = 0; round < 3; round += 1) {
    let [xx, xy, yy, bx, by] = [0, 0, 0, 0, 0];
    const [left, top] = [Math.ceil(x - reach), Math.ceil(y - reach)];
    if (left < 1 || top < 1 || x + reach > width - 2 || y + reach > height - 2) return start;
    for (let py = top; py <= y + reach; py += 1) {
      for (let px = left; px <= x + reach; px += 1) {
        const i = py * width + px;
        const weight = Math.exp((-2 * ((px - x) ** 2 + (py - y) ** 2)) / reach ** 2);
        const gx = data[i + 1] - data[i - 1];
        const gy = data[i + width] - data[i - width];
        xx += weight * gx * gx;
        xy += weight * gx * gy;
        yy += weight * gy * gy;
        bx += weight * (gx * gx * px + gx * gy * py);
        by += weight * (gx * gy * px + gy * gy * py);
      }
    }
    const determinant = xx * yy - xy * xy;
    if (!(determinant > 0)) return start;
    x = (yy * bx - xy * by) / determinant;
    y = (xx * by - xy * bx) / determinant;
    if (!(Math.hypot(x - start[0], y - start[1]) < 1)) return start;
  }
  return [x, y];
}
