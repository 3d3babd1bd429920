// The study's marker as text (docs/cli.md), `plain:9x7:11` or `aruco:5x7:35:5:DICT_6X6_250`, as numbers: app/vision/marker_spec.py.

const TEXT = /^(\w+):(\d+)x(\d+):([\d.]+)(?::([\d.]+):(\w+))?(?::thick=[\d.]+)?$/;
const PLAIN = { has_tags: false, is_coloured: false, first_is_light: false, points_are_tags: false };
const KINDS = {
  plain: PLAIN,
  colour: { ...PLAIN, is_coloured: true, first_is_light: true },
  aruco: { ...PLAIN, has_tags: true, points_are_tags: true },
  charuco: { ...PLAIN, has_tags: true },
};
const TAG_BITS = { ORIGINAL: 5, "16H5": 4, "25H9": 5, "36H10": 6, "36H11": 6, "36H12": 6 }; // others are named NxN

/**
 * @typedef {object} Marker
 * @property {string} kind one of KINDS
 * @property {boolean} is_coloured its dark squares are coloured
 * @property {boolean} first_is_light its upper left square is white
 * @property {boolean} points_are_tags its points are the corners of its tags, else the inner corners of squares
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
  const kind = parts?.[1];
  if (KINDS[kind] === undefined || KINDS[kind].has_tags !== (parts[6] !== undefined)) throw new RangeError(`no marker: ${text}`);
  const { has_tags, points_are_tags } = KINDS[kind];
  const [columns, rows, square_mm, second_mm] = [2, 3, 4, 5].map((i) => Number(parts[i] ?? 0));
  const gap_mm = points_are_tags ? second_mm : 0;
  const pitch_mm = square_mm + gap_mm;
  return {
    kind,
    ...KINDS[kind],
    columns,
    rows,
    square_mm,
    pitch_mm,
    white_share: has_tags && !points_are_tags ? (square_mm - second_mm) / 2 / square_mm : 0.5,
    bits: has_tags ? tagBits(parts[6].toUpperCase()) : 0,
    width_mm: columns * pitch_mm - gap_mm,
    height_mm: rows * pitch_mm - gap_mm,
  };
}


function tagBits(dictionary) {
  const square = /^DICT_(\d)X\1_/.exec(dictionary);
  return square === null ? (TAG_BITS[dictionary.split("_").at(-1)] ?? 6) : Number(square[1]);
}

/** Quarter turns that leave the board looking the same where its tags are not read: [0], [0, 2] or [0, 1, 2, 3]. */
export function turnsAlike({ points_are_tags, is_coloured, columns, rows }) {
  if (points_are_tags) return columns === rows ? [0, 1, 2, 3] : [0, 2];
  if (is_coloured || (columns + rows) % 2 === 1) return [0];
  return columns === rows && columns % 2 === 1 ? [0, 1, 2, 3] : [0, 2];
}
