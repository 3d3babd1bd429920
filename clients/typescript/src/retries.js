/** When a failed attempt is repeated: exponential backoff with full jitter, and `Retry-After`. */

import { NetworkError, Problem, TRANSIENT } from "./errors.js";

/**
 * @typedef {object} RetryPolicy
 * @property {number} attempts How often a call is sent at most; 1: once.
 * @property {number} firstSeconds Upper bound of the first wait; it doubles with each attempt.
 * @property {number} longestSeconds Upper bound of every wait. If `Retry-After` is longer, the call fails at once, with `retryAfterSeconds`.
 * @property {() => number} random From 0 to 1.
 */

/** @type {RetryPolicy} */
export const DEFAULT_RETRIES = { attempts: 6, firstSeconds: 0.5, longestSeconds: 60, random: Math.random };

/**
 * True if the same request may succeed in a moment. A problem document's `retryable` decides over its status.
 *
 * @param {unknown} error
 */
export function isTransient(error) {
  return error instanceof NetworkError || (error instanceof Problem && error.retryable && TRANSIENT.has(error.status));
}

/**
 * Seconds until the next attempt; null: do not repeat.
 *
 * @param {unknown} error What the attempt threw.
 * @param {number} attempt Its number, from 1.
 * @param {RetryPolicy} policy
 * @returns {number | null}
 */
export function secondsUntilNext(error, attempt, policy) {
  if (attempt >= policy.attempts || !isTransient(error)) return null;
  const jitter = policy.random() * Math.min(policy.longestSeconds, policy.firstSeconds * 2 ** (attempt - 1));
  const asked = error instanceof Problem ? error.retryAfterSeconds : null;
  if (asked === null) return jitter;
  return asked > policy.longestSeconds ? null : asked + jitter; // not all clients at the same moment
}

/**
 * Seconds that `Retry-After` asks for: a number of them, or a date (RFC 9110, section 10.2.3). null: absent or unreadable.
 *
 * A date is compared with the answer's own `Date` where it can be seen: a phone's clock may be wrong.
 *
 * @param {Headers} headers
 * @param {number} [nowMs]
 * @returns {number | null}
 */
export function retryAfterSeconds(headers, nowMs = Date.now()) {
  const value = headers.get("Retry-After")?.trim();
  if (!value) return null;
  if (/^\d+$/.test(value)) return Number(value);
  const until = value.endsWith("GMT") ? Date.parse(value) : NaN;
  if (Number.isNaN(until)) return null;
  const sent = Date.parse(headers.get("Date") ?? "");
  return Math.max(0, (until - (Number.isNaN(sent) ? nowMs : sent)) / 1000);
}

/**
 * @param {number} seconds
 * @param {AbortSignal} [signal] Rejects with its reason.
 * @returns {Promise<void>}
 */
export function sleep(seconds, signal) {
  return new Promise((resolve, reject) => {
    if (signal?.aborted) return reject(abortReason(signal));
    const onAbort = () => {
      clearTimeout(timer);
      reject(abortReason(/** @type {AbortSignal} */ (signal)));
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", onAbort);
      resolve();
    }, seconds * 1000);
    signal?.addEventListener("abort", onAbort, { once: true });
  });
}

/**
 * A signal's reason, also where the platform keeps none (React Native).
 *
 * @param {AbortSignal} signal
 * @returns {unknown}
 */
export function abortReason(signal) {
  return signal.reason ?? Object.assign(new Error("The call was aborted."), { name: "AbortError" });
}
