// Live help in a worker: frames in, one answer each out; of frames that wait while one is looked at the newest alone is answered.
//
// In: {pixels, width, height, marker, first, focal_px, id}: RGBA (4 bytes a pixel) or grey levels (1 byte), as a typed array or its
//   buffer; first: null, or the first photograph's frame {corners, width, height, focal_px} (its board's corners). focal_px may be left out.
//   {reset: true}: forget what was advised, for another photograph.
// Out: {board, quality, tilt_deg, distance_mm, angle_deg, right_deg, up_deg, side, advice, id}; what is not known is null; advice: advice.js.

import { advise } from "./advice.js";
import { findBoard, grayLevels } from "./board_detector.js";
import { frameQuality } from "./frame_quality.js";
import { parseMarker } from "./markers.js";
import { cameraPose, viewAngle } from "./view_angle.js";

let waiting = null;
let state = null;

self.onmessage = ({ data }) => {
  if (data.reset) state = null;
  if (data.pixels === undefined) return;
  if (waiting === null) setTimeout(answer, 0); // after the messages that have come meanwhile
  waiting = data;
};

function answer() {
  const frame = waiting;
  waiting = null;
  const { width, height, marker, first = null, focal_px, id = null } = frame;
  const gray = levelsOf(frame);
  const board = findBoard(gray, width, height, marker);
  const quality = frameQuality(gray, width, height, board, marker);
  const here = board === null ? null : { corners: board.corners, width, height, focal_px };
  const pose = here === null ? null : cameraPose(here.corners, here, marker);
  const angle = here === null || first === null ? null : viewAngle(first, here, marker);
  state = advise(state, { width, height, marker, board, quality, pose, angle });
  const { tilt_deg = null, distance_mm = null } = pose ?? {};
  const { angle_deg = null, right_deg = null, up_deg = null, side = null } = angle ?? {};
  self.postMessage({ board, quality, tilt_deg, distance_mm, angle_deg, right_deg, up_deg, side, advice: state.code, id });
}

function levelsOf({ pixels, width, height, marker }) {
  const bytes = pixels instanceof ArrayBuffer ? new Uint8Array(pixels) : pixels;
  if (bytes.length === width * height) return bytes;
  if (bytes.length !== 4 * width * height) throw new RangeError(`${bytes.length} bytes are no frame of ${width} x ${height}`);
  return grayLevels(bytes, parseMarker(marker).is_coloured);
}
