import assert from "node:assert/strict";
import { test } from "node:test";

import { NetworkError, Problem } from "../src/errors.js";
import { isTransient, retryAfterSeconds, secondsUntilNext, sleep } from "../src/retries.js";

const policy = { attempts: 4, firstSeconds: 1, longestSeconds: 5, random: () => 0.5 };
const refusal = (status, document = null, retryAfter = null) => new Problem(status, document, retryAfter);

test("upper bound of the wait doubles until the longest, and the wait is a random part of it", () => {
  const lost = new NetworkError("lost", null);
  const most = { ...policy, attempts: 9, random: () => 1 };
  assert.deepEqual([1, 2, 3, 4, 5].map((attempt) => secondsUntilNext(lost, attempt, most)), [1, 2, 4, 5, 5]);
  assert.equal(secondsUntilNext(lost, 2, policy), 1);
  assert.equal(secondsUntilNext(lost, 2, { ...policy, random: () => 0 }), 0);
});

test("last attempt is not followed by another", () => {
  assert.equal(secondsUntilNext(new NetworkError("lost", null), 4, policy), null);
});

test("Retry-After is a lower bound, and one past the longest wait ends the call", () => {
  assert.equal(secondsUntilNext(refusal(503, null, 3), 1, policy), 3.5);
  assert.equal(secondsUntilNext(refusal(429, { retryable: true }, 0), 1, policy), 0.5);
  assert.equal(secondsUntilNext(refusal(503, null, 6), 1, policy), null);
});

test("only passing faults are repeated", () => {
  for (const status of [408, 425, 429, 500, 502, 503, 504]) assert.ok(isTransient(refusal(status)), String(status));
  for (const status of [400, 401, 403, 404, 409, 410, 412, 413, 415, 422, 428, 501]) {
    assert.ok(!isTransient(refusal(status)), String(status));
  }
  assert.ok(!isTransient(refusal(500, { code: "blob_missing", retryable: false })));
  assert.ok(!isTransient(refusal(409, { code: "clock_differs", retryable: true })));
  assert.ok(!isTransient(new TypeError("a bug")));
});

test("Retry-After is read as seconds and as a date by the answer's own clock", () => {
  const date = "Fri, 20 Nov 2026 12:00:30 GMT";
  const noon = Date.parse("Fri, 20 Nov 2026 12:00:00 GMT");
  assert.equal(retryAfterSeconds(new Headers({ "Retry-After": "7" })), 7);
  assert.equal(retryAfterSeconds(new Headers({ "Retry-After": date }), noon), 30);
  const sent = { "Retry-After": date, Date: "Fri, 20 Nov 2026 12:00:20 GMT" };
  assert.equal(retryAfterSeconds(new Headers(sent), 0), 10);
  assert.equal(retryAfterSeconds(new Headers({ "Retry-After": date }), noon + 60_000), 0);
  for (const unreadable of ["", "soon", "-3", "1.5"]) {
    assert.equal(retryAfterSeconds(new Headers({ "Retry-After": unreadable })), null, unreadable);
  }
  assert.equal(retryAfterSeconds(new Headers()), null);
});

test("aborted sleep ends at once with the signal's reason", async () => {
  const controller = new AbortController();
  const slept = sleep(60, controller.signal);
  controller.abort(new Error("enough"));
  await assert.rejects(slept, /enough/);
  await assert.rejects(sleep(60, controller.signal), /enough/);
});
