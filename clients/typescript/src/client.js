/** The conversation of a phone with a server: each method is one call of the API, or a few that belong together. */

import { Problem } from "./errors.js";
import { isLarge, sendInPieces } from "./pieces.js";
import { DEFAULT_RETRIES, secondsUntilNext, sleep } from "./retries.js";
import { sendOnce } from "./transport.js";

/**
 * @typedef {import("./schema.d.ts").components["schemas"]} Schemas
 * @typedef {import("./schema.d.ts").operations} Operations
 * @typedef {Schemas["MealOut"]} Meal
 * @typedef {Operations["put_photograph"]["parameters"]["path"]["slot"]} Slot
 * @typedef {Operations["post_event"]["requestBody"]["content"]["application/json"]} EventWithId
 * @typedef {EventWithId extends infer E ? E extends {id: string} ? Omit<E, "id"> & {id?: string} : never : never} ReviewEvent
 * @typedef {import("./retries.js").RetryPolicy} RetryPolicy
 *
 * @typedef {Blob | ArrayBuffer | Uint8Array<ArrayBuffer> | (() => Promise<Blob | ArrayBuffer | Uint8Array<ArrayBuffer>>)} Photograph
 *   The bytes as the camera wrote them; a function is called only when the server lacks them, so that one is in memory at a time.
 *
 * @typedef {object} CallOptions
 * @property {AbortSignal} [signal] Ends the call: it rejects with the signal's reason.
 * @property {number} [seconds] Time limit of each attempt, until the whole answer is here.
 *
 * @typedef {object} ClientOptions
 * @property {string} [server] Such as "https://tada.example.org"; "" (default): the page's own.
 * @property {string | null} [token] The phone's; `enrol` sets it.
 * @property {string} [appVersion] Sent with every call: the study learns which version sent a meal.
 * @property {typeof fetch} [fetch] Default: the platform's.
 * @property {AbortSignal} [signal] Ends all calls that have none of their own.
 * @property {Partial<RetryPolicy>} [retries] Default: six attempts within about 15 s; longer if the server asks for it.
 */

const JSON_TYPE = "application/json";
const CALL_SECONDS = 30;
const UPLOAD_SECONDS = 300; // 30 MiB, the largest photograph, at 0.8 Mbit/s
const WAIT_SECONDS = 25; // longer ones are cut off by many mobile networks
const ROUNDS = 3; // of sending what the server lacks, also what it accepted and lost before it was durable
const SHORTEST_ROUND_SECONDS = 1; // where something between phone and server answers a wait at once
const FINAL = new Set(["estimated", "needs_review", "failed", "confirmed"]);
const AFTER_FINAL = new Set(["estimated", "needs_review", "failed", "nothing_left"]);

export class TadaClient {
  #fetch;
  #signal;
  #retries;
  #appVersion;

  /** @param {ClientOptions} [options] */
  constructor({ server = "", token = null, appVersion, fetch = globalThis.fetch, signal, retries } = {}) {
    if (server && !/^https?:\/\/[^/?#@]+(\/[^?#]*)?$/i.test(server)) {
      throw new TypeError(`No address of a server: ${server}. It begins with https:// and has no name, query or fragment.`);
    }
    /** The server's address without a slash at its end. */
    this.server = server.replace(/\/+$/, "");
    /** Keep it where other apps cannot read it. null: not enrolled. */
    this.token = token;
    this.#appVersion = appVersion;
    this.#fetch = fetch.bind(globalThis);
    this.#signal = signal;
    /** @type {RetryPolicy} */
    this.#retries = { ...DEFAULT_RETRIES, ...retries };
  }

  // Enrolling and leaving

  /**
   * Exchange a one-time code for a token, which this client then uses. Keep `token` of the answer.
   *
   * If the answer is lost, a call with the same `secret` gets the same token. By default a secret is drawn for this call and
   * its repeats; an app that may end in between draws it (`newId() + newId()`) and keeps it before it calls.
   *
   * @param {Schemas["EnrolmentIn"]} enrolment
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["EnrolmentOut"]>}
   */
  async enrol(enrolment, options) {
    const { secret = newId() + newId(), ...older } = enrolment;
    const post = (/** @type {Schemas["EnrolmentIn"]} */ json) => this.#json("POST", "/v1/enrolments", { ...options, json });
    const enrolled = await post({ ...older, secret }).catch((error) => {
      if (isUnknownField(error, "secret")) return post(older); // a server that knows no secrets has not used the code
      throw error;
    });
    this.token = enrolled.token;
    return enrolled;
  }

  /**
   * The server's version, limits and features; needs no token.
   *
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["ServerOut"]>}
   */
  getServer(options) {
    return this.#json("GET", "/v1/server", options);
  }

  /**
   * The participant, the study's protocol and this phone. Ask now and then: the protocol may change.
   *
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["MeOut"]>}
   */
  getMe(options) {
    return this.#json("GET", "/v1/me", options);
  }

  /**
   * Sign this phone out. What it sent is kept. A token that is no longer valid counts as signed out.
   *
   * @param {CallOptions} [options]
   * @returns {Promise<void>}
   */
  async signOut(options) {
    await this.#json("DELETE", "/v1/me/device", options).catch((error) => {
      if (!(error instanceof Problem && error.code === "unauthenticated")) throw error;
    });
    this.token = null;
  }

  /**
   * Leave the study; its policy decides what is erased. Show the receipt: from now on every call is refused with `withdrawn`.
   * Called again, because the answer was lost, it gets the same receipt.
   *
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["ReceiptOut"]>}
   */
  withdraw(options) {
    return this.#erase("POST", "/v1/me/withdrawal", "withdrawn", options);
  }

  /**
   * Read a receipt again; needs no token.
   *
   * @param {string} id
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["ReceiptOut"]>}
   */
  getReceipt(id, options) {
    return this.#json("GET", `/v1/receipts/${segment(id)}`, options);
  }

  /**
   * All data about the participant, a ZIP file.
   *
   * @param {CallOptions} [options]
   * @returns {Promise<Blob>}
   */
  getMyExport(options) {
    return this.#blob("/v1/me/export", { seconds: UPLOAD_SECONDS, ...options });
  }

  // Meals

  /**
   * Is this pair good enough? Nothing is kept.
   *
   * @param {Blob} left
   * @param {Blob} right
   * @param {Schemas["CheckMetadataIn"]} [metadata]
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["CheckOut"]>}
   */
  checkPair(left, right, metadata, options) {
    const form = new FormData();
    if (metadata) form.append("metadata", new Blob([JSON.stringify(metadata)], { type: JSON_TYPE }), "metadata.json");
    form.append("left", left, "left.jpg");
    form.append("right", right, "right.jpg");
    return this.#json("POST", "/v1/checks", { seconds: UPLOAD_SECONDS, ...options, body: form });
  }

  /**
   * Send a meal part by part: its metadata, then the photographs that the server lacks. The same again, after a reload
   * maybe, continues where it broke off. A photograph may be deleted once `meal.images[slot].durable` is true.
   *
   * @param {string} id A UUID, made once per meal: `newId()`.
   * @param {Schemas["MealMetadataIn"]} metadata
   * @param {Partial<Record<Slot, Photograph>>} photographs By slot: `left`, `right`, ...
   * @param {CallOptions & {onProgress?: (meal: Meal) => unknown}} [options] onProgress: awaited after each answer.
   * @returns {Promise<Meal>}
   */
  async sendMeal(id, metadata, photographs, { onProgress, ...options } = {}) {
    const meal = await this.putMeal(id, metadata, options);
    await onProgress?.(meal);
    return this.#sendMissing(meal, (meal) => meal.missing, photographs, { onProgress, ...options });
  }

  /**
   * Send what was left of a meal: when it was taken, then the photographs that the server lacks.
   *
   * @param {string} id The meal's.
   * @param {Schemas["AfterMetadataIn"]} metadata
   * @param {Partial<Record<Slot, Photograph>>} photographs `after_left` and `after_right`.
   * @param {CallOptions & {onProgress?: (meal: Meal) => unknown}} [options]
   * @returns {Promise<Meal>}
   */
  async sendAfter(id, metadata, photographs, { onProgress, ...options } = {}) {
    const meal = await this.#json("PUT", `/v1/meals/${segment(id)}/after`, { ...options, json: metadata });
    await onProgress?.(meal);
    return this.#sendMissing(meal, (meal) => meal.after?.missing ?? [], photographs, { onProgress, ...options });
  }

  /**
   * Announce a meal; the answer's `missing` lists what is to be sent.
   *
   * @param {string} id
   * @param {Schemas["MealMetadataIn"]} metadata
   * @param {CallOptions} [options]
   * @returns {Promise<Meal>}
   */
  putMeal(id, metadata, options) {
    return this.#json("PUT", `/v1/meals/${segment(id)}`, { ...options, json: metadata });
  }

  /**
   * Send one photograph of an announced meal, as often as needed. A large one goes in pieces, if the server takes them: after
   * a cut connection, also in a later call, only the bytes that it lacks are sent. Always send the same bytes for a slot: a slot
   * that has others refuses them with Problem `meal_id_reused`.
   *
   * @param {string} id
   * @param {Slot} slot
   * @param {Photograph} photograph
   * @param {CallOptions} [options]
   * @returns {Promise<Meal>}
   */
  async putPhotograph(id, slot, photograph, options) {
    const body = typeof photograph === "function" ? await photograph() : photograph;
    const path = `/v1/meals/${segment(id)}/images/${segment(slot)}`;
    const limits = { seconds: UPLOAD_SECONDS, ...options };
    const meal = isLarge(body) ? await sendInPieces(this, { meal: id, slot, path }, body, this.#retries, limits) : null;
    if (meal !== null) return meal;
    const headers = { "Content-Type": "application/octet-stream" };
    return this.#json("PUT", path, { ...limits, headers, body });
  }

  /**
   * Enter a meal without photographs.
   *
   * @param {Schemas["DeclaredMealIn"]} meal
   * @param {CallOptions} [options]
   * @returns {Promise<Meal>}
   */
  declareMeal(meal, options) {
    return this.#json("POST", "/v1/declared-meals", { ...options, json: meal });
  }

  /**
   * The meal as it is now. null: it is still at `knownVersion`.
   *
   * @overload
   * @param {string} id
   * @param {CallOptions & {knownVersion?: undefined, waitSeconds?: number}} [options]
   * @returns {Promise<Meal>}
   */
  /**
   * @overload
   * @param {string} id
   * @param {CallOptions & {knownVersion: number, waitSeconds?: number}} options waitSeconds: answer only when something changes, up to 60.
   * @returns {Promise<Meal | null>}
   */
  /**
   * @param {string} id
   * @param {CallOptions & {knownVersion?: number | undefined, waitSeconds?: number}} [options]
   * @returns {Promise<Meal | null>}
   */
  getMeal(id, { knownVersion, waitSeconds = 0, ...options } = {}) {
    /** @type {Record<string, string>} */
    const headers = knownVersion === undefined ? {} : { "If-None-Match": `"${knownVersion}"` };
    const query = waitSeconds ? { wait: waitSeconds } : {};
    return this.#json("GET", `/v1/meals/${segment(id)}`, { seconds: CALL_SECONDS + waitSeconds, ...options, headers, query });
  }

  /**
   * The meal once nothing of it waits for an estimate: `estimated`, `needs_review`, `failed` or `confirmed`.
   *
   * @param {string} id
   * @param {CallOptions & {pair?: "meal" | "after", onChange?: (meal: Meal) => unknown}} [options]
   *   pair: whose estimate; onChange: awaited at the beginning and after each change, to show `status` and `stage`.
   * @returns {Promise<Meal>}
   */
  async waitForEstimate(id, { pair = "meal", onChange, ...options } = {}) {
    let meal = await this.getMeal(id, options);
    for (;;) {
      await onChange?.(meal);
      if (pair === "meal" ? FINAL.has(meal.status) : AFTER_FINAL.has(meal.after?.status ?? "")) return meal;
      let changed = null;
      while (changed === null) {
        const begun = Date.now();
        changed = await this.getMeal(id, { ...options, knownVersion: meal.version, waitSeconds: WAIT_SECONDS });
        const tooSoon = SHORTEST_ROUND_SECONDS - (Date.now() - begun) / 1000;
        if (changed === null && tooSoon > 0) await sleep(tooSoon, options.signal ?? this.#signal);
      }
      meal = changed;
    }
  }

  /**
   * The participant's meals by time of capture, page by page.
   *
   * @param {{order?: "newest" | "oldest", from?: string, to?: string, limit?: number}} [filters] from, to: local days; limit: of a page.
   * @param {CallOptions} [options]
   * @returns {AsyncGenerator<Schemas["MealListItem"], void, void>}
   */
  async *listMeals(filters = {}, options) {
    /** @type {Schemas["MealPage"]} */
    let page = await this.#json("GET", "/v1/meals", { ...options, query: filters });
    for (;;) {
      yield* page.items;
      if (page.next === null) return;
      page = await this.#json("GET", page.next, options);
    }
  }

  /**
   * Erase a meal for good. Its id cannot be used again. Called again, it gets the same receipt.
   *
   * @param {string} id
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["ReceiptOut"]>}
   */
  deleteMeal(id, options) {
    return this.#erase("DELETE", `/v1/meals/${segment(id)}`, "meal_deleted", options);
  }

  /**
   * Cancel an estimate that is not made yet: the meal fails with `cancelled`.
   *
   * @param {string} id
   * @param {CallOptions} [options]
   * @returns {Promise<Meal>}
   */
  cancelEstimate(id, options) {
    return this.#json("POST", `/v1/meals/${segment(id)}/cancel`, options);
  }

  /**
   * @param {string} id
   * @param {Slot} slot
   * @param {CallOptions & {width?: number}} [options] width: at most so many px.
   * @returns {Promise<Blob>}
   */
  getPhotograph(id, slot, { width, ...options } = {}) {
    return this.#blob(`/v1/meals/${segment(id)}/images/${segment(slot)}`, { ...options, query: { width } });
  }

  /**
   * A picture, the points or the scene of a meal's last run.
   *
   * @param {string} id
   * @param {string} name As the run lists it.
   * @param {CallOptions & {pair?: "meal" | "after"}} [options]
   * @returns {Promise<Blob>}
   */
  getArtefact(id, name, { pair, ...options } = {}) {
    return this.#blob(`/v1/meals/${segment(id)}/artefacts/${segment(name)}`, { ...options, query: { pair } });
  }

  // Reviewing

  /**
   * Confirm, correct, add, answer: `{kind: "confirm", item: item.id}`, `{kind: "set_food", item: item.id, food: "apple"}`, ...
   *
   * Fails with `precondition_failed` if the meal has changed since it was read: read it, show it, ask again. To send an
   * event again after a reload, give it an `id` of its own and keep that.
   *
   * @param {Pick<Meal, "id" | "version">} meal As it was shown.
   * @param {ReviewEvent} event
   * @param {CallOptions} [options]
   * @returns {Promise<Meal>} As it is now.
   */
  sendEvent(meal, event, options) {
    const headers = { "If-Match": `"${meal.version}"` };
    return this.#json("POST", `/v1/meals/${segment(meal.id)}/events`, { ...options, headers, json: { id: newId(), ...event } });
  }

  /**
   * Questions of reviewers that wait for an `answer` event.
   *
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["QuestionOut"][]>}
   */
  async getQuestions(options) {
    return (await this.#json("GET", "/v1/me/questions", options)).items;
  }

  /**
   * Foods by words of their names, best match first.
   *
   * @param {string} words
   * @param {CallOptions & {limit?: number}} [options]
   * @returns {Promise<Schemas["FoodMatch"][]>}
   */
  async searchFoods(words, { limit, ...options } = {}) {
    return (await this.#json("GET", "/v1/foods", { ...options, query: { q: words, limit } })).items;
  }

  /**
   * @param {string} key
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["FoodOut"]>}
   */
  getFood(key, options) {
    return this.#json("GET", `/v1/foods/${segment(key)}`, options);
  }

  /**
   * A packaged food by the digits of its barcode. Throws Problem `barcode_invalid`, `barcode_unknown`.
   *
   * @param {string} barcode
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["PackagedFoodOut"]>}
   */
  getPackagedFood(barcode, options) {
    return this.#json("GET", `/v1/packaged-foods/${segment(barcode)}`, options);
  }

  /**
   * The packaged food of the one barcode in a photograph, which the platform reads if it can, or else the server. Throws
   * Problem as `getPackagedFood`, and `barcode_not_found`, `barcodes_several`.
   *
   * @param {Blob} photograph
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["PackagedFoodOut"]>}
   */
  async findPackagedFood(photograph, options) {
    const barcode = await detectBarcode(photograph);
    if (barcode !== null) return this.getPackagedFood(barcode, options);
    const headers = { "Content-Type": "application/octet-stream" };
    return this.#json("POST", "/v1/barcodes", { seconds: UPLOAD_SECONDS, ...options, headers, body: photograph });
  }

  /**
   * The participant's favourites: foods and amounts under a name.
   *
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["FavouriteList"]>}
   */
  getFavourites(options) {
    return this.#json("GET", "/v1/me/favourites", options);
  }

  /**
   * Replace all favourites.
   *
   * @param {Schemas["FavouriteList"]} favourites
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["FavouriteList"]>}
   */
  putFavourites(favourites, options) {
    return this.#json("PUT", "/v1/me/favourites", { ...options, json: favourites });
  }

  /**
   * The study's vessels, for a hint's `vessel`.
   *
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["PhoneVesselOut"][]>}
   */
  async getVessels(options) {
    return (await this.#json("GET", "/v1/me/vessels", options)).items;
  }

  // The diary

  /**
   * Days with a meal or an entry; without a range, the last month.
   *
   * @param {CallOptions & {from?: string, to?: string}} [options] Local days, such as "2026-11-21".
   * @returns {Promise<Schemas["DayOut"][]>}
   */
  async getDays({ from, to, ...options } = {}) {
    return (await this.#json("GET", "/v1/me/days", { ...options, query: { from, to } })).items;
  }

  /**
   * Close a day, say that nothing was eaten, or open it again.
   *
   * @param {Pick<Schemas["DayOut"], "date" | "version">} day As it was shown; version 0: it is not listed.
   * @param {Schemas["DayIn"]} entry
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["DayOut"]>}
   */
  putDay(day, entry, options) {
    const headers = { "If-Match": `"${day.version}"` };
    return this.#json("PUT", `/v1/me/days/${segment(day.date)}`, { ...options, headers, json: entry });
  }

  /**
   * A day in figures and sentences; refused with `feedback_off` where the study gives no feedback.
   *
   * @param {CallOptions & {date?: string}} [options] date: default: the last day with a meal or an entry.
   * @returns {Promise<Schemas["SummaryOut"]>}
   */
  getSummary({ date, ...options } = {}) {
    return this.#json("GET", "/v1/me/summary", { ...options, query: { date } });
  }

  // Reminders

  /**
   * This phone's reminders by Web Push, and the server's key to subscribe with.
   *
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["RemindersOut"]>}
   */
  getReminders(options) {
    return this.#json("GET", "/v1/me/reminders", options);
  }

  /**
   * Subscribe to reminders, or change when they come. Send the subscription and the time zone again when they change.
   *
   * @param {Schemas["RemindersIn"]} reminders subscription: of the browser, by `toJSON()`.
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["RemindersOut"]>}
   */
  putReminders(reminders, options) {
    return this.#json("PUT", "/v1/me/reminders", { ...options, json: reminders });
  }

  /**
   * @param {CallOptions} [options]
   * @returns {Promise<void>}
   */
  deleteReminders(options) {
    return this.#json("DELETE", "/v1/me/reminders", options);
  }

  // Common to all calls

  /**
   * Any other call of the API. Throws Problem, NetworkError, or the signal's reason.
   *
   * @param {string} method
   * @param {string} path
   * @param {CallOptions & {query?: Record<string, unknown>, headers?: Record<string, string>, json?: unknown, body?: BodyInit, read?: "json" | "blob", attempts?: number}} [options]
   * @returns {Promise<import("./transport.js").Answer>}
   */
  async request(method, path, { query, headers, json, body, read = "json", attempts, seconds = CALL_SECONDS, signal } = {}) {
    if (!path.startsWith("/") || path.startsWith("//")) throw new TypeError(`No path of the server: ${path}`);
    const caller = signal ?? this.#signal;
    const attempt = {
      method,
      url: this.server + path + queryText(query),
      body: json === undefined ? body : JSON.stringify(json),
      read,
      seconds,
      signal: caller,
    };
    for (let number = 1; ; number++) {
      try {
        return await sendOnce(this.#fetch, { ...attempt, headers: { ...this.#headers(json), ...headers } });
      } catch (error) {
        const pause = secondsUntilNext(error, number, attempts === undefined ? this.#retries : { ...this.#retries, attempts });
        if (pause === null) throw error;
        await sleep(pause, caller);
      }
    }
  }

  /**
   * @param {unknown} json
   * @returns {Record<string, string>}
   */
  #headers(json) {
    return {
      Accept: "application/json, */*;q=0.5",
      Date: new Date().toUTCString(), // the study learns the error of the phone's clock; browsers leave it out
      ...(json === undefined ? {} : { "Content-Type": JSON_TYPE }),
      ...(this.token === null ? {} : { Authorization: `Bearer ${this.token}` }),
      ...(this.#appVersion === undefined ? {} : { "X-App-Version": this.#appVersion }),
    };
  }

  /**
   * @param {string} method
   * @param {string} path
   * @param {Parameters<TadaClient["request"]>[2]} [options]
   * @returns {Promise<any>} null: 204 or 304.
   */
  async #json(method, path, options) {
    return (await this.request(method, path, options)).body;
  }

  /**
   * @param {string} path
   * @param {Parameters<TadaClient["request"]>[2]} options
   * @returns {Promise<Blob>}
   */
  async #blob(path, options) {
    return (await this.request("GET", path, { ...options, read: "blob" })).body;
  }

  /**
   * An erasure's receipt, also if the answer was lost and the repeat is refused because it is done.
   *
   * @param {string} method
   * @param {string} path
   * @param {"withdrawn" | "meal_deleted"} codeOfErased
   * @param {CallOptions} [options]
   * @returns {Promise<Schemas["ReceiptOut"]>}
   */
  async #erase(method, path, codeOfErased, options) {
    try {
      return await this.#json(method, path, options);
    } catch (error) {
      const receipt = error instanceof Problem && error.code === codeOfErased && error.document.receipt;
      if (!receipt) throw error;
      return this.getReceipt(String(receipt), options);
    }
  }

  /**
   * @param {Meal} meal
   * @param {(meal: Meal) => string[]} missingOf Slots of an answer: a newer server may know more.
   * @param {Partial<Record<Slot, Photograph>>} photographs
   * @param {CallOptions & {onProgress?: ((meal: Meal) => unknown) | undefined}} options
   * @returns {Promise<Meal>}
   */
  async #sendMissing(meal, missingOf, photographs, { onProgress, ...options }) {
    for (let round = 0; round < ROUNDS; round++) {
      for (const slot of /** @type {Slot[]} */ (missingOf(meal))) {
        const photograph = photographs[slot];
        if (photograph === undefined) throw new TypeError(`The server waits for a photograph that was not given: ${slot}`);
        meal = await this.putPhotograph(meal.id, slot, photograph, options);
        await onProgress?.(meal);
      }
    }
    return meal;
  }
}

/**
 * A random UUID, also on pages over plain HTTP, where `crypto.randomUUID` is lacking.
 *
 * @returns {string}
 */
export function newId() {
  if (typeof globalThis.crypto?.randomUUID === "function") return crypto.randomUUID();
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  bytes[6] = (/** @type {number} */ (bytes[6]) & 0x0f) | 0x40; // version 4
  bytes[8] = (/** @type {number} */ (bytes[8]) & 0x3f) | 0x80; // variant of RFC 9562
  const hex = Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
  return hex.replace(/^(.{8})(.{4})(.{4})(.{4})/, "$1-$2-$3-$4-");
}

/**
 * What was eaten of a meal, as items of a meal without photographs or of a favourite, marked as copied: `declareMeal({...,
 * items: copyItems(yesterday, 0.5)})` enters half of it. Amounts that are not known stay so.
 *
 * @param {Meal} meal
 * @param {number} [factor]
 * @returns {Schemas["DeclaredItemIn"][]}
 */
export function copyItems(meal, factor = 1) {
  return meal.items.flatMap(({ status, food, consumed_g, consumed_interval_g }) => {
    if (status === "rejected" || !food || consumed_g === 0) return [];
    if (consumed_g === null || consumed_g < 0) return [{ food: food.key, copied: true }];
    const [low, high] = consumed_interval_g ?? [0, 0];
    const sd = low > 0 ? Math.log(high / low) / 3.29 : 0; // of a 90 % interval
    const relative_sd = Math.min(2, Math.max(0.25, sd)); // at least that of memory
    return [{ food: food.key, amount: { mass_g: consumed_g * factor, of: "edible", relative_sd }, copied: true }];
  });
}

/**
 * The digits of the one barcode in a photograph; null where the platform reads none.
 *
 * @param {Blob} photograph
 * @returns {Promise<string | null>}
 */
async function detectBarcode(photograph) {
  const Detector = /** @type {any} */ (globalThis).BarcodeDetector;
  if (!Detector) return null;
  try {
    const detector = new Detector({ formats: ["ean_13", "ean_8", "upc_a"] });
    const codes = await detector.detect(await createImageBitmap(photograph));
    const digits = new Set(codes.map((/** @type {{rawValue: string}} */ code) => code.rawValue));
    return digits.size === 1 ? [...digits][0] : null;
  } catch {
    return null; // it has no reader of its own, or cannot decode the photograph
  }
}

/**
 * True if a server refuses a field of the body that it does not know.
 *
 * @param {unknown} error
 * @param {string} name
 */
function isUnknownField(error, name) {
  const errors = error instanceof Problem && error.status === 422 ? error.document.errors : null;
  return Array.isArray(errors) && errors.some(({ at, type }) => at === `body.${name}` && type === "extra_forbidden");
}

/** @param {string} value */
function segment(value) {
  if (/^\.{0,2}$/.test(value)) throw new TypeError(`No part of a path: ${JSON.stringify(value)}`);
  return encodeURIComponent(value);
}

/** @param {Record<string, unknown>} [query] undefined and null values are left out. */
function queryText(query = {}) {
  const pairs = Object.entries(query).filter(([, value]) => value !== undefined && value !== null);
  const text = pairs.map(([name, value]) => `${encodeURIComponent(name)}=${encodeURIComponent(String(value))}`).join("&");
  return text && `?${text}`;
}
