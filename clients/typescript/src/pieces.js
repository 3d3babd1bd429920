/** A large photograph in pieces, by tus 1.0 (docs/apps.md): after a cut connection it continues where the server's bytes end. */

import { NetworkError, Problem } from "./errors.js";
import { secondsUntilNext, sleep } from "./retries.js";

/** @typedef {Blob | ArrayBuffer | Uint8Array<ArrayBuffer>} Content */

const LARGE_BYTES = 1024 ** 2; // a smaller photograph is sent whole: three more requests would take longer
const PIECE_BYTES = 2 * 1024 ** 2; // a proxy that waits for whole requests loses no more than this

/** @param {Content} content */
export const isLarge = (content) => sizeOf(content) > LARGE_BYTES;

/**
 * Send the bytes of a photograph that the server lacks; an upload of another length is begun anew. Attempts that bring it no
 * further are counted by `retries`.
 *
 * @param {import("./client.js").TadaClient} client
 * @param {{meal: string, slot: string, path: string}} place path: of the photograph.
 * @param {Content} content
 * @param {import("./retries.js").RetryPolicy} retries
 * @param {import("./client.js").CallOptions} options
 * @returns {Promise<import("./client.js").Meal | null>} The meal once the server has it on its disk; null: send it whole.
 */
export async function sendInPieces(client, { meal, slot, path }, content, retries, options) {
  const upload = `${path}/upload`;
  const size = sizeOf(content);
  const digest = await sha256(content);
  const ofWhole = digest && { "Repr-Digest": `sha-256=:${btoa(String.fromCharCode(...digest))}:` }; // RFC 9530; older servers ignore it
  let offset = await offsetOrNull(client, upload, size, options);
  if (offset === null && !(await begin(client, upload, size, options))) return null;
  offset ??= 0;
  let [farthest, failures, isSure] = [offset, 0, true];
  while (offset < size) {
    const end = Math.min(offset + PIECE_BYTES, size);
    const headers = { "Content-Type": "application/offset+octet-stream", "Upload-Offset": String(offset), "Tus-Resumable": "1.0.0", ...ofWhole };
    try {
      await client.request("PATCH", upload, { ...options, attempts: 1, headers, body: slice(content, offset, end) });
      offset = end;
    } catch (error) {
      failures += 1;
      if (isOf(error, "upload_unknown", "upload_offset_differs", "upload_digest_differs")) {
        if (failures >= retries.attempts) return null; // hosts behind one address, each with other bytes
      } else {
        const pause = secondsUntilNext(error, failures, retries);
        if (pause === null) throw error;
        await sleep(pause, options.signal);
      }
      offset = await offsetOrNull(client, upload, size, options);
      if (offset === null) {
        isSure = false; // the last answer was lost, or the upload was begun with other bytes and is given up
        break;
      }
      if (offset > farthest) [farthest, failures] = [offset, 0];
    }
  }
  const sent = await client.getMeal(meal, options);
  return (digest === null ? isSure : hasBytes(sent, slot, digest)) ? sent : null;
}

/**
 * @param {import("./client.js").TadaClient} client
 * @param {string} upload
 * @param {number} size
 * @param {import("./client.js").CallOptions} options
 * @returns {Promise<number | null>} null: there is no unfinished upload of this size, or the server takes none.
 */
async function offsetOrNull(client, upload, size, options) {
  try {
    const { headers } = await client.request("GET", upload, options);
    const [offset, length] = [headers.get("Upload-Offset") ?? "", headers.get("Upload-Length") ?? ""];
    if (!/^\d+$/.test(offset) || !/^\d+$/.test(length)) {
      throw new NetworkError("The answer is not the server's.", headers); // such as a network's sign-in page
    }
    return Number(length) === size ? Number(offset) : null;
  } catch (error) {
    if (isRefused(error)) return null;
    throw error;
  }
}

/**
 * @param {import("./client.js").TadaClient} client
 * @param {string} upload
 * @param {number} size
 * @param {import("./client.js").CallOptions} options
 * @returns {Promise<boolean>} False: the server takes no pieces, or no further ones now.
 */
async function begin(client, upload, size, options) {
  try {
    await client.request("POST", upload, { ...options, read: "blob", headers: { "Upload-Length": String(size), "Tus-Resumable": "1.0.0" } });
    return true;
  } catch (error) {
    if (isRefused(error) || isOf(error, "uploads_too_many")) return false;
    throw error;
  }
}

/** @param {unknown} error */
const isRefused = (error) => error instanceof Problem && (error.status === 404 || error.status === 405);

/**
 * @param {unknown} error
 * @param {string[]} codes
 */
const isOf = (error, ...codes) => error instanceof Problem && codes.includes(error.code);

/**
 * @param {import("./client.js").Meal} meal
 * @param {string} slot
 * @param {Uint8Array} digest
 */
function hasBytes(meal, slot, digest) {
  const image = { ...meal.images, ...meal.after?.images }[slot];
  return image?.durable === true && image.received_sha256 === Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/**
 * @param {Content} content
 * @returns {Promise<Uint8Array | null>} null where the platform computes no digest (pages over plain HTTP, React Native).
 */
async function sha256(content) {
  if (!globalThis.crypto?.subtle) return null;
  return new Uint8Array(await crypto.subtle.digest("SHA-256", content instanceof Blob ? await content.arrayBuffer() : content));
}

/** @param {Content} content */
const sizeOf = (content) => (content instanceof Blob ? content.size : content.byteLength);

/**
 * @param {Content} content
 * @param {number} start
 * @param {number} end
 */
const slice = (content, start, end) => (content instanceof Uint8Array ? content.subarray(start, end) : content.slice(start, end));
