// Nodes that are each other's neighbours, as lattices: every node gets a column i and a row j, j turned from i by increasing
// angle (y down: clockwise, as a print is read). A node has four axes, unit vectors by increasing angle.

/** The node's axis nearest to a direction [dx, dy]: {side: 0 to 3, cosine}. */
export function nearestAxis({ axes }, dx, dy) {
  const length = Math.hypot(dx, dy);
  let side = 0;
  let cosine = -1;
  for (let k = 0; k < 4; k += 1) {
    const value = (axes[k][0] * dx + axes[k][1] * dy) / length;
    if (value > cosine) [side, cosine] = [k, value];
  }
  return { side, cosine };
}

/**
 * Lattices of nodes that choose each other, the largest first: each a list of {node, i, j, turn}; axis `turn` leads to i + 1.
 * chosen(node, side) -> {node, side}: the neighbour along that axis and the neighbour's axis that leads back, or null.
 */
export function lattices(nodes, chosen) {
  const choices = new Map(nodes.map((node) => [node, [0, 1, 2, 3].map((side) => chosen(node, side))]));
  const neighbour = (node, side) => {
    const choice = choices.get(node)[side];
    return choice !== null && choices.get(choice.node)[choice.side]?.node === node ? choice : null;
  };
  const seen = new Set();
  const components = [];
  for (const node of nodes) {
    if (seen.has(node)) continue;
    const members = [{ node, i: 0, j: 0, turn: 0 }];
    const taken = new Set(["0,0"]);
    seen.add(node);
    for (const { node: from, i, j, turn } of members) {
      for (let side = 0; side < 4; side += 1) {
        const next = neighbour(from, side);
        if (next === null || seen.has(next.node)) continue;
        const way = (side - turn + 4) % 4; // 0: i + 1, 1: j + 1, 2: i - 1, 3: j - 1
        const place = [i + [1, 0, -1, 0][way], j + [0, 1, 0, -1][way]];
        if (taken.has(String(place))) continue;
        taken.add(String(place));
        seen.add(next.node);
        members.push({ node: next.node, i: place[0], j: place[1], turn: (next.side - way + 6) % 4 });
      }
    }
    components.push(members);
  }
  return components.sort((a, b) => b.length - a.length);
}

/** [[least i, least j], [most i, most j]] of a lattice's members. */
export function extent(members) {
  const [columns, rows] = [members.map(({ i }) => i), members.map(({ j }) => j)];
  return [
    [Math.min(...columns), Math.min(...rows)],
    [Math.max(...columns), Math.max(...rows)],
  ];
}
