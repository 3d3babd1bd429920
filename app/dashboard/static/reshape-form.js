// A form by hand (docs/review.md) as numbers: its volume as app/vision/hand_form.py computes it, its place in a photograph,
// and what a dragged handle means. Lengths mm in the table frame, z up; cameras as in scene.json.

export const SIDE_MM = [2, 1000];
export const LEAN_DEG = [-60, 60];
const BOX_SHARE = { slab: 1, prism: Math.PI / 4, ellipsoid: Math.PI / 6 };
const CORNERS = 48; // of an ellipse that is drawn
const LEVELS = 8; // of half an ellipsoid that is drawn
const BESIDE_MM = 18; // from the form to the handle that turns it
const RAD = Math.PI / 180;

export function volumeMl(form) {
  return (BOX_SHARE[form.section] * form.length_mm * form.width_mm * form.height_mm) / 1000;
}

/** A place given by shares of the half length and half width, and of the height -> [x, y, z]. */
export function placeOf(form, along, across, up) {
  const [cos, sin] = [Math.cos(form.yaw_deg * RAD), Math.sin(form.yaw_deg * RAD)];
  const z = up * form.height_mm;
  const a = (along * form.length_mm) / 2 + z * Math.tan(form.lean_deg * RAD);
  const b = (across * form.width_mm) / 2;
  return [form.centre_mm[0] + a * cos - b * sin, form.centre_mm[1] + a * sin + b * cos, form.base_mm + z];
}

/** Lines on the surface, each a list of places; the outline is the hull of them all. */
export function linesOf(form) {
  const ring = (up, reach = 1) => {
    const corners = form.section === "slab" ? [[1, 1], [-1, 1], [-1, -1], [1, -1]] : around(CORNERS);
    return [...corners, corners[0]].map(([x, y]) => placeOf(form, reach * x, reach * y, up));
  };
  if (form.section === "ellipsoid") {
    const levels = Array.from({ length: 2 * LEVELS + 1 }, (_, i) => (i * Math.PI) / (2 * LEVELS));
    const meridian = ([x, y]) => levels.map((t) => placeOf(form, x * Math.sin(t), y * Math.sin(t), (1 - Math.cos(t)) / 2));
    return [...around(16).map(meridian), ...levels.slice(1, -1).map((t) => ring((1 - Math.cos(t)) / 2, Math.sin(t)))];
  }
  const uprights = form.section === "slab" ? [[1, 1], [-1, 1], [-1, -1], [1, -1]] : around(8);
  return [ring(0), ring(1), ...uprights.map(([x, y]) => [placeOf(form, x, y, 0), placeOf(form, x, y, 1)])];
}

function around(count) {
  return Array.from({ length: count }, (_, i) => [Math.cos((2 * Math.PI * i) / count), Math.sin((2 * Math.PI * i) / count)]);
}

/** A place in a photograph with its lens's distortion, px; null: behind the camera. */
export function project(camera, [x, y, z]) {
  const [a, b, c] = camera.rotation.map((row, i) => row[0] * x + row[1] * y + row[2] * z + camera.translation_mm[i]);
  if (c <= 0) return null;
  const [u, v] = distorted(camera.distortion, a / c, b / c);
  return [camera.fx * u + camera.cx, camera.fy * v + camera.cy];
}

function distorted([k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0], x, y) {
  const r = x * x + y * y;
  const radial = 1 + r * (k1 + r * (k2 + r * k3));
  return [x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x), y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y];
}

/** The ray of a pixel: {from: the camera's centre, towards}. */
export function rayOf(camera, [px, py]) {
  const [u, v] = [(px - camera.cx) / camera.fx, (py - camera.cy) / camera.fy];
  let [x, y] = [u, v];
  for (let i = 0; i < 20; i += 1) {
    const [du, dv] = distorted(camera.distortion, x, y);
    [x, y] = [x + u - du, y + v - dv];
  }
  const turned = (vector) => [0, 1, 2].map((j) => camera.rotation.reduce((sum, row, i) => sum + row[j] * vector[i], 0));
  return { from: turned(camera.translation_mm.map((value) => -value)), towards: turned([x, y, 1]) };
}

/** Where a ray meets the level z; null: it does not. */
export function onLevel({ from, towards }, z) {
  const reach = (z - from[2]) / towards[2];
  return Number.isFinite(reach) && reach > 0 ? [from[0] + reach * towards[0], from[1] + reach * towards[1]] : null;
}

/** The number s at which the line origin + s direction comes nearest to a ray; null: nowhere. */
function nearestOnLine({ from, towards }, origin, direction) {
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const apart = origin.map((value, i) => value - from[i]);
  const [aa, ab, bb] = [dot(direction, direction), dot(direction, towards), dot(towards, towards)];
  const determinant = aa * bb - ab * ab;
  if (!(determinant > 1e-9 * aa * bb)) return null; // or the ray is none: a pixel beyond what the lens shows
  return (ab * dot(towards, apart) - bb * dot(direction, apart)) / determinant;
}

// Each handle: its name, where it is, and the form after it was dragged onto a ray (null: no sensible form).
const alongLine = (origin, tip, change) => ({
  at: (form) => tip(form),
  dragged: (form, ray) => {
    const start = origin(form);
    const s = nearestOnLine(ray, start, tip(form).map((value, i) => value - start[i]));
    return s === null ? null : change(form, s);
  },
});
const onTheTable = (at, change) => ({
  at,
  dragged: (form, ray) => {
    const place = onLevel(ray, form.base_mm);
    return place && change(form, place);
  },
});
export const HANDLES = {
  move: onTheTable((form) => placeOf(form, 0, 0, 0), (form, place) => ({ ...form, centre_mm: place })),
  length_mm: alongLine((form) => placeOf(form, 0, 0, 0.5), (form) => placeOf(form, 1, 0, 0.5), (form, s) => side(form, "length_mm", s)),
  width_mm: alongLine((form) => placeOf(form, 0, 0, 0.5), (form) => placeOf(form, 0, 1, 0.5), (form, s) => side(form, "width_mm", s)),
  height_mm: alongLine((form) => placeOf(form, 0, 0, 0), (form) => placeOf(form, 0, 0, 1), (form, s) => side(form, "height_mm", s)),
  lean_deg: {
    at: (form) => placeOf(form, 0.6, 0, 1),
    dragged: (form, ray) => {
      const upright = placeOf({ ...form, lean_deg: 0 }, 0.6, 0, 1);
      const along = [Math.cos(form.yaw_deg * RAD), Math.sin(form.yaw_deg * RAD), 0];
      const s = nearestOnLine(ray, upright, along);
      return s === null ? null : { ...form, lean_deg: within(Math.atan2(s, form.height_mm) / RAD, LEAN_DEG) };
    },
  },
  yaw_deg: onTheTable(
    (form) => placeOf({ ...form, length_mm: form.length_mm + 2 * BESIDE_MM }, 1, 0, 0),
    (form, [x, y]) => ({ ...form, yaw_deg: Math.atan2(y - form.centre_mm[1], x - form.centre_mm[0]) / RAD }),
  ),
};

function side(form, name, factor) {
  return { ...form, [name]: within(form[name] * factor, SIDE_MM) };
}

export function within(value, [least, most]) {
  return Math.min(Math.max(value, least), most);
}

/** The upright form around places (n x 3) that stand on base_mm: of the smallest rectangle about them from above. */
export function formAround(places, base_mm) {
  const foot = hull(places.map(([x, y]) => [x, y]));
  let best = null;
  foot.forEach(([x, y], i) => {
    const [nx, ny] = foot[(i + 1) % foot.length];
    const yaw = Math.atan2(ny - y, nx - x);
    const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
    const a = foot.map(([px, py]) => px * cos + py * sin);
    const b = foot.map(([px, py]) => py * cos - px * sin);
    const [[a0, a1], [b0, b1]] = [[Math.min(...a), Math.max(...a)], [Math.min(...b), Math.max(...b)]];
    if (best && best.area <= (a1 - a0) * (b1 - b0)) return;
    const middle = [(a0 + a1) / 2, (b0 + b1) / 2];
    const centre_mm = [middle[0] * cos - middle[1] * sin, middle[0] * sin + middle[1] * cos];
    best = { area: (a1 - a0) * (b1 - b0), centre_mm, sides: [a1 - a0, b1 - b0], yaw };
  });
  if (!best) return null;
  const [length, width] = best.sides;
  const isLong = length >= width;
  const height = Math.max(...places.map(([, , z]) => z)) - base_mm;
  const yaw = best.yaw / RAD + (isLong ? 0 : 90);
  return {
    section: "ellipsoid",
    centre_mm: best.centre_mm,
    length_mm: within(Math.max(length, width), SIDE_MM),
    width_mm: within(Math.min(length, width), SIDE_MM),
    height_mm: within(height, SIDE_MM),
    yaw_deg: yaw > 90 ? yaw - 180 : yaw <= -90 ? yaw + 180 : yaw,
    lean_deg: 0,
    base_mm,
  };
}

/** The section whose volume is nearest to a measured one. */
export function nearestSection(form, volume_ml) {
  const off = (section) => Math.abs(Math.log(volumeMl({ ...form, section }) / volume_ml));
  return Object.keys(BOX_SHARE).reduce((best, section) => (off(section) < off(best) ? section : best));
}

/** The convex hull of points [x, y], counterclockwise (Andrew's monotone chain). */
export function hull(points) {
  const sorted = [...points].sort(([ax, ay], [bx, by]) => ax - bx || ay - by);
  const half = (ordered) => {
    const chain = [];
    for (const [x, y] of ordered) {
      while (chain.length > 1) {
        const [[ax, ay], [bx, by]] = chain.slice(-2);
        if ((bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0) break;
        chain.pop();
      }
      chain.push([x, y]);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}
