/** One attempt at one request: `fetch` with a time limit, read to its end, and its refusal as an error. */

import { NetworkError, Problem } from "./errors.js";
import { abortReason, retryAfterSeconds } from "./retries.js";

/**
 * @typedef {object} Attempt
 * @property {string} method
 * @property {string} url
 * @property {Record<string, string>} headers
 * @property {BodyInit | undefined} body Something that can be sent again: no stream.
 * @property {"json" | "blob"} read What a successful answer is.
 * @property {number} seconds Until the whole answer is here.
 * @property {AbortSignal | undefined} signal The caller's.
 *
 * @typedef {object} Answer
 * @property {number} status
 * @property {Headers} headers
 * @property {any} body null without content.
 */

/**
 * Throws Problem, NetworkError, or the reason of the caller's signal.
 *
 * @param {typeof fetch} fetch
 * @param {Attempt} attempt
 * @returns {Promise<Answer>}
 */
export async function sendOnce(fetch, { method, url, headers, body, read, seconds, signal }) {
  if (signal?.aborted) throw abortReason(signal);
  const controller = new AbortController(); // AbortSignal.any and .timeout are lacking in Safari 16 and React Native
  const abort = () => controller.abort();
  let isLate = false;
  const timer = setTimeout(() => {
    isLate = true;
    abort();
  }, seconds * 1000);
  signal?.addEventListener("abort", abort, { once: true });
  try {
    const response = await fetch(url, {
      method,
      headers,
      ...(body === undefined ? {} : { body }),
      signal: controller.signal,
      credentials: "omit", // the token is all that the server needs: no cookie of another page goes with it
      cache: "no-store", // of meals nothing stays in a browser's cache
      redirect: "error", // the token goes to the named server only
    });
    if (!response.ok && response.status !== 304) {
      throw new Problem(response.status, await problemDocument(response), retryAfterSeconds(response.headers));
    }
    const isEmpty = response.status === 204 || response.status === 304;
    const content = isEmpty ? null : await (read === "json" ? response.json() : response.blob());
    return { status: response.status, headers: response.headers, body: content };
  } catch (error) {
    if (error instanceof Problem) throw error;
    if (signal?.aborted) throw abortReason(signal);
    throw new NetworkError(isLate ? `No whole answer within ${seconds} s.` : "The connection failed.", error);
  } finally {
    clearTimeout(timer);
    signal?.removeEventListener("abort", abort);
  }
}

/**
 * Rejects if the document breaks off: without its code a refusal cannot be told from others.
 *
 * @param {Response} response
 * @returns {Promise<Record<string, unknown> | null>} null: no problem document.
 */
async function problemDocument(response) {
  if (!response.headers.get("Content-Type")?.startsWith("application/problem+json")) return null;
  const text = await response.text();
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}
