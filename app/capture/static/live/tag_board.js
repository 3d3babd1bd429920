// Grid boards of ArUco or AprilTag tags: from dark quadrangles to the lattice of the announced size. Tags are told by their black
// borders and by cells that are black and white inside; their numbers are not read.

import { extent, lattices, nearestAxis } from "./lattice.js";
import { fitHomography, mapped } from "./projective.js";
import { levelAt } from "./saddle_points.js";
import { darkQuadrangles } from "./tag_outlines.js";

const LEAST_TAGS = 4;
const NEAR_PITCHES = 0.3; // from where a tag's sides let the next one be expected
const STRAY_TAGS = 0.12; // of a tag's side, from where the others put its corners: another gap than announced is seen as that
const BLACK_BORDER = 0.85; // of the cells of a tag's border
const WHITE_INSIDE = [0.08, 0.92]; // of the cells within it
const LEAST_SHARE = 0.3; // of the tags, and
const LEAST_SPREAD = 0.4; // of the board's columns and rows, for the server to measure by a board that is partly covered

/** The board's reading with most tags, {homography, points, share, is_full, is_enough}, or null. homography: mm from the print's upper left -> px. */
export function findTagBoard(gray, image, marker) {
  const nodes = darkQuadrangles(gray, image);
  const sharp = { data: gray, width: image.width, height: image.height };
  for (const members of lattices(nodes, (node, side) => neighbour(nodes, node, side, marker))) {
    if (members.length < LEAST_TAGS) return null;
    const lattice = grown(nodes, members, marker);
    const board = lattice === null ? null : reading(sharp, lattice.filter((member) => isTag(sharp, member, marker)), marker);
    if (board !== null) return board;
  }
  return null;
}

function neighbour(nodes, from, side, { pitch_mm, square_mm }) {
  const next = (side + 1) % 4;
  const [mx, my] = [0, 1].map((k) => (from.corners[side][k] + from.corners[next][k]) / 2);
  const reach = (2 * pitch_mm) / square_mm;
  const [dx, dy] = [(mx - from.x) * reach, (my - from.y) * reach];
  let best = null;
  let least = NEAR_PITCHES * Math.hypot(dx, dy);
  for (const node of nodes) {
    const distance = Math.hypot(node.x - from.x - dx, node.y - from.y - dy);
    if (distance < least) [best, least] = [node, distance];
  }
  return best === null ? null : { node: best, side: nearestAxis(best, -dx, -dy).side };
}

/** Corners of the tag at (i, j) in mm from the middle of tag (0, 0), in the order of the node's own corners. */
function placesMm({ i, j, turn }, { pitch_mm, square_mm }) {
  const half = square_mm / 2;
  const clockwise = [[half, -half], [half, half], [-half, half], [-half, -half]]; // axis `turn` leads right
  return [0, 1, 2, 3].map((k) => {
    const [x, y] = clockwise[(k - turn + 4) % 4];
    return [i * pitch_mm + x, j * pitch_mm + y];
  });
}

function fit(members, marker) {
  return fitHomography(members.flatMap((member) => placesMm(member, marker)), members.flatMap(({ node }) => node.corners));
}

function strayTags(homography, member, marker) {
  const { corners } = member.node;
  const side = Math.hypot(corners[0][0] - corners[2][0], corners[0][1] - corners[2][1]) / Math.SQRT2;
  return Math.max(...placesMm(member, marker).map((place, k) => {
    const [x, y] = mapped(homography, ...place);
    return Math.hypot(x - corners[k][0], y - corners[k][1]) / side;
  }));
}

/** The members that lie on one homography, and further quadrangles that do; null: too few. */
function grown(nodes, members, marker) {
  let kept = withoutStrays(members, marker);
  while (kept !== null && kept.length <= marker.columns * marker.rows) {
    const next = withoutStrays([...kept, ...further(nodes, kept, marker)], marker);
    if (next === null || next.length <= kept.length) break;
    kept = next;
  }
  return kept;
}

/** The members without those that lie off the others' homography, the worst one taken out first; null: too few are left. */
function withoutStrays(members, marker) {
  let kept = members;
  while (kept.length >= LEAST_TAGS) {
    const homography = fit(kept, marker);
    if (homography === null) return null;
    const off = kept.map((member) => strayTags(homography, member, marker));
    const worst = Math.max(...off);
    if (worst < STRAY_TAGS) return kept;
    kept = kept.filter((_, k) => off[k] < worst);
  }
  return null;
}

/** Quadrangles where the homography expects tags, within the lattice or one step beyond it. */
function further(nodes, members, marker) {
  const homography = fit(members, marker);
  const taken = new Set(members.map(({ i, j }) => `${i},${j}`));
  const [low, high] = extent(members);
  const more = [];
  for (let j = low[1] - 1; j <= high[1] + 1; j += 1) {
    for (let i = low[0] - 1; i <= high[0] + 1; i += 1) {
      if (taken.has(`${i},${j}`)) continue;
      const [x, y] = mapped(homography, i * marker.pitch_mm, j * marker.pitch_mm);
      const [nextX, nextY] = mapped(homography, (i + 1) * marker.pitch_mm, j * marker.pitch_mm);
      const node = nodes.find((each) => Math.hypot(each.x - x, each.y - y) < NEAR_PITCHES * Math.hypot(nextX - x, nextY - y));
      if (node === undefined) continue;
      const member = { node, i, j, turn: nearestAxis(node, nextX - x, nextY - y).side };
      if (strayTags(homography, member, marker) < STRAY_TAGS) more.push(member);
    }
  }
  return more;
}

/** True if a quadrangle has a black border one cell wide, and black and white cells within it. */
function isTag(image, { node }, { bits }) {
  const cells = bits + 2;
  const homography = fitHomography([[0, 0], [cells, 0], [cells, cells], [0, cells]], node.corners);
  if (homography === null) return false;
  const level = (u, v) => levelAt(image, ...mapped(homography, u, v));
  const outside = [0.25, 0.5, 0.75].flatMap((t) => [
    [t * cells, -0.5], [t * cells, cells + 0.5], [-0.5, t * cells], [cells + 0.5, t * cells],
  ]);
  const white = outside.reduce((sum, [u, v]) => sum + level(u, v) / outside.length, 0);
  const levels = [];
  for (let row = 0; row < cells; row += 1) {
    for (let column = 0; column < cells; column += 1) {
      const isBorder = row === 0 || column === 0 || row === cells - 1 || column === cells - 1;
      levels.push({ isBorder, value: level(column + 0.5, row + 0.5) });
    }
  }
  const border = levels.filter(({ isBorder }) => isBorder);
  const black = border.reduce((sum, { value }) => sum + value / border.length, 0);
  const middle = (white + black) / 2;
  const blackBorder = border.filter(({ value }) => value < middle).length / border.length;
  const inside = levels.filter(({ isBorder }) => !isBorder);
  const whiteInside = inside.filter(({ value }) => value > middle).length / inside.length;
  return blackBorder >= BLACK_BORDER && whiteInside >= WHITE_INSIDE[0] && whiteInside <= WHITE_INSIDE[1];
}

/** The tags laid on the board where they fit, its missing tags least on bare paper. */
function reading(image, members, marker) {
  if (members.length < LEAST_TAGS) return null;
  const { columns, rows, pitch_mm, square_mm } = marker;
  let best = null;
  for (let quarter = 0; quarter < 4; quarter += 1) {
    const turned = members.map(({ node, i, j, turn }) => {
      const [column, row] = [[i, j], [j, -i], [-i, -j], [-j, i]][quarter];
      return { node, i: column, j: row, turn: (turn + quarter) % 4 };
    });
    const [low, high] = extent(turned);
    const spread = [high[0] - low[0] + 1, high[1] - low[1] + 1];
    if (Math.min(...spread) < 2) return null;
    for (let row = 0; row + spread[1] <= rows; row += 1) {
      for (let column = 0; column + spread[0] <= columns; column += 1) {
        const placed = turned.map((member) => ({ ...member, i: member.i - low[0] + column, j: member.j - low[1] + row }));
        const homography = fit(placed, marker);
        const score = homography === null ? -Infinity : upright(homography, marker) - bareTags(image, homography, placed, marker);
        if (best === null || score > best.score) best = { score, homography, placed, spread };
      }
    }
  }
  if (best === null || best.homography === null) return null;
  const [h, half] = [best.homography, square_mm / 2];
  const share = members.length / (columns * rows);
  return {
    homography: [h[0], h[1], h[2] - half * (h[0] + h[1]), h[3], h[4], h[5] - half * (h[3] + h[4]), h[6], h[7], h[8] - half * (h[6] + h[7])],
    points: best.placed.flatMap(({ node }) => node.corners),
    share,
    is_full: share === 1,
    is_enough: share >= LEAST_SHARE && best.spread[0] >= LEAST_SPREAD * columns && best.spread[1] >= LEAST_SPREAD * rows,
    pitch_mm,
  };
}

/** 0.5 where the board's rows follow each other downwards: of readings that look alike the one as a reader sees it. */
function upright(homography, { height_mm }) {
  return mapped(homography, 0, height_mm)[1] > mapped(homography, 0, 0)[1] ? 0.5 : 0;
}

/** The number of places without a tag that show bare paper. */
function bareTags(image, homography, placed, { columns, rows, pitch_mm, square_mm }) {
  const taken = new Set(placed.map(({ i, j }) => `${i},${j}`));
  const reach = square_mm / 2;
  const level = (x, y) => levelAt(image, ...mapped(homography, x, y));
  const { i, j } = placed[0];
  const gap = (pitch_mm - square_mm) / 2;
  const white = level(i * pitch_mm + reach + gap, j * pitch_mm);
  let bare = 0;
  for (let row = 0; row < rows; row += 1) {
    for (let column = 0; column < columns; column += 1) {
      if (taken.has(`${column},${row}`)) continue;
      const [x, y] = [column * pitch_mm, row * pitch_mm];
      const border = reach * 0.85;
      const levels = [[border, 0], [-border, 0], [0, border], [0, -border]].map(([dx, dy]) => level(x + dx, y + dy));
      if (levels.every((value) => value > 0.7 * white)) bare += 1;
    }
  }
  return bare;
}
