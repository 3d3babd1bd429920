// Checkerboards, with tags in their light squares or without: from saddle points to a lattice of inner corners.

import { extent, lattices, nearestAxis } from "./lattice.js";
import { fitHomography, mapped } from "./projective.js";
import { cornerAt, levelAt, saddlePoints } from "./saddle_points.js";

const LEAST_SQUARE_PX = 4;
const WIDEST_SQUARE = 1 / 4; // of the long side
const LINK_COSINE = Math.cos((25 * Math.PI) / 180); // between an edge's direction at a corner and the next corner's
const MOST_NEIGHBOURS = 6; // nearest ones that are tried along an axis
const ALONG_EDGE = [0.2, 0.35, 0.5, 0.65, 0.8];
const LEAST_EDGE_STEP = 6; // grey levels from a dark to a light square
const STRAY_SQUARES = 0.25; // how far a corner may lie from where the others put it: lenses bend a board by less
const SEEDS = 4; // places of a lattice from which it is grown, one after another
const LEAST_SEED = 4;

/**
 * Lattices of corners in a smoothed image {data, width, height}, the largest first: {members, homography}.
 * members: [{node, i, j, turn}] of `lattices`; homography: (i, j) -> px.
 */
export function* cornerLattices(image, marker) {
  const nodes = saddlePoints(image);
  const most = Math.max(marker.columns, marker.rows) + 1; // columns and rows: more of them are another board or a cloth
  const used = new Set();
  for (const members of lattices(nodes, neighbourFinder(image, nodes, marker.white_share))) {
    const lattice = seeds(members.filter(({ node }) => !used.has(node)))
      .map((seed) => grown(image, nodes, seed, most))
      .reduce((best, each) => (each !== null && !(best?.members.length >= each.members.length) ? each : best), null);
    if (lattice === null) continue;
    for (const { node } of lattice.members) used.add(node);
    yield lattice;
  }
}

/** The most crowded places of a lattice, each a corner with those around it: one wrong neighbour spoils the whole. */
function seeds(members) {
  const crowds = members.map((middle) =>
    members.filter(({ i, j }) => Math.abs(i - middle.i) <= 1 && Math.abs(j - middle.j) <= 1),
  );
  const large = crowds.filter((crowd) => crowd.length >= LEAST_SEED);
  return large.sort((a, b) => b.length - a.length).slice(0, SEEDS);
}

/** The function that finds a corner's neighbour along an axis: the nearest one at the other end of an edge. */
function neighbourFinder(image, nodes, whiteShare) {
  const near = nearest(nodes, WIDEST_SQUARE * Math.max(image.width, image.height));
  return (from, side) => {
    for (const { node } of near.get(from)[side]) {
      const back = nearestAxis(node, from.x - node.x, from.y - node.y);
      const isOtherKind = (back.side + side) % 2 === 1; // dark and light change sides from corner to corner
      if (isOtherKind && back.cosine >= LINK_COSINE && isEdge(image, from, node, side % 2 === 0, whiteShare)) {
        return { node, side: back.side };
      }
    }
    return null;
  };
}

/** For every node and axis the nearest nodes along it, {node, distance}. */
function nearest(nodes, widest) {
  const sorted = [...nodes].sort((a, b) => a.x - b.x);
  return new Map(sorted.map((node, place) => {
    const lists = [[], [], [], []];
    let reach = widest; // until all four lists are full
    for (const way of [-1, 1]) {
      for (let n = place + way; n >= 0 && n < sorted.length; n += way) {
        if (Math.abs(sorted[n].x - node.x) > reach) break;
        if (insert(lists, node, sorted[n], reach)) reach = Math.max(...lists.map((list) => list.at(-1).distance));
      }
    }
    return [node, lists];
  }));
}

/** Adds a node to the lists of the axes along which it lies; returns whether all lists are full. */
function insert(lists, { x, y, axes }, node, reach) {
  const dx = node.x - x;
  const dy = node.y - y;
  const distance = Math.sqrt(dx * dx + dy * dy);
  if (distance > reach || distance < LEAST_SQUARE_PX) return false;
  let full = 0;
  for (let side = 0; side < 4; side += 1) {
    const list = lists[side];
    if (axes[side][0] * dx + axes[side][1] * dy >= LINK_COSINE * distance) {
      let place = Math.min(list.length, MOST_NEIGHBOURS);
      for (; place > 0 && list[place - 1].distance > distance; place -= 1) {
        if (place < MOST_NEIGHBOURS) list[place] = list[place - 1];
      }
      if (place < MOST_NEIGHBOURS) list[place] = { node, distance };
    }
    if (list.length === MOST_NEIGHBOURS) full += 1;
  }
  return full === 4;
}

/** True if it is light on one side of the line between two corners and dark on the other, all along. */
function isEdge(image, from, to, isLightClockwise, whiteShare) {
  const [dx, dy] = [to.x - from.x, to.y - from.y];
  const length = Math.hypot(dx, dy);
  const beside = Math.max(1.2, Math.min(whiteShare / 2, 0.25) * length) / length;
  const [nx, ny] = isLightClockwise ? [-dy * beside, dx * beside] : [dy * beside, -dx * beside];
  const steps = ALONG_EDGE.map((t) => {
    const [x, y] = [from.x + t * dx, from.y + t * dy];
    return levelAt(image, x + nx, y + ny) - levelAt(image, x - nx, y - ny);
  });
  return Math.min(...steps) > Math.max(LEAST_EDGE_STEP, Math.max(...steps) / 4);
}

/** A lattice with all saddle points that lie where its homography expects corners; null: a seed's are not regular. */
function grown(image, nodes, seed, most) {
  let lattice = fitted(seed);
  if (lattice === null || lattice.members.length < seed.length) return null;
  while (!isLarger(lattice.members, most)) {
    const next = fitted(withExpected(image, nodes, lattice));
    if (next === null || next.members.length <= lattice.members.length) break;
    lattice = next;
  }
  return lattice;
}

/** {members, homography} of the members that lie on the homography. */
function fitted(members) {
  let kept = members;
  for (let round = 0; round < 3; round += 1) {
    if (kept.length < 4) return null;
    const homography = fitHomography(kept.map(({ i, j }) => [i, j]), kept.map(({ node }) => [node.x, node.y]));
    if (homography === null) return null;
    const close = kept.filter(({ node, i, j }) => {
      const [x, y] = mapped(homography, i, j);
      return Math.hypot(x - node.x, y - node.y) < STRAY_SQUARES * stepPx(homography, i, j);
    });
    if (close.length === kept.length) return { members: kept, homography };
    kept = close;
  }
  return null;
}

/** Length in px of the shorter of a place's steps to i + 1 and j + 1. */
export function stepPx(homography, i, j) {
  const [x, y] = mapped(homography, i, j);
  return Math.min(...[[i + 1, j], [i, j + 1]].map((next) => {
    const [nextX, nextY] = mapped(homography, ...next);
    return Math.hypot(nextX - x, nextY - y);
  }));
}

/** The members and those that are expected: on a free place within the lattice or one step beyond it. */
function withExpected(image, nodes, { members, homography }) {
  const { node: first, i: firstI, j: firstJ, turn } = members[0];
  const kind = (turn + firstI + firstJ) & 1;
  const taken = new Set(members.map(({ i, j }) => `${i},${j}`));
  const [low, high] = extent(members);
  const more = [...members];
  for (let j = low[1] - 1; j <= high[1] + 1; j += 1) {
    for (let i = low[0] - 1; i <= high[0] + 1; i += 1) {
      if (taken.has(`${i},${j}`)) continue;
      const [x, y] = mapped(homography, i, j);
      const reach = STRAY_SQUARES * stepPx(homography, i, j);
      const isInside = i >= low[0] && i <= high[0] && j >= low[1] && j <= high[1];
      const node = nodes.find((each) => isNear(each, x, y, reach)) ?? (isInside ? cornerAt(image, x, y) : null);
      if (node === null || !isNear(node, x, y, reach) || node.step < first.step / 8) continue;
      const [nextX, nextY] = mapped(homography, i + 1, j);
      const axis = nearestAxis(node, nextX - x, nextY - y);
      if (((axis.side + i + j) & 1) === kind && axis.cosine >= LINK_COSINE) more.push({ node, i, j, turn: axis.side });
    }
  }
  return more;
}

function isNear(node, x, y, reach) {
  return Math.abs(node.x - x) < reach && Math.abs(node.y - y) < reach && Math.hypot(node.x - x, node.y - y) < reach;
}

function isLarger(members, most) {
  const [low, high] = extent(members);
  return Math.max(high[0] - low[0], high[1] - low[1]) >= most;
}
