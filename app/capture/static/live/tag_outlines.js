// Dark quadrangles on lighter paper, as the black borders of printed tags.

import { areaPx } from "./projective.js";
import { levelAt } from "./saddle_points.js";

const DARKER = 8; // grey levels below the mean around a place
const WINDOW = 1 / 24; // of the long side: half the width over which the mean is taken
const LEAST_SIDE_PX = 7;
const LEAST_FILLED = 0.85; // of the hull, by the quadrangle
const ALONG_SIDE = [0.2, 0.35, 0.5, 0.65, 0.8];
const REACH_PX = 2.5; // to either side of a coarse edge, where the fine one is sought
const LEAST_EDGE_STEP = 8; // grey levels per px at an edge

/**
 * Quadrangles of a frame, {corners, x, y, axes}: four [x, y] px by increasing angle (clockwise), their middle, and from
 * there the unit vectors to the middles of the sides from corner k to corner k + 1.
 * gray: Uint8Array; image: the same smoothed, {data, width, height}.
 */
export function darkQuadrangles(gray, image) {
  const quadrangles = [];
  for (const hull of darkHulls(gray, image.width, image.height)) {
    const coarse = quadrangleOf(hull);
    const corners = coarse === null ? null : refined(image, coarse);
    if (corners === null) continue;
    const [x, y] = [0, 1].map((k) => corners.reduce((sum, corner) => sum + corner[k] / 4, 0));
    const axes = corners.map((corner, k) => {
      const next = corners[(k + 1) % 4];
      const [dx, dy] = [(corner[0] + next[0]) / 2 - x, (corner[1] + next[1]) / 2 - y];
      return [dx / Math.hypot(dx, dy), dy / Math.hypot(dx, dy)];
    });
    quadrangles.push({ corners, x, y, axes });
  }
  return quadrangles;
}

/** Convex hulls, clockwise, of connected places that are darker than around them and do not touch the frame's border. */
function* darkHulls(gray, width, height) {
  const isDark = darkPlaces(gray, width, height);
  const stack = new Int32Array(width * height);
  for (let start = 0; start < isDark.length; start += 1) {
    if (isDark[start] === 0) continue;
    const top = Math.floor(start / width); // the first place met is in the topmost row
    const [left, right] = [[], []];
    let count = 1;
    stack[0] = start;
    isDark[start] = 0;
    while (count > 0) {
      count -= 1;
      const i = stack[count];
      const y = Math.floor(i / width);
      const x = i - y * width;
      const row = y - top;
      if (!(left[row] <= x)) left[row] = x;
      if (!(right[row] >= x)) right[row] = x;
      for (const next of [i - 1, i + 1, i - width, i + width]) {
        if (isDark[next] === 1) {
          isDark[next] = 0;
          stack[count] = next;
          count += 1;
        }
      }
    }
    if (left.length < LEAST_SIDE_PX) continue;
    const [from, to] = [Math.min(...left), Math.max(...right)];
    const touches = from <= 1 || top <= 1 || to >= width - 2 || top + left.length >= height - 1;
    if (touches || to - from < LEAST_SIDE_PX) continue;
    yield hullOf(left.map((x, row) => [x, top + row]), right.map((x, row) => [x, top + row]));
  }
}

/** Uint8Array, 1 where a place is darker than the mean around it; 0 along the border. */
function darkPlaces(gray, width, height) {
  const sums = new Uint32Array((width + 1) * (height + 1));
  for (let y = 0; y < height; y += 1) {
    let row = 0;
    for (let x = 0; x < width; x += 1) {
      row += gray[y * width + x];
      sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
    }
  }
  const reach = Math.max(6, Math.round(WINDOW * Math.max(width, height)));
  const isDark = new Uint8Array(width * height);
  for (let y = 1; y < height - 1; y += 1) {
    const [top, bottom] = [Math.max(0, y - reach) * (width + 1), Math.min(height, y + reach + 1) * (width + 1)];
    for (let x = 1; x < width - 1; x += 1) {
      const [left, right] = [Math.max(0, x - reach), Math.min(width, x + reach + 1)];
      const area = ((bottom - top) / (width + 1)) * (right - left);
      const sum = sums[bottom + right] - sums[bottom + left] - sums[top + right] + sums[top + left];
      if ((gray[y * width + x] + DARKER) * area < sum) isDark[y * width + x] = 1;
    }
  }
  return isDark;
}

/** Hull of the leftmost and rightmost places of each row, top to bottom: [x, y], clockwise from the top. */
function hullOf(left, right) {
  const side = (points, sign) => {
    const chain = [];
    for (const point of points) {
      while (chain.length > 1 && sign * turn(chain.at(-2), chain.at(-1), point) <= 0) chain.pop();
      chain.push(point);
    }
    return chain;
  };
  return [...side(right, 1), ...side(left, -1).reverse()];
}

/** Twice the area of the triangle a b c; positive: clockwise, y down. */
function turn(a, b, c) {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

/** The hull's corners that span a quadrangle: its longest diagonal and the farthest ones beside it; null: it is no quadrangle. */
function quadrangleOf(hull) {
  let [first, third, longest] = [0, 0, 0];
  for (let i = 0; i < hull.length; i += 1) {
    for (let j = i + 1; j < hull.length; j += 1) {
      const length = Math.hypot(hull[i][0] - hull[j][0], hull[i][1] - hull[j][1]);
      if (length > longest) [first, third, longest] = [i, j, length];
    }
  }
  const farthest = (points, sign) =>
    points.reduce((best, point) => {
      const distance = sign * turn(hull[first], hull[third], point);
      return distance > best.distance ? { point, distance } : best;
    }, { point: null, distance: 0 }).point;
  const [second, fourth] = [farthest(hull, -1), farthest(hull, 1)];
  if (second === null || fourth === null) return null;
  const corners = [hull[first], second, hull[third], fourth];
  const sides = corners.map(([x, y], k) => Math.hypot(x - corners.at(k - 1)[0], y - corners.at(k - 1)[1]));
  if (Math.min(...sides) < LEAST_SIDE_PX - 2) return null;
  return areaPx(corners) >= LEAST_FILLED * areaPx(hull) ? corners : null;
}

/** Corners where the lines through the steepest places of the four edges meet; null: an edge is not sharp or not straight. */
function refined(image, corners) {
  const lines = corners.map((corner, k) => edgeLine(image, corner, corners[(k + 1) % 4]));
  if (lines.includes(null)) return null;
  const fine = lines.map((line, k) => crossing(lines.at(k - 1), line));
  return fine.every(([x, y], k) => Math.hypot(x - corners[k][0], y - corners[k][1]) < 2 * REACH_PX) ? fine : null;
}

/** {point, along} of the line through an edge that is dark on the right (clockwise) side. */
function edgeLine(image, from, to) {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
  const length = Math.hypot(dx, dy);
  const [nx, ny] = [dy / length, -dx / length]; // outwards
  const offsets = [];
  for (const t of ALONG_SIDE) {
    const [x, y] = [from[0] + t * dx, from[1] + t * dy];
    let [best, offset] = [LEAST_EDGE_STEP, null];
    for (let s = -REACH_PX; s <= REACH_PX; s += 0.5) {
      const step = levelAt(image, x + nx * (s + 0.5), y + ny * (s + 0.5)) - levelAt(image, x + nx * (s - 0.5), y + ny * (s - 0.5));
      if (step > best) [best, offset] = [step, s];
    }
    if (offset !== null) offsets.push([t, peak(image, x, y, nx, ny, offset)]);
  }
  if (offsets.length < ALONG_SIDE.length - 1) return null;
  const [t, s] = [0, 1].map((k) => offsets.reduce((sum, pair) => sum + pair[k], 0) / offsets.length);
  const slope =
    offsets.reduce((sum, pair) => sum + (pair[0] - t) * (pair[1] - s), 0) /
    offsets.reduce((sum, pair) => sum + (pair[0] - t) ** 2, 0);
  return {
    point: [from[0] + t * dx + s * nx, from[1] + t * dy + s * ny],
    along: [dx + slope * nx, dy + slope * ny],
  };
}

/** The offset of the steepest place, by a parabola through three steps half a px apart. */
function peak(image, x, y, nx, ny, offset) {
  const [a, b, c] = [-0.5, 0, 0.5].map((more) => {
    const s = offset + more;
    return levelAt(image, x + nx * (s + 0.5), y + ny * (s + 0.5)) - levelAt(image, x + nx * (s - 0.5), y + ny * (s - 0.5));
  });
  const bend = a - 2 * b + c;
  return bend < 0 ? offset + (0.25 * (a - c)) / bend : offset;
}

function crossing({ point: [x, y], along: [dx, dy] }, other) {
  const [ex, ey] = other.along;
  const s = ((other.point[0] - x) * ey - (other.point[1] - y) * ex) / (dx * ey - dy * ex);
  return [x + s * dx, y + s * dy];
}
