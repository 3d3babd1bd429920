// Send what waits in the store. Tabs and the service worker all call `sendWaiting`; a lock lets one of them send. Each
// step can be repeated after a crash: the server knows meals, photographs and events by ids that were made here.

import { NetworkError, Problem, TadaClient } from "./client/index.js";
import * as store from "./store.js";
import { VOICE_NOTE } from "./voice_note.js";

const LOCK = "tada-capture-sender";
const FIRST_WAIT_MS = 5_000;
const LONGEST_WAIT_MS = 15 * 60_000;
const ONE_TRY = { attempts: 2, firstSeconds: 1 }; // further tries are the queue's, whose waits outlive the page
const OF_THE_PHONE = new Set(["unauthenticated", "withdrawn"]); // no meal can be sent until the person acts
const REFUSED_FILE = new Set([413, 422]);
const OF_PROXIES = "unknown"; // the code of a refusal without a problem document: not the server's

let running = null; // of this tab, where the browser has no locks

/** A client with an enrolment's token, or null if the phone is not enrolled. */
export const clientOf = (phone, options = {}) =>
  phone?.token ? new TadaClient({ server: phone.server, token: phone.token, appVersion: "capture-page 1", ...options }) : null;

/**
 * Send every record whose turn has come. Returns the time (ms) of the next try, or null if nothing waits.
 * If another tab is sending, nothing is sent here.
 *
 * @param {{now?: () => number, random?: () => number}} clock
 */
export async function sendWaiting({ now = Date.now, random = Math.random } = {}) {
  const run = async (lock) => lock !== null && sendAll(now, random);
  const { locks } = navigator; // lacking on pages over plain HTTP: there two tabs may send the same twice, harmlessly
  if (locks) await locks.request(LOCK, { ifAvailable: true }, run);
  else await (running ??= run().finally(() => (running = null)));
  return nextTryMs();
}

/** The time (ms) of the next try, or null if nothing waits. */
export async function nextTryMs() {
  const phone = await store.phone();
  const times = phone?.token ? (await waitingOf(phone)).map((record) => record.next_try_ms) : [];
  return times.length ? Math.min(...times) : null;
}

/** True if something of a record may still have to be sent. */
export const isUnsent = (record) => record.state === "waiting";

/** Try a record again now, also one that was refused. */
export const retryNow = (id) =>
  store.changeMeal(id, (record) => {
    if (record.state !== "waiting" && record.state !== "refused") return false;
    Object.assign(record, { state: "waiting", next_try_ms: 0, tries: 0, problem: null });
  });

/**
 * Note that the server no longer knows this enrolment, if an error says so. A token that was revoked leaves everything
 * here, for when the person joins again; whoever has left the study leaves nothing.
 */
export async function noteEnd(error, phone) {
  if (!OF_THE_PHONE.has(error.code)) return false;
  if (error.code === "withdrawn") {
    await store.deleteOwner(phone, { locale: phone.locale, ended_by: error.code, receipt: error.document.receipt });
  } else {
    await store.changePhone(phone.token, (stored) => ({ ...stored, token: null, ended_by: error.code }));
  }
  return true;
}

/** The wait after so many failed tries, ms: doubled each time, with a random part; never before the server's Retry-After. */
export function waitMs(tries, retryAfterSeconds, random) {
  const most = Math.min(LONGEST_WAIT_MS, FIRST_WAIT_MS * 2 ** Math.min(tries - 1, 20));
  return Math.max(most * (0.5 + 0.5 * random()), (retryAfterSeconds ?? 0) * 1000);
}

// Confirmations first, since what else waits makes a later version of their meal; then the oldest first. Token and owner
// come from one reading: another person may join meanwhile.
async function sendAll(now, random) {
  const phone = await store.phone();
  const client = clientOf(phone, { retries: ONE_TRY });
  if (!client) return;
  const records = (await waitingOf(phone)).reverse().sort((a, b) => (b.part === "review") - (a.part === "review"));
  for (const record of records) {
    if (isEarly(record, now())) continue;
    try {
      await { meal: sendMeal, after: sendAfter, review: sendReview }[record.part](client, record);
    } catch (error) {
      if ((await noteEnd(error, phone)) || !(await noteFailure(record, error, now(), random))) return;
    }
  }
}

const waitingOf = async (phone) => {
  const owner = store.ownerOf(phone);
  return (await store.meals()).filter((record) => record.owner === owner && isUnsent(record));
};

// A clock that was set back, to before the wait began, must not hold a meal for years.
const isEarly = (record, now_ms) => record.waited_from_ms <= now_ms && now_ms < record.next_try_ms;

async function sendMeal(client, record) {
  const missing = record.slots.filter((slot) => !record.durable.includes(slot));
  if (!record.is_announced || missing.length) {
    const metadata = { captured_at: record.captured_at, time_zone: record.time_zone };
    if (!record.slots.includes("right")) metadata.views = 1;
    await noteDurable(record.id, filesOf(await client.putMeal(record.meal, metadata)));
    await store.changeMeal(record.id, (record) => {
      record.is_announced = true;
    });
  }
  await sendPhotographs(client, record, missing, filesOf);
  if (record.comment) {
    await sendEvent(client, record, { id: record.comment.id, kind: "comment", text: record.comment.text });
  }
  await store.changeMeal(record.id, (record) => {
    Object.assign(record, { state: "sent", comment: null, problem: null });
  });
}

// Photographs and voice note of a meal that the server has, by slot.
const filesOf = ({ images, voice_note }) => (voice_note ? { ...images, voice_note } : images);

async function sendAfter(client, record) {
  const missing = record.slots.filter((slot) => !record.durable.includes(slot));
  if (missing.length) {
    const address = `/v1/meals/${record.meal}/after`;
    await client.request("PUT", address, { json: { captured_at: record.captured_at } }).catch(passIfQueued);
    await sendPhotographs(client, record, missing, (document) => document.after.images);
  }
  if (record.all_eaten) await sendEvent(client, record, { id: record.all_eaten.id, kind: "nothing_left" });
  await store.deleteMeal(record.id, "waiting");
}

// Each for the version that the one before it has made: what nobody has seen is not confirmed.
async function sendReview(client, { id, meal, version, events }) {
  for (const event of events) {
    ({ version } = await client.sendEvent({ id: meal, version }, event));
    await store.dropEvent(id, event, version);
  }
}

// A pair that is already queued has its metadata: the photographs decide whether they are the same.
function passIfQueued(error) {
  if (!(error instanceof Problem && error.code === "after_pair_queued")) throw error;
}

async function sendPhotographs(client, record, slots, imagesOf) {
  for (const slot of slots) {
    const kept = await store.photograph(record.id, slot);
    if (!kept) continue; // another tab sent it
    try {
      const document = await client.putPhotograph(record.meal, slot, store.blobOf(kept));
      await noteDurable(record.id, imagesOf(document));
    } catch (error) {
      if (slot !== VOICE_NOTE || !isRefusal(error) || !REFUSED_FILE.has(error.status)) throw error;
      await store.dropNote(record.id, slot); // it must not hold its meal back
    }
  }
  const { slots: left, durable } = (await store.meal(record.id)) ?? { slots: [], durable: [] };
  if (slots.some((slot) => left.includes(slot) && !durable.includes(slot))) throw new NetworkError("A photograph is not durable yet.", null);
}

async function noteDurable(id, images) {
  const durable = Object.keys(images).filter((slot) => images[slot].durable);
  for (const slot of durable) await requireSameBytes(id, slot, images[slot].received_sha256);
  if (durable.length) await store.markDurable(id, durable);
}

// Without a secure context a browser computes no digest; the server compares bytes with its own digest in any case.
async function requireSameBytes(id, slot, sha256) {
  const photograph = await store.photograph(id, slot);
  if (!photograph || !crypto.subtle) return;
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", photograph.bytes));
  const hex = Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
  if (hex === sha256) return;
  throw new Problem(409, { code: "bytes_differ", detail: "The server has other bytes than this phone.", retryable: false }, null);
}

const sendEvent = async (client, record, event) => client.sendEvent(await client.getMeal(record.meal), event);

// The server itself refuses, for good.
const isRefusal = (error) =>
  error instanceof Problem && error.code !== OF_PROXIES && !error.retryable && error.code !== "precondition_failed";

// Returns whether the next record may be tried: not if the network or the server's patience is at an end.
async function noteFailure({ id, meal, part }, error, now_ms, random) {
  if (error.code === "meal_deleted") {
    await store.eraseMeal(meal);
    return true;
  }
  const isRefused = isRefusal(error);
  if (part === "review" && (isRefused || error.code === "precondition_failed")) {
    await store.deleteMeal(id); // the meal has changed: its page asks again
    return true;
  }
  await store.changeMeal(id, (record) => {
    record.tries += 1;
    const code = error instanceof Problem ? error.code : error instanceof NetworkError ? "network" : "internal";
    record.problem = { code, detail: error.message };
    if (isRefused) record.state = "refused";
    else Object.assign(record, { waited_from_ms: now_ms, next_try_ms: now_ms + waitMs(record.tries, error.retryAfterSeconds, random) });
  });
  return isRefused || !(error instanceof Problem || error instanceof NetworkError) || error.code === "precondition_failed";
}
