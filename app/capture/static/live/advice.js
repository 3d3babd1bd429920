// The page's advice to the participant, one code at a time, from an analysed frame.

import { parseMarker } from "./markers.js";
import { areaPx } from "./projective.js";

/** Codes in the order in which they are asked for; `good`: take the photograph. */
export const CODES = [
  "too_dark", "no_board", "board_cut_off", "too_bright", "blurred", "too_far", "too_close", "too_steep", "too_flat",
  "move_right", "move_left", "too_far_apart", "good",
];

const STEADY_FRAMES = 3; // that say the same before the code changes
const DARK_LEVEL = 60; // of the board's white; the server refuses below 40
const MOST_CLIPPED = 0.6; // of the board: half of a checkerboard is white, and glare lifts its black too
const SOFT_PX = 2; // that a preview's own scaling makes sharp edges wide
const BLUR_SHARE = 1 / 250; // of the long side: app/vision/board/quality.py
const LEAST_SQUARE_SHARE = 1 / 100; // of the long side, by the board's longest step from square to square: 40 px of 4000
const MOST_DISTANCE_MM = 1000; // a phone's 4000 px are then 0.3 mm each on the table; the server warns from 0.5 on
const MOST_BOARD_SHARE = 0.5; // of the frame's area: a plate fits beside the board
const TILT_DEG = [12, 65]; // from the vertical: steeper, and heights have no parallax to the sheet; flatter, and food hides food
const ANGLE_DEG = [8, 15]; // between the two photographs (docs/apps.md)
const FAR_APART_DEG = 25;
const RIGHT_SHARE = 0.7; // of the way must lead to the right
const SLACK = 0.1; // of a limit, before what was good is so no longer

/**
 * @typedef {object} Observation of one frame
 * @property {number} width px
 * @property {number} height px
 * @property {string} marker
 * @property {import("./board_detector.js").Board|null} board
 * @property {import("./frame_quality.js").FrameQuality} quality
 * @property {import("./view_angle.js").CameraPose|null} pose
 * @property {object|null} angle of viewAngle against the first photograph; null: this is the first one
 */

/** The code for one frame alone. before: the code shown until now, whose limits it has left only by some slack. */
export function frameCode({ width, height, marker, board, quality, pose, angle }, before = null) {
  const long = Math.max(width, height);
  const beyond = (code) => (before === code ? 1 - SLACK : before === "good" ? 1 + SLACK : 1); // widens what is shown or was good
  if (quality.light_level < DARK_LEVEL / beyond("too_dark") && board !== null) return "too_dark";
  if (board === null) {
    if (quality.light_level < DARK_LEVEL) return "too_dark";
    const isBlurred = quality.edge_width_px !== null && quality.edge_width_px > 2 * blurLimit(long);
    return isBlurred ? "blurred" : "no_board";
  }
  if (!board.is_enough || !quality.has_room) return "board_cut_off";
  if (quality.clipped_share > MOST_CLIPPED * beyond("too_bright")) return "too_bright";
  if (quality.edge_width_px > blurLimit(long) * beyond("blurred")) return "blurred";
  const { square, area } = extentOf(board.corners, parseMarker(marker));
  if (square < (LEAST_SQUARE_SHARE * long) / beyond("too_far")) return "too_far";
  if (pose !== null && pose.distance_mm > MOST_DISTANCE_MM * beyond("too_far")) return "too_far";
  if (area > MOST_BOARD_SHARE * beyond("too_close") * width * height) return "too_close";
  if (pose !== null && pose.tilt_deg < TILT_DEG[0] / beyond("too_steep")) return "too_steep";
  if (pose !== null && pose.tilt_deg > TILT_DEG[1] * beyond("too_flat")) return "too_flat";
  return angle === null ? "good" : wayCode(angle, beyond);
}

function wayCode({ angle_deg, right_deg }, beyond) {
  const isRight = right_deg >= RIGHT_SHARE * angle_deg / beyond("move_right");
  if (angle_deg > FAR_APART_DEG * beyond("too_far_apart")) return "too_far_apart";
  if (!isRight || angle_deg < ANGLE_DEG[0] / beyond("move_right")) return "move_right";
  return angle_deg > ANGLE_DEG[1] * beyond("move_left") ? "move_left" : "good";
}

function blurLimit(long) {
  return Math.hypot(SOFT_PX, BLUR_SHARE * long);
}

/** The board's longest step from square to square, px, and its area, px^2. */
function extentOf(corners, { columns, rows }) {
  const sides = corners.map(([x, y], k) => Math.hypot(corners[(k + 1) % 4][0] - x, corners[(k + 1) % 4][1] - y));
  const steps = sides.map((side, k) => side / (k % 2 === 0 ? columns : rows));
  return { square: Math.max(...steps), area: areaPx(corners) };
}

/**
 * The code to show after one more frame, steady: another code replaces it once STEADY_FRAMES frames in a row ask for it.
 * state: what the last call returned, {code, next, frames}, or null before the first frame.
 */
export function advise(state, observation) {
  const code = frameCode(observation, state?.code ?? null);
  if (state === null || code === state.code) return { code, next: null, frames: 0 };
  const frames = code === state.next ? state.frames + 1 : 1;
  return frames >= STEADY_FRAMES ? { code, next: null, frames: 0 } : { code: state.code, next: code, frames };
}
