/**
 * A meal of one large photograph by clients/typescript over a line that breaks; see test_typescript_client.py.
 *
 * node typescript_large_photograph.mjs SERVER TOKEN FOLDER_OF_PHOTOGRAPHS; prints the meal's id and the photograph's digest
 */

import { createHash } from "node:crypto";
import { readFile } from "node:fs/promises";
import path from "node:path";

import { TadaClient, newId } from "../../../clients/typescript/src/index.js";

const [server, token, folder] = process.argv.slice(2);
const phone = new TadaClient({ server, token, retries: { firstSeconds: 0.01 } });
const left = Buffer.concat([await readFile(path.join(folder, "left.jpg")), Buffer.alloc(5 * 1024 ** 2, "0123456789")]);
const id = newId();
const metadata = { captured_at: "2026-11-20T12:20:00Z", time_zone: "Europe/London", views: 1 };
const meal = await phone.sendMeal(id, metadata, { left: new Blob([left]) });
if (!meal.images.left.durable) throw new Error("not durable");
console.log(JSON.stringify({ id, sha256: createHash("sha256").update(left).digest("hex") }));
