// The light and sharpness of a preview frame, judged on the board's own squares where it is seen, on the whole frame
// where it is not: as app/vision/board/quality.py judges photographs.

import { parseMarker } from "./markers.js";
import { fitHomography, mapped } from "./projective.js";
import { levelAt } from "./saddle_points.js";

const CLIPPED_LEVEL = 252;
const MIN_EDGE_CONTRAST = 25; // grey levels across an edge for its width to be measured
const ROOM = 0.02; // of the long side: between the board and the frame's border
const PROFILE_PX = 8; // to either side of an edge, and at most 0.45 squares
const PROFILE_STEP_PX = 0.25;

/**
 * @typedef {object} FrameQuality
 * @property {number} light_level grey level of the board's white, of a frame without a board that of its lightest fiftieth
 * @property {number} clipped_share of the board's (the frame's) pixels that are white to the limit
 * @property {number|null} edge_width_px of the board's outline and squares (of the frame's sharpest edges), from a tenth to nine tenths; null: no edge
 * @property {boolean} has_room the board's four corners lie within the frame, off its border
 */

/** {@link FrameQuality} of a frame: gray Uint8Array, board as findBoard returns it or null. */
export function frameQuality(gray, width, height, board, marker) {
  const image = { data: gray, width, height };
  return board === null ? wholeFrame(image) : onBoard(image, board, parseMarker(marker));
}

function wholeFrame({ data, width, height }) {
  const counts = new Uint32Array(256);
  for (let i = 0; i < data.length; i += 1) counts[data[i]] += 1;
  let light_level = 255;
  for (let above = 0; light_level > 0; light_level -= 1) {
    above += counts[light_level];
    if (above >= data.length / 50) break;
  }
  let clipped = 0;
  for (let level = CLIPPED_LEVEL; level < 256; level += 1) clipped += counts[level];
  return { light_level, clipped_share: clipped / data.length, edge_width_px: sharpestEdge(data, width, height), has_room: false };
}

/** Contrast of a block over its steepest step between neighbours: the tenth percentile of blocks with contrast. */
function sharpestEdge(data, width, height) {
  const block = Math.max(16, Math.round(Math.max(width, height) / 40));
  const widths = [];
  for (let top = 0; top + block < height; top += block) {
    for (let left = 0; left + block < width; left += block) {
      let [low, high, steepest] = [255, 0, 0];
      for (let y = top; y < top + block; y += 1) {
        for (let i = y * width + left; i < y * width + left + block; i += 1) {
          low = Math.min(low, data[i]);
          high = Math.max(high, data[i]);
          // over two pixels: a step of grain counts half
          steepest = Math.max(steepest, Math.abs(data[i + 2] - data[i]), Math.abs((data[i + 2 * width] ?? data[i]) - data[i]));
        }
      }
      if (high - low >= MIN_EDGE_CONTRAST) widths.push((2 * (high - low)) / steepest);
    }
  }
  return widths.length === 0 ? null : widths.sort((a, b) => a - b)[Math.floor(widths.length / 10)];
}

function onBoard(image, { corners }, spec) {
  const { width_mm, height_mm, square_mm, pitch_mm } = spec;
  const homography = fitHomography([[0, 0], [width_mm, 0], [width_mm, height_mm], [0, height_mm]], corners);
  const levels = [];
  for (let y = square_mm / 8; y < height_mm; y += square_mm / 4) {
    for (let x = square_mm / 8; x < width_mm; x += square_mm / 4) {
      const level = levelAt(image, ...mapped(homography, x, y));
      if (!Number.isNaN(level)) levels.push(level);
    }
  }
  levels.sort((a, b) => a - b);
  const widths = [];
  for (let row = 0; row < spec.rows; row += 1) {
    for (let column = 0; column < spec.columns; column += 1) {
      // the middles of a square's left and upper sides: edges between squares, or of tags
      const [x, y] = [column * pitch_mm, row * pitch_mm];
      widths.push(edgeWidth(image, homography, [x, y + square_mm / 2], [square_mm, 0]));
      widths.push(edgeWidth(image, homography, [x + square_mm / 2, y], [0, square_mm]));
    }
  }
  const measured = widths.filter((each) => each !== null).sort((a, b) => a - b);
  const least = ROOM * Math.max(image.width, image.height);
  return {
    light_level: levels[Math.floor(levels.length * 0.9)] ?? 0,
    clipped_share: levels.filter((level) => level >= CLIPPED_LEVEL).length / Math.max(1, levels.length),
    edge_width_px: measured.length === 0 ? null : measured[Math.floor(measured.length / 2)],
    has_room: corners.every(([x, y]) => x >= least && y >= least && x < image.width - least && y < image.height - least),
  };
}

/** Contrast across an edge over its steepest place, px, which is a Gaussian blur's width from a tenth to nine tenths; null: no edge. */
function edgeWidth(image, homography, [x, y], [dx, dy]) {
  const from = mapped(homography, x, y);
  const to = mapped(homography, x + dx, y + dy);
  const along = mapped(homography, x + dy, y + dx); // a step along the edge
  const edge = Math.hypot(along[0] - from[0], along[1] - from[1]);
  // across the edge at right angles in the frame, as far as the square reaches
  let [nx, ny] = [(along[1] - from[1]) / edge, -(along[0] - from[0]) / edge];
  const across = nx * (to[0] - from[0]) + ny * (to[1] - from[1]);
  if (across < 0) [nx, ny] = [-nx, -ny];
  const reach = Math.min(PROFILE_PX, 0.45 * Math.abs(across));
  const levels = [];
  for (let s = -reach; s <= reach; s += PROFILE_STEP_PX) levels.push(levelAt(image, from[0] + s * nx, from[1] + s * ny));
  const contrast = Math.max(...levels) - Math.min(...levels);
  if (!(contrast >= MIN_EDGE_CONTRAST)) return null;
  const apart = Math.round(1 / PROFILE_STEP_PX); // steps over one px, as bilinear levels have
  let steepest = 0;
  for (let k = apart; k < levels.length; k += 1) steepest = Math.max(steepest, Math.abs(levels[k] - levels[k - apart]));
  return contrast / steepest;
}
