/**
 * Meals of two photographs by clients/typescript over a line that drops requests; see test_typescript_client.py.
 *
 * node typescript_meals.mjs SERVER TOKEN FOLDER_OF_PHOTOGRAPHS COUNT; prints the meals' ids as JSON
 */

import { readFile } from "node:fs/promises";
import path from "node:path";

import { TadaClient, newId } from "../../../clients/typescript/src/index.js";

const [server, token, folder, count] = process.argv.slice(2);
const phone = new TadaClient({ server, token, retries: { firstSeconds: 0.01 } });
const [left, right] = await Promise.all(["left", "right"].map((side) => readFile(path.join(folder, `${side}.jpg`))));
const ids = [];
for (let number = 0; number < Number(count); number++) {
  const id = newId();
  const photographs = { left: Buffer.concat([left, Buffer.of(number)]), right: Buffer.concat([right, Buffer.of(number)]) };
  const metadata = { captured_at: `2026-11-20T12:${String(number).padStart(2, "0")}:00Z`, time_zone: "Europe/London" };
  const meal = await phone.sendMeal(id, metadata, photographs);
  if (meal.missing.length) throw new Error(`still missing: ${meal.missing}`);
  await phone.cancelEstimate(id);
  ids.push(id);
}
console.log(JSON.stringify(ids));
