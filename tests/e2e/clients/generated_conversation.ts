/**
 * A phone's conversation by openapi-fetch with the types that openapi-typescript makes of our document; see test_clients.py.
 *
 * node generated_conversation.js SERVER ENROLMENT_CODE FOLDER_OF_PHOTOGRAPHS
 */

import assert from "node:assert/strict";
import { openAsBlob } from "node:fs";

import createClient from "openapi-fetch";

import type { paths } from "./schema.js";

const [server, code, folder] = process.argv.slice(2) as [string, string, string];
const left = await openAsBlob(`${folder}/left.jpg`);
const right = await openAsBlob(`${folder}/right.jpg`);
const anybody = createClient<paths>({ baseUrl: server });

/** The answer's body, which must be a good one, and JSON: some lists are CSV where that is asked for. */
function good<T>({ data, error, response }: { data?: T; error?: unknown; response: Response }): Exclude<T, string> {
  assert.ok(response.ok && data !== undefined && typeof data !== "string", `${response.status} ${response.url} ${JSON.stringify(error)}`);
  return data as Exclude<T, string>;
}

const { token } = good(await anybody.POST("/v1/enrolments", { body: { code, device_name: "generated" } }));
const phone = createClient<paths>({ baseUrl: server, headers: { Authorization: `Bearer ${token}` } });
assert.equal(good(await phone.GET("/v1/me")).participant, "P001");

const pair = new FormData();
pair.append("left", left, "left.jpg");
pair.append("right", right, "right.jpg");
const checked = await phone.POST("/v1/checks", { body: { left: "", right: "" }, bodySerializer: () => pair });
assert.equal(good(checked).ok, true);

const meal_id = crypto.randomUUID();
const at = { params: { path: { meal_id } } };
const metadata = { captured_at: "2026-11-20T12:30:00Z", time_zone: "Europe/London", hints: [{ point: [1092, 620] as [number, number], food: "apple" }] };
let meal = good(await phone.PUT("/v1/meals/{meal_id}", { ...at, body: metadata }));
for (const [slot, photograph] of [["left", left], ["right", right]] as const) {
  const params = { path: { meal_id, slot } };
  const headers = { "Content-Type": "application/octet-stream" };
  meal = good(await phone.PUT("/v1/meals/{meal_id}/images/{slot}", { params, headers, body: "", bodySerializer: () => photograph }));
  assert.equal(meal.images[slot]?.durable, true);
}
while (meal.status === "queued" || meal.status === "processing") {
  meal = good(await phone.GET("/v1/meals/{meal_id}", { params: { path: { meal_id }, query: { wait: 25 } } }));
}
assert.equal(meal.status, "estimated");

const item = meal.items[0]!.id;
const ifMatch = () => ({ "if-match": `"${meal.version}"` });
const say = { path: { meal_id } };
meal = good(
  await phone.POST("/v1/meals/{meal_id}/events", { params: { ...say, header: ifMatch() }, body: { id: crypto.randomUUID(), kind: "confirm", item } }),
);
assert.equal(meal.status, "confirmed");
const [food] = good(await phone.GET("/v1/foods", { params: { query: { q: "banana", limit: 1 } } })).items;
meal = good(
  await phone.POST("/v1/meals/{meal_id}/events", { params: { ...say, header: ifMatch() }, body: { id: crypto.randomUUID(), kind: "set_food", item, food: food!.key } }),
);
assert.equal(meal.items[0]!.food?.key, food!.key);
const after = good(await phone.PUT("/v1/meals/{meal_id}/after", { ...at, body: { captured_at: "2026-11-20T12:50:00Z" } })).after;
assert.deepEqual(after?.missing, ["after_left", "after_right"]);

const [day] = good(await phone.GET("/v1/me/days", { params: { query: { from: meal.local_date, to: meal.local_date } } })).items;
const closing = { path: { day: day!.date }, header: { "if-match": `"${day!.version}"` } };
assert.equal(good(await phone.PUT("/v1/me/days/{day}", { params: closing, body: { status: "closed" } })).status, "closed");
assert.equal((await phone.GET("/v1/me/summary")).error?.code, "feedback_off");

assert.equal(good(await phone.DELETE("/v1/meals/{meal_id}", at)).what, "meal");
assert.equal((await phone.GET("/v1/meals/{meal_id}", at)).error?.code, "meal_deleted");
const { id } = good(await phone.POST("/v1/me/withdrawal"));
assert.equal(good(await anybody.GET("/v1/receipts/{receipt}", { params: { path: { receipt: id } } })).what, "participant");
assert.equal((await phone.GET("/v1/me")).error?.code, "withdrawn");
console.log("done");
