// Where the camera stands over the board, and how far from where it stood before: from the board's four corners.

import { parseMarker, turnsAlike } from "./markers.js";
import { fitHomography, solve } from "./projective.js";

export const FOCAL_SHARE = 0.8; // of a frame's long side: a phone's main camera, 28 mm equivalent
const CLEAR_ANGLE_DEG = 10; // between the lines of sight of two readings: nearer ones are told apart by the camera's turn
const ROUNDS = 6; // of Gauss and Newton's steps: the first leaves some hundredths of a degree
const DEG = 180 / Math.PI;

/**
 * The camera over a board. rotation: rows x right, y down, z forwards of the camera in the board's frame (x along its columns, y
 * down its rows, z into the table; origin in its middle). centre_mm: of the camera. tilt_deg: its line of sight from the vertical,
 * 0: straight from above. distance_mm: to the board's middle.
 * @typedef {{rotation: number[][], centre_mm: number[], tilt_deg: number, distance_mm: number}} CameraPose
 */

/**
 * {@link CameraPose} that puts the board's corners nearest to their pixels, from the homography on; null: they are no view of a plane.
 * corners: four [x, y] px; frame: {width, height, focal_px}; without focal_px it is FOCAL_SHARE of the long side.
 */
export function cameraPose(corners, frame, marker) {
  const { width_mm, height_mm } = parseMarker(marker);
  const focal = frame.focal_px ?? FOCAL_SHARE * Math.max(frame.width, frame.height);
  const [right, down] = [width_mm / 2, height_mm / 2];
  const rays = corners.map(([x, y]) => [(x - (frame.width - 1) / 2) / focal, (y - (frame.height - 1) / 2) / focal]);
  const places = [[-right, -down], [right, -down], [right, down], [-right, down]];
  const h = fitHomography(places, rays);
  if (h === null) return null;
  const sign = h[8] < 0 ? -1 : 1; // the board lies before the camera
  const column = (k) => [sign * h[k], sign * h[3 + k], sign * h[6 + k]];
  const scale = 2 / (length(column(0)) + length(column(1)));
  const start = { axes: orthonormal(column(0), column(1)), shift: column(2).map((value) => scale * value) };
  const { axes: [along, across], shift } = nearestToRays(start, places, rays);
  const axes = [along, across, cross(along, across)]; // the board's, in the camera's frame
  const centre_mm = axes.map((axis) => -dot(axis, shift));
  const distance_mm = length(shift);
  if (!(distance_mm > 0 && centre_mm[2] < 0)) return null;
  const rotation = [0, 1, 2].map((row) => axes.map((axis) => axis[row]));
  return { rotation, centre_mm, tilt_deg: Math.acos(-centre_mm[2] / distance_mm) * DEG, distance_mm };
}

/** A pose {axes, shift} moved to where it projects the places to the rays [x / z, y / z] best, by Gauss and Newton's steps. */
function nearestToRays(start, places, rays) {
  const far = length(start.shift); // shifts are counted in it, so that they are as large as turns
  const shifts = [[far, 0, 0], [0, far, 0], [0, 0, far]];
  let pose = start;
  for (let round = 0; round < ROUNDS; round += 1) {
    const normal = Array.from({ length: 6 }, () => new Float64Array(7));
    places.forEach(([u, v], n) => {
      const turned = [0, 1, 2].map((k) => u * pose.axes[0][k] + v * pose.axes[1][k]);
      const [x, y, z] = turned.map((value, k) => value + pose.shift[k]);
      const moves = [...[[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => cross(axis, turned)), ...shifts];
      [x, y].forEach((value, k) => {
        const row = moves.map((move) => (move[k] - (value / z) * move[2]) / z); // three turns, three shifts
        const off = rays[n][k] - value / z;
        row.forEach((a, i) => {
          row.forEach((b, j) => {
            normal[i][j] += a * b;
          });
          normal[i][6] += a * off;
        });
      });
    });
    const step = solve(normal);
    if (step === null) return pose;
    const axes = pose.axes.map((axis) => axis.map((value, k) => value + cross(step.slice(0, 3), axis)[k]));
    pose = { axes: orthonormal(...axes), shift: pose.shift.map((value, k) => value + far * step[3 + k]) };
  }
  return pose;
}

/**
 * The angle between the lines of sight from the board's middle to the camera in two frames:
 * {angle_deg, right_deg, up_deg, side}; right_deg, up_deg: its parts towards the first frame's right and upper side; side: where the second
 * camera stands, "left" or "right". null: a board has no pose.
 * first, second: {corners, width, height, focal_px}. Where the board looks the same turned, the second is read in the way that
 * the camera has moved least.
 */
export function viewAngle(first, second, marker) {
  const from = cameraPose(first.corners, first, marker);
  if (from === null) return null;
  const poses = turnsAlike(parseMarker(marker)).map((turns) => {
    const corners = second.corners.map((_, k) => second.corners[(k + turns) % 4]);
    const pose = cameraPose(corners, second, marker);
    return pose === null ? null : { ...pose, angle: between(from.centre_mm, pose.centre_mm), roll: turnBetween(from.rotation, pose.rotation) };
  });
  if (poses.includes(null)) return null;
  const [nearest, other] = [...poses].sort((a, b) => a.angle - b.angle);
  const isClear = other === undefined || (other.angle - nearest.angle > CLEAR_ANGLE_DEG && other.angle > 2 * nearest.angle);
  const to = isClear ? nearest : poses.reduce((least, pose) => (pose.roll < least.roll ? pose : least));
  const moved = unit(to.centre_mm).map((value, k) => value - unit(from.centre_mm)[k]);
  const right_deg = Math.asin(clamped(dot(moved, from.rotation[0]))) * DEG;
  const up_deg = Math.asin(clamped(-dot(moved, from.rotation[1]))) * DEG;
  return { angle_deg: to.angle, right_deg, up_deg, side: right_deg < 0 ? "left" : "right" };
}

/** Two unit vectors at right angles that are nearest to two of about the same length. */
function orthonormal(a, b) {
  const [p, q] = [unit(a), unit(b)];
  const sum = unit(p.map((value, k) => value + q[k]));
  const difference = unit(p.map((value, k) => value - q[k]));
  return [1, -1].map((sign) => sum.map((value, k) => (value + sign * difference[k]) / Math.SQRT2));
}

function between(a, b) {
  return Math.atan2(length(cross(a, b)), dot(a, b)) * DEG;
}

/** The angle of the rotation from one camera's axes to another's, degrees. */
function turnBetween(a, b) {
  return Math.acos(clamped((a.reduce((sum, row, k) => sum + dot(row, b[k]), 0) - 1) / 2)) * DEG;
}

function clamped(value) {
  return Math.min(1, Math.max(-1, value));
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function length(a) {
  return Math.hypot(...a);
}

function unit(a) {
  return a.map((value) => value / length(a));
}
