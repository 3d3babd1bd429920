// The study's marker as text (docs/cli.md), `plain:9x7:11` or `aruco:5x7:35:5:DICT_6X6_250`, as numbers: app/vision/marker_spec.py.

const TEXT = /^(plain|colour|aruco|charuco):(\d+)x(\d+):([\d.]+)(?::([\d.]+):(\w+))?(?::thick=[\d.]+)?$/;
const TAG_BITS = { ORIGINAL: 5, "16H5": 4, "25H9": 5, "36H10": 6, "36H11": 6, "36H12": 6 }; // others are named NxN

/**
 * @typedef {object} Marker
 * @property {"plain"|"colour"|"aruco"|"charuco"} kind
 * @property {number} columns squares across, of ArUco tags
 * @property {number} rows squares down
 * @property {number} square_mm side of a square, of ArUco of a tag
 * @property {number} pitch_mm from one square's left edge to the next one's
 * @property {number} white_share narrowest white beside a dark square, in squares: beyond the board's edge, around a ChArUco board's tags
 * @property {number} bits of a tag's side, without its border; 0: no tags
 * @property {number} width_mm of the squares' area
 * @property {number} height_mm
 */

/** Returns {@link Marker}; throws a RangeError if the text is no marker. */
export function parseMarker(text) {
  const parts = TEXT.exec(text);
  if (parts === null || parts[1].endsWith("aruco") !== (parts[6] !== undefined)) throw new RangeError(`no marker: ${text}`);
  const kind = parts[1];
  const [columns, rows, square_mm, second_mm] = [2, 3, 4, 5].map((i) => Number(parts[i] ?? 0));
  const gap_mm = kind === "aruco" ? second_mm : 0;
  const pitch_mm = square_mm + gap_mm;
  return {
    kind,
    columns,
    rows,
    square_mm,
    pitch_mm,
    white_share: kind === "charuco" ? (square_mm - second_mm) / 2 / square_mm : 0.5,
    bits: parts[6] === undefined ? 0 : tagBits(parts[6].toUpperCase()),
    width_mm: columns * pitch_mm - gap_mm,
    height_mm: rows * pitch_mm - gap_mm,
  };
}


function tagBits(dictionary) {
  const square = /^DICT_(\d)X\1_/.exec(dictionary);
  return square === null ? (TAG_BITS[dictionary.split("_").at(-1)] ?? 6) : Number(square[1]);
}

/** Quarter turns that leave the board looking the same where its tags are not read: [0], [0, 2] or [0, 1, 2, 3]. */
export function turnsAlike({ kind, columns, rows }) {
  if (kind === "aruco") return columns === rows ? [0, 1, 2, 3] : [0, 2];
  if (kind === "colour" || (columns + rows) % 2 === 1) return [0];
  return columns === rows && columns % 2 === 1 ? [0, 1, 2, 3] : [0, 2];
}
