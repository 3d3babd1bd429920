/**
 * What an app does that passes `tada conformance serve`, by clients/typescript; see test_conformance_of_apps.py.
 *
 * node typescript_conformance.mjs SERVER CODE FOLDER_OF_PHOTOGRAPHS
 */

import { readFile } from "node:fs/promises";
import path from "node:path";

import { TadaClient, newId } from "../../../clients/typescript/src/index.js";

const [server, code, folder] = process.argv.slice(2);
const phone = new TadaClient({ server });
await phone.enrol({ code, device_name: "typescript client" });

const meals = [];
for (const pair of ["", "salad_pear"]) {
  const photograph = (side) => () => readFile(path.join(folder, pair, `${side}.jpg`));
  const metadata = { captured_at: "2026-11-20T12:30:00+08:00", time_zone: "Asia/Shanghai" };
  meals.push(await phone.sendMeal(newId(), metadata, { left: photograph("left"), right: photograph("right") }));
}
let meal = await phone.waitForEstimate(meals[0].id);
const [item] = meal.items;
const event = { id: newId(), kind: "set_food", food: item.candidates[0].food.key, item: item.id };
try {
  await phone.sendEvent(meal, event);
  throw new Error("the first change was to be refused");
} catch (error) {
  if (error.code !== "precondition_failed") throw error;
  meal = await phone.getMeal(meal.id);
}
await phone.sendEvent(meal, event);
await phone.deleteMeal(meals[1].id);
