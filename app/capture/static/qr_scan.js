// Reading a card's QR code in the camera's frames.
//
// A card has two codes. The decoder looks for three finder patterns, and where it mixes those of both codes it reads
// neither, in each frame of a camera that is held still. So parts of the frame are tried in turn with all of it, at two
// sizes: a code that is not read at one often is at the other.

import { grabFrame } from "./camera.js";
import { decodeQR } from "./vendor/qr/decode.js";

const SCAN_EVERY_MS = 250;
const SIDES_PX = [1280, 640]; // each part comes at both, since the number of parts is odd
const PARTS = [
  { size: 1, x: 0, y: 0 },
  { size: 2 / 3, x: 0.5, y: 1 },
  { size: 1 / 2, x: 0.5, y: 0 },
  { size: 2 / 3, x: 0.5, y: 0.5 },
  { size: 1 / 2, x: 0.5, y: 1 },
  { size: 2 / 3, x: 0, y: 0.5 },
  { size: 2 / 3, x: 1, y: 0.5 },
];

/** Return valueOf(text) of the first QR code in a playing <video> for which it is not empty; null once isOpen() is false. */
export async function scan(video, valueOf, isOpen) {
  const canvas = document.createElement("canvas");
  for (let number = 0; isOpen(); number++) {
    const frame = grabFrame(video, canvas, SIDES_PX[number % SIDES_PX.length], PARTS[number % PARTS.length]);
    const value = frame && valueOf(textIn(frame));
    if (value) return value;
    await new Promise((resolve) => setTimeout(resolve, SCAN_EVERY_MS));
  }
  return null;
}

function textIn(frame) {
  try {
    return decodeQR(frame);
  } catch {
    return ""; // no code in this frame
  }
}
