/**
 * The whole conversation of a phone by clients/typescript, against a running server; see test_typescript_client.py.
 *
 * node typescript_conversation.mjs SERVER ENROLMENT_CODE FOLDER_OF_PHOTOGRAPHS
 */

import assert from "node:assert/strict";
import { createECDH, randomBytes } from "node:crypto";
import { openAsBlob } from "node:fs";
import path from "node:path";

import { Problem, TadaClient, newId } from "../../../clients/typescript/src/index.js";

const [server, code, folder] = process.argv.slice(2);
const phone = new TadaClient({ server, appVersion: "test 1", retries: { attempts: 10, firstSeconds: 0.01 } });
const isProblem = (status, name) => (error) => error instanceof Problem && error.status === status && error.code === name;

assert.ok((await phone.getServer()).features.includes("parts"));
await assert.rejects(phone.getMe(), isProblem(401, "unauthenticated"));
const enrolled = await phone.enrol({ code, device_name: "node" });
assert.equal(phone.token, enrolled.token);
await assert.rejects(phone.enrol({ code, device_name: "node" }), isProblem(404, "enrolment_code_invalid"));
assert.equal((await phone.getMe()).participant, "P001");
assert.deepEqual(await phone.getVessels(), []);

const left = await openAsBlob(path.join(folder, "left.jpg"));
const right = await openAsBlob(path.join(folder, "right.jpg"));
assert.equal((await phone.checkPair(left, right, { locale: "en" })).ok, true);

const id = newId();
const metadata = {
  captured_at: "2026-11-20T12:30:00+00:00",
  time_zone: "Europe/London",
  hints: [{ point: [1092, 620], food: "apple" }],
};
const missing = [];
let meal = await phone.sendMeal(id, metadata, { left, right: async () => right }, { onProgress: (now) => missing.push(now.missing) });
assert.deepEqual(missing, [["left", "right"], ["right"], []]);
assert.ok(Object.values(meal.images).every((image) => image.durable));
const again = await phone.sendMeal(id, metadata, {}); // as after a reload: nothing is left to send
assert.deepEqual(again.missing, []);
await assert.rejects(phone.putMeal(id, { ...metadata, time_zone: "Europe/Dublin" }), isProblem(409, "meal_id_reused"));

const statuses = [];
meal = await phone.waitForEstimate(id, { onChange: (now) => statuses.push(now.status) });
assert.equal(meal.status, "estimated");
assert.equal(statuses.at(-1), "estimated");
assert.equal(await phone.getMeal(id, { knownVersion: meal.version }), null);
assert.equal((await phone.getPhotograph(id, "left", { width: 320 })).type, "image/jpeg");
assert.ok((await phone.getArtefact(id, meal.run.artefacts[0].name)).size > 0);

const [food] = await phone.searchFoods("apple", { limit: 5 });
assert.ok((await phone.getFood(food.key)).key);
const event = { id: newId(), kind: "confirm", item: meal.items[0].id };
const confirmed = await phone.sendEvent(meal, event);
assert.equal(confirmed.status, "confirmed");
assert.equal((await phone.sendEvent(meal, event)).version, confirmed.version);
await assert.rejects(phone.sendEvent(meal, { kind: "reject", item: event.item }), isProblem(412, "precondition_failed"));
meal = await phone.sendEvent(confirmed, { kind: "set_mass", item: event.item, mass_g: 150 });
assert.equal(meal.items[0].mass_g, 150);
assert.deepEqual(await phone.getQuestions(), []);

meal = await phone.sendAfter(id, { captured_at: "2026-11-20T12:50:00+00:00" }, { after_left: left, after_right: right });
meal = await phone.waitForEstimate(id, { pair: "after" });
assert.ok(["estimated", "needs_review", "failed"].includes(meal.after.status), meal.after.status);

const declared = { id: newId(), captured_at: "2026-11-20T08:00:00+00:00", time_zone: "Europe/London", items: [{ food: "banana" }] };
await phone.declareMeal(declared);
const listed = [];
for await (const each of phone.listMeals({ limit: 1, order: "oldest" })) listed.push(each.id);
assert.deepEqual(listed, [declared.id, id]);

const [day] = await phone.getDays({ from: "2026-11-20", to: "2026-11-20" });
assert.equal(day.meals, 2);
const closed = await phone.putDay(day, { status: "closed" });
assert.equal(closed.status, "closed");
assert.equal((await phone.getSummary({ date: day.date })).date, day.date);

const keys = { p256dh: createECDH("prime256v1").generateKeys("base64url"), auth: randomBytes(16).toString("base64url") };
const subscription = { endpoint: "https://push.example.org/send/1", keys };
assert.deepEqual((await phone.putReminders({ subscription, times: ["12:30"], time_zone: "Europe/London" })).times, ["12:30"]);
await phone.deleteReminders();
assert.equal((await phone.getReminders()).subscribed, false);

assert.equal((await phone.getMyExport()).type, "application/zip");
const receipt = await phone.deleteMeal(declared.id);
assert.equal(receipt.what, "meal");
assert.deepEqual(await phone.deleteMeal(declared.id), receipt);
await assert.rejects(phone.getMeal(declared.id), isProblem(410, "meal_deleted"));
const left_study = await phone.withdraw();
assert.equal(left_study.what, "participant");
assert.deepEqual(await phone.getReceipt(left_study.id), left_study);
assert.deepEqual(await phone.withdraw(), left_study);
await assert.rejects(phone.getMe(), isProblem(410, "withdrawn"));
console.log("done");
