// The study's board in a preview frame: is it there, where are its corners, how much of it is seen. Sure rather than complete:
// what might be a chequered cloth, tiles or print is no board.

import { cornerLattices, stepPx } from "./checkerboard.js";
import { extent } from "./lattice.js";
import { parseMarker } from "./markers.js";
import { areaPx, fitHomography, mapped } from "./projective.js";
import { levelAt, refinedCorner, smoothed } from "./saddle_points.js";
import { findTagBoard } from "./tag_board.js";

const LEAST_STEP = 6; // grey levels between neighbouring squares
const LEAST_POINTS = 8; // twice as many as a homography needs: fewer fit each other by chance
const LEAST_SHARE = 0.35; // of the points
const LEAST_FULL_ROW = 0.4; // of an outermost row's points: fewer are beside the board
const LEAST_ALTERNATING = 0.85; // of the neighbouring squares that are seen
const LEAST_MARGIN = 0.75; // of the white seen beyond the outermost squares, where not all of the board is
const MOST_GOING_ON = 0.75; // of the outermost squares: more go on beyond the board, as a chequered cloth's do
// Median distance of corners from where their homography puts them, in squares: wide lenses leave 0.05, grain 0.04, and what
// only looks like a board 0.05 and more. Few corners fit each other more easily.
const MOST_STRAY = 0.06;
const [FEW_POINTS, MOST_STRAY_OF_FEW] = [20, 0.04];
const REACH_SQUARES = 0.45; // around a corner, where it is refined, and
const [LEAST_REACH_PX, MOST_REACH_PX] = [2, 6];
const ENOUGH_POINTS = 8; // of a ChArUco board, for the server to measure by it
const WHOLE = 0.95; // share of points and of squares that alternate

/**
 * @typedef {object} Board
 * @property {number[][]} corners four [x, y], px: of the squares' area, clockwise from the print's upper left. Boards that look
 *   the same turned, and boards of tags, may start with another one (turnsAlike in markers.js)
 * @property {number[][]} points [x, y] px of the points seen: inner corners; of an ArUco board its tags' corners
 * @property {number} share of the board's points that are seen
 * @property {boolean} is_whole all of it lies in the frame, uncovered
 * @property {boolean} is_enough the server can measure by it: boards of tags may be partly covered
 */

/**
 * The board in a frame, or null.
 * gray: Uint8Array of width x height, 640 px or less on the long side; see grayLevels. marker: the study's text.
 */
export function findBoard(gray, width, height, marker) {
  const spec = parseMarker(marker);
  const sharp = { data: gray, width, height };
  const image = { data: smoothed(gray, width, height), width, height };
  if (spec.points_are_tags) {
    const tags = findTagBoard(gray, image, spec);
    return tags === null ? null : boardOf(image, tags, spec.width_mm, spec.height_mm);
  }
  let best = null;
  for (const { members } of cornerLattices(image, spec)) {
    const board = readBoard(image, sharp, trimmed(members), spec);
    if (board !== null && (best === null || isBetter(board, best))) best = board;
  }
  return best;
}

/** True if more of a board is seen than of another, or as much of a larger one. */
function isBetter(board, other) {
  return board.share === other.share ? areaPx(board.corners) > areaPx(other.corners) : board.share > other.share;
}

/** Grey levels of RGBA pixels; for a coloured board the smallest channel, in which its white squares alone are light. */
export function grayLevels(pixels, isColoured) {
  const gray = new Uint8Array(pixels.length / 4);
  for (let i = 0, j = 0; i < gray.length; i += 1, j += 4) {
    const [red, green, blue] = [pixels[j], pixels[j + 1], pixels[j + 2]];
    gray[i] = isColoured ? Math.min(red, green, blue) : (77 * red + 150 * green + 29 * blue) >> 8;
  }
  return gray;
}

/** The members less outermost rows and columns of which too few were found. */
function trimmed(members) {
  let kept = members;
  for (;;) {
    const [low, high] = extent(kept);
    const [columns, rows] = [high[0] - low[0] + 1, high[1] - low[1] + 1];
    const sparse = [
      [({ i }) => i === low[0], rows],
      [({ i }) => i === high[0], rows],
      [({ j }) => j === low[1], columns],
      [({ j }) => j === high[1], columns],
    ].find(([isOutermost, length]) => kept.filter(isOutermost).length < LEAST_FULL_ROW * length);
    if (sparse === undefined) return kept;
    kept = kept.filter((member) => !sparse[0](member));
    if (kept.length === 0) return kept;
  }
}

/** {@link Board} if the lattice is the announced board or a part of it. */
function readBoard(image, sharp, members, spec) {
  const expected = (spec.columns - 1) * (spec.rows - 1);
  if (members.length < Math.min(LEAST_POINTS, expected) || members.length < LEAST_SHARE * expected) return null;
  let best = null;
  for (const placed of placements(members, spec)) {
    const reading = judged(image, placed, spec);
    if (reading !== null && (best === null || reading.score > best.score)) best = reading;
  }
  if (best === null || best.alternating < LEAST_ALTERNATING || best.goingOn > MOST_GOING_ON) return null;
  if (!best.isFull && best.margin < LEAST_MARGIN) return null;
  if (medianStray(best) > (members.length < FEW_POINTS ? MOST_STRAY_OF_FEW : MOST_STRAY)) return null;
  const share = best.placed.length / expected;
  const points = best.placed.map(({ node, u, v }) => {
    const reach = Math.min(MOST_REACH_PX, REACH_SQUARES * stepPx(best.homography, u, v));
    return refinedCorner(sharp, [node.x, node.y], Math.max(LEAST_REACH_PX, reach));
  });
  const seen = {
    homography: fitHomography(best.placed.map(({ u, v }) => [u, v]), points) ?? best.homography,
    points,
    share,
    is_full: share >= WHOLE && best.all >= WHOLE,
    is_enough: spec.bits > 0 && best.placed.length >= ENOUGH_POINTS,
  };
  return boardOf(image, seen, spec.columns, spec.rows);
}

/** In squares. */
function medianStray({ homography, placed }) {
  const strays = placed.map(({ node, u, v }) => {
    const [x, y] = mapped(homography, u, v);
    return Math.hypot(x - node.x, y - node.y) / stepPx(homography, u, v);
  });
  return strays.sort((a, b) => a - b)[Math.floor(strays.length / 2)];
}

/** {@link Board} of what is seen: homography from width x height to px. null: no camera sees a rectangle so. */
function boardOf(image, { homography, points, share, is_full, is_enough }, width, height) {
  const corners = [[0, 0], [width, 0], [width, height], [0, height]].map(([x, y]) => mapped(homography, x, y));
  // a rectangle before the camera keeps all its corners convex and clockwise
  if (corners.some((corner, k) => !(areaPx([corners.at(k - 1), corner, corners[(k + 1) % 4]]) > 0))) return null;
  const isWhole = is_full && corners.every(([x, y]) => isInside(image, x, y));
  return { corners, points, share, is_whole: isWhole, is_enough: isWhole || is_enough };
}

/** True if beyond the corners seen there is bare paper where another row or column of corners should be: a smaller board. */
function endsBefore(placed, squares, { columns, rows }) {
  const [us, vs] = [placed.map(({ u }) => u), placed.map(({ v }) => v)];
  const [left, right, top, bottom] = [Math.min(...us) - 1, Math.max(...us) + 1, Math.min(...vs) - 1, Math.max(...vs) + 1];
  const along = (low, high) => Array.from({ length: high - low - 1 }, (_, k) => low + 1 + k);
  const lines = [
    ...[left, right].filter((u) => u > 0 && u < columns).map((u) => along(top, bottom).map((v) => [u, v])),
    ...[top, bottom].filter((v) => v > 0 && v < rows).map((v) => along(left, right).map((u) => [u, v])),
  ];
  const seen = squares.flat().filter((level) => !Number.isNaN(level));
  const middle = (Math.max(...seen) + Math.min(...seen)) / 2;
  return lines.some((line) => {
    const around = line.map(([u, v]) => [[u - 1, v - 1], [u, v - 1], [u - 1, v], [u, v]].map(([x, y]) => squares[y][x]));
    const inFrame = around.filter((levels) => !levels.some(Number.isNaN));
    // three light squares of four: the board's own outermost one may be dark
    const bare = inFrame.filter((levels) => levels.filter((level) => level > middle).length >= 3);
    return inFrame.length >= 2 && bare.length > inFrame.length / 2;
  });
}

function isInside({ width, height }, x, y) {
  return x >= 0 && y >= 0 && x <= width - 1 && y <= height - 1;
}

/** Ways to lay the lattice on the board: lists of {node, u, v}, places in squares from the print's upper left. */
function* placements(members, { first_is_light, columns, rows }) {
  const firstIsLight = first_is_light ? 1 : 0;
  for (let quarter = 0; quarter < 4; quarter += 1) {
    const turned = members.map(({ node, i, j, turn }) => {
      const [u, v] = [[i, j], [j, -i], [-i, -j], [-j, i]][quarter];
      return { node, i: u, j: v, turn: turn + quarter };
    });
    const [low, high] = extent(turned);
    for (let v = 1; v + high[1] - low[1] < rows; v += 1) {
      for (let u = 1; u + high[0] - low[0] < columns; u += 1) {
        const placed = turned.map(({ node, i, j, turn }) => ({ node, u: i - low[0] + u, v: j - low[1] + v, turn }));
        // between axes 0 and 1 it is light: the square to the right of and below a corner with an even turn
        const isRight = ({ u: column, v: row, turn }) => ((column + row + turn + firstIsLight) & 1) === 1;
        if (isRight(placed[0])) yield placed;
      }
    }
  }
}

/** The evidence of the squares and the white around them for a placement. */
function judged(image, placed, spec) {
  const homography = fitHomography(placed.map(({ u, v }) => [u, v]), placed.map(({ node }) => [node.x, node.y]));
  if (homography === null) return null;
  const { columns, rows, first_is_light } = spec;
  const beside = Math.min(spec.white_share / 2, 0.25);
  const level = (u, v) => levelAt(image, ...mapped(homography, u, v));
  const squares = Array.from({ length: rows }, (_, row) =>
    Array.from({ length: columns }, (__, column) => {
      const around = [[beside, 0.5], [1 - beside, 0.5], [0.5, beside], [0.5, 1 - beside]];
      return around.reduce((sum, [u, v]) => sum + level(column + u, row + v) / 4, 0);
    }),
  );
  const near = new Set(placed.flatMap(({ u, v }) => [`${u - 1},${v - 1}`, `${u},${v - 1}`, `${u - 1},${v}`, `${u},${v}`]));
  const isLight = (column, row) => ((column + row) & 1) === (first_is_light ? 0 : 1);
  if (endsBefore(placed, squares, spec)) return null;
  const counts = { steps: [0, 0], margin: [0, 0], goingOn: [0, 0], all: [0, 0] };
  const count = (name, isRight) => {
    counts[name][isRight ? 0 : 1] += 1;
  };
  for (let row = 0; row < rows; row += 1) {
    for (let column = 0; column < columns; column += 1) {
      const own = squares[row][column];
      const isSeen = near.has(`${column},${row}`) && !Number.isNaN(own);
      for (const [nextColumn, nextRow] of [[column + 1, row], [column, row + 1]]) {
        const next = squares[nextRow]?.[nextColumn];
        if (next === undefined) continue;
        const isRight = (isLight(column, row) ? own - next : next - own) > LEAST_STEP;
        count("all", isRight);
        if (isSeen && near.has(`${nextColumn},${nextRow}`) && !Number.isNaN(next)) count("steps", isRight);
      }
      if (!isSeen) continue;
      const besides = [
        [column === 0, -beside, row + 0.5, column, row + (row === 0 ? 1 : -1)],
        [column === columns - 1, columns + beside, row + 0.5, column, row + (row === 0 ? 1 : -1)],
        [row === 0, column + 0.5, -beside, column + (column === 0 ? 1 : -1), row],
        [row === rows - 1, column + 0.5, rows + beside, column + (column === 0 ? 1 : -1), row],
      ];
      for (const [isOutermost, u, v, neighbourColumn, neighbourRow] of besides) {
        const white = isOutermost ? level(u, v) : NaN;
        const neighbour = squares[neighbourRow][neighbourColumn];
        if (Number.isNaN(white) || Number.isNaN(neighbour)) continue;
        const isWhite = white > (own + neighbour) / 2;
        count("margin", isWhite);
        count("goingOn", isWhite !== isLight(column, row));
      }
    }
  }
  const share = ([right, wrong], none = 1) => (right + wrong === 0 ? none : right / (right + wrong));
  const [low, high] = [Math.min, Math.max].map((of) => [of(...placed.map(({ u }) => u)), of(...placed.map(({ v }) => v))]);
  const isUpright = mapped(homography, 0, rows)[1] > mapped(homography, 0, 0)[1]; // of readings that look alike this one
  return {
    homography,
    placed,
    score: counts.steps[0] - counts.steps[1] + counts.margin[0] - counts.margin[1] + (isUpright ? 0.5 : 0),
    isFull: high[0] - low[0] === columns - 2 && high[1] - low[1] === rows - 2,
    alternating: share(counts.steps),
    margin: share(counts.margin),
    goingOn: share(counts.goingOn, 0),
    all: share(counts.all),
  };
}
