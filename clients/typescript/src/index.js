/**
 * tada-client: what a phone needs to talk with a tada-server.
 *
 * @module
 */

export { TadaClient, copyItems, newId } from "./client.js";
export { NetworkError, Problem } from "./errors.js";

/** @typedef {import("./schema.d.ts").components["schemas"]} Schemas Every body of the API by its name, such as `Schemas["MealOut"]`. */
/** @typedef {import("./client.js").Photograph} Photograph */
/** @typedef {import("./client.js").Slot} Slot */
/** @typedef {import("./client.js").ReviewEvent} ReviewEvent */
/** @typedef {import("./client.js").CallOptions} CallOptions */
/** @typedef {import("./client.js").ClientOptions} ClientOptions */
/** @typedef {import("./retries.js").RetryPolicy} RetryPolicy */
