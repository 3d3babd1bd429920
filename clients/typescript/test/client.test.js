import assert from "node:assert/strict";
import http from "node:http";
import { after, before, beforeEach, test } from "node:test";

import { NetworkError, Problem, TadaClient, copyItems, newId } from "../src/index.js";

/** Requests as they arrived, and what the server does with the next ones: a function of request and response each. */
const requests = [];
let answers = [];
let server;
let address;

before(async () => {
  server = http.createServer(async (request, response) => {
    const chunks = [];
    for await (const chunk of request) chunks.push(chunk);
    requests.push({ method: request.method, url: request.url, headers: request.headers, body: Buffer.concat(chunks) });
    const answer = answers.shift() ?? json(500, { code: "no_answer_left", retryable: false });
    answer(response);
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  address = `http://127.0.0.1:${server.address().port}`;
});
after(() => {
  server.closeAllConnections();
  server.close();
});
beforeEach(() => {
  requests.length = 0;
  answers = [];
});

const json = (status, document, headers = {}) => (response) => {
  const type = status >= 400 ? "application/problem+json" : "application/json";
  response.writeHead(status, { "Content-Type": type, ...headers }).end(JSON.stringify(document));
};
const cut = (response) => response.destroy();
const cutInside = (response) => {
  response.writeHead(200, { "Content-Type": "application/json", "Content-Length": 100 }).write('{"items": [');
  setTimeout(() => response.destroy(), 20);
};
const phone = (options = {}) =>
  new TadaClient({ server: address, token: "secret", retries: { firstSeconds: 0.001 }, ...options });

test("token goes into the header and never into an address", async () => {
  answers = [json(200, {}), json(200, { items: [] })];
  await phone({ appVersion: "app 3" }).getMe();
  await phone().searchFoods("crème & co", { limit: 3 });
  assert.equal(requests[0].headers.authorization, "Bearer secret");
  assert.equal(requests[0].headers["x-app-version"], "app 3");
  assert.ok(Math.abs(Date.parse(requests[0].headers.date) - Date.now()) < 60_000);
  assert.equal(requests[1].url, "/v1/foods?q=cr%C3%A8me%20%26%20co&limit=3");
  assert.ok(requests.every((request) => !request.url.includes("secret")));
});

test("lost, broken off and refused attempts are repeated with the same bytes", async () => {
  answers = [cut, cutInside, json(503, { code: "server_busy", retryable: true }, { "Retry-After": "0" }), (r) => r.writeHead(502).end("proxy"), json(202, { missing: [] })];
  const bytes = new Uint8Array([1, 2, 3]);
  assert.deepEqual(await phone().putPhotograph("m", "left", bytes), { missing: [] });
  assert.equal(requests.length, 5);
  for (const request of requests) {
    assert.equal(`${request.method} ${request.url}`, "PUT /v1/meals/m/images/left");
    assert.deepEqual([...request.body], [1, 2, 3]);
  }
});

test("lasting refusal is thrown at once, as the problem that it is", async () => {
  answers = [json(413, { code: "image_too_large", detail: "Too large.", status: 413, retryable: false, slot: "left", limit_bytes: 5 })];
  await assert.rejects(phone().putPhotograph("m", "left", new Uint8Array(9)), (error) => {
    assert.ok(error instanceof Problem);
    assert.deepEqual([error.status, error.code, error.detail, error.message, error.retryable], [413, "image_too_large", "Too large.", "Too large.", false]);
    assert.equal(error.document.limit_bytes, 5);
    return true;
  });
  assert.equal(requests.length, 1);
});

test("long Retry-After is thrown for the app's own queue", async () => {
  answers = [json(429, { code: "rate_limited", retryable: true }, { "Retry-After": "3600" })];
  await assert.rejects(phone().getMe(), (error) => error.retryAfterSeconds === 3600 && error.retryable);
  assert.equal(requests.length, 1);
});

test("without a server a NetworkError comes after the last attempt", async () => {
  let calls = 0;
  const fetch = async () => {
    calls += 1;
    throw new TypeError("fetch failed");
  };
  await assert.rejects(phone({ fetch, retries: { attempts: 3, firstSeconds: 0 } }).getMe(), NetworkError);
  assert.equal(calls, 3);
});

test("silent server ends an attempt by its time limit, and the next one may succeed", async () => {
  answers = [() => {}, ...Array(4).fill(json(200, { participant: "P001" }))]; // several: this machine may be slow
  assert.equal((await phone().getMe({ seconds: 0.2 })).participant, "P001");
  assert.ok(requests.length >= 2);
});

test("caller's signal ends a call with its reason, during an attempt and during a pause", async () => {
  answers = [() => {}];
  const first = new AbortController();
  setTimeout(() => first.abort(new Error("left the page")), 50);
  await assert.rejects(phone().getMe({ signal: first.signal }), /left the page/);
  const second = new AbortController();
  answers = [json(503, { code: "unavailable", retryable: true }, { "Retry-After": "30" })];
  setTimeout(() => second.abort(new Error("left the page")), 50);
  await assert.rejects(phone({ signal: second.signal }).getMe(), /left the page/);
  assert.equal(requests.length, 2);
});

test("only photographs that the server lacks are read and sent, one at a time", async () => {
  const meal = (missing) => json(202, { id: "m", missing, images: {} });
  answers = [meal(["right", "view3"]), meal(["view3"]), meal([])];
  const read = [];
  const photographs = Object.fromEntries(
    ["left", "right", "view3"].map((slot) => [slot, async () => (read.push([slot, requests.length]), new Blob([slot]))]),
  );
  await phone().sendMeal("m", { captured_at: "", time_zone: "" }, photographs);
  assert.deepEqual(read, [["right", 1], ["view3", 2]]);
  assert.deepEqual(requests.map((each) => String(each.body)).slice(1), ["right", "view3"]);
});

test("photograph that the app has not got is a plain error", async () => {
  answers = [json(202, { id: "m", missing: ["right"], images: {} })];
  await assert.rejects(phone().sendMeal("m", { captured_at: "", time_zone: "" }, {}), /right/);
});

test("estimate is awaited by the version that is known", async () => {
  const meal = (version, status) => json(200, { id: "m", version, status }, { ETag: `"${version}"` });
  answers = [meal(3, "queued"), (r) => setTimeout(() => r.writeHead(304).end(), 5), meal(4, "processing"), meal(6, "estimated")];
  const seen = [];
  const estimated = await phone().waitForEstimate("m", { onChange: (now) => seen.push(now.status) });
  assert.equal(estimated.version, 6);
  assert.deepEqual(seen, ["queued", "processing", "estimated"]);
  assert.deepEqual(requests.map((each) => [each.url, each.headers["if-none-match"]]), [
    ["/v1/meals/m", undefined],
    ["/v1/meals/m?wait=25", '"3"'],
    ["/v1/meals/m?wait=25", '"3"'],
    ["/v1/meals/m?wait=25", '"4"'],
  ]);
});

test("event has one id over its attempts, and the version that was shown", async () => {
  answers = [cut, json(201, { id: "m", version: 8 })];
  await phone().sendEvent({ id: "m", version: 7 }, { kind: "confirm", item: "i" });
  const [first, second] = requests.map((each) => JSON.parse(String(each.body)));
  assert.deepEqual(first, second);
  assert.match(first.id, /^[0-9a-f-]{36}$/);
  assert.equal(requests[1].headers["if-match"], '"7"');
});

test("pages are followed to the last", async () => {
  answers = [json(200, { items: [{ id: "a" }], next: "/v1/meals?cursor=x" }), json(200, { items: [{ id: "b" }], next: null })];
  const ids = [];
  for await (const each of phone().listMeals({ limit: 1 })) ids.push(each.id);
  assert.deepEqual(ids, ["a", "b"]);
  assert.deepEqual(requests.map((each) => each.url), ["/v1/meals?limit=1", "/v1/meals?cursor=x"]);
});

test("addresses and ids that would lead elsewhere are refused before anything is sent", async () => {
  for (const server of ["tada.example.org", "https://me:pw@host", "https://host?x=1", "https://host#a", "ftp://host"]) {
    assert.throws(() => new TadaClient({ server }), TypeError, server);
  }
  assert.equal(new TadaClient({ server: "https://host/tada/" }).server, "https://host/tada");
  answers = [json(200, {})];
  await phone().getMeal("../me?x#y");
  assert.equal(requests[0].url, "/v1/meals/..%2Fme%3Fx%23y");
  assert.throws(() => phone().getMeal(".."), TypeError);
  await assert.rejects(phone().request("GET", "//elsewhere.example"), TypeError);
  assert.equal(requests.length, 1);
});

test("new id is a random UUID, also without randomUUID", () => {
  const uuid = /^[0-9a-f]{8}-[0-9a-f]{4}-4[0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}$/;
  assert.match(newId(), uuid);
  const randomUUID = crypto.randomUUID;
  Object.defineProperty(crypto, "randomUUID", { value: undefined, configurable: true });
  try {
    const ids = new Set(Array.from({ length: 500 }, newId));
    assert.equal(ids.size, 500);
    for (const id of ids) assert.match(id, uuid);
  } finally {
    Object.defineProperty(crypto, "randomUUID", { value: randomUUID, configurable: true });
  }
});

test("enrolment has a secret of its own, and a server that knows none is asked without", async () => {
  const unknown = { code: "invalid_input", errors: [{ at: "body.secret", message: "Extra inputs are not permitted", type: "extra_forbidden" }] };
  answers = [cut, json(422, unknown), json(201, { token: "t" })];
  await phone().enrol({ code: "c", device_name: "d" });
  const [first, again, without] = requests.map((request) => JSON.parse(request.body));
  assert.ok(first.secret.length >= 43);
  assert.deepEqual(again, first);
  assert.deepEqual(without, { code: "c", device_name: "d" });
  answers = [json(422, { code: "invalid_input", errors: [{ at: "body.code", type: "string_too_long" }] })];
  await assert.rejects(phone().enrol({ code: "c".repeat(200), device_name: "d" }), { code: "invalid_input" });
});

test("erasure whose answer was lost returns the receipt that the refusal names", async () => {
  answers = [json(410, { code: "meal_deleted", receipt: "r" }), json(200, { id: "r" }), json(410, { code: "meal_deleted" })];
  assert.deepEqual(await phone().deleteMeal("m"), { id: "r" });
  await assert.rejects(phone().deleteMeal("m"), { code: "meal_deleted" }); // an older server
});

test("phone whose token has ended is signed out", async () => {
  const signing = phone();
  answers = [cut, json(401, { code: "unauthenticated" })];
  await signing.signOut();
  assert.equal(signing.token, null);
});

test("refusal that breaks off is asked for again", async () => {
  const cutRefusal = (response) => {
    response.writeHead(412, { "Content-Type": "application/problem+json", "Content-Length": 100 }).write('{"code": "preco');
    setTimeout(() => response.destroy(), 20);
  };
  answers = [cutRefusal, json(412, { code: "precondition_failed" })];
  await assert.rejects(phone().getMe(), { code: "precondition_failed" });
  assert.equal(requests.length, 2);
});

test("withdrawal whose answer was lost returns the receipt that the refusal names", async () => {
  answers = [json(410, { code: "withdrawn", receipt: "r" }), json(200, { id: "r" }), json(410, { code: "withdrawn" })];
  assert.deepEqual(await phone().withdraw(), { id: "r" });
  assert.equal(requests[1].url, "/v1/receipts/r");
  await assert.rejects(phone().withdraw(), { code: "withdrawn" });
});

const LARGE = new Uint8Array(3 * 1024 ** 2).fill(7);
const at = (offset, length = LARGE.length) => (response) =>
  response.writeHead(204, { "Upload-Offset": String(offset), "Upload-Length": String(length) }).end();
const DIGEST = Buffer.from(await crypto.subtle.digest("SHA-256", LARGE));
const withPhotograph = (sha256) => ({ id: "m", images: { left: { durable: true, received_sha256: sha256 } }, after: null });
const SENT = withPhotograph(DIGEST.toString("hex"));
const sentTo = () => requests.map(({ method, url, headers, body }) => [method, url.split("/").at(-1), headers["upload-offset"], body.length]);

test("large photograph goes in pieces, and continues at the server's offset", async () => {
  answers = [json(404, { code: "upload_unknown" }), (r) => r.writeHead(201).end(), cut, at(1000), at(0), at(0), json(200, SENT)];
  assert.deepEqual(await phone().putPhotograph("m", "left", new Blob([LARGE])), SENT);
  const piece = 2 * 1024 ** 2;
  assert.deepEqual(sentTo(), [
    ["GET", "upload", undefined, 0],
    ["POST", "upload", undefined, 0],
    ["PATCH", "upload", "0", piece],
    ["GET", "upload", undefined, 0],
    ["PATCH", "upload", "1000", piece],
    ["PATCH", "upload", String(piece + 1000), LARGE.length - piece - 1000],
    ["GET", "m", undefined, 0],
  ]);
  assert.equal(requests[1].headers["upload-length"], String(LARGE.length));
  assert.equal(requests[5].headers["repr-digest"], `sha-256=:${DIGEST.toString("base64")}:`);
});

test("upload that was begun before a reload continues", async () => {
  answers = [at(2 * 1024 ** 2), at(0), json(200, SENT)];
  await phone().putPhotograph("m", "left", LARGE);
  assert.deepEqual(sentTo()[1], ["PATCH", "upload", String(2 * 1024 ** 2), 1024 ** 2]);
});

for (const [name, length] of [["longer", LARGE.length + 1], ["shorter", LARGE.length - 1]]) {
  test(`upload of a ${name} photograph is begun anew`, async () => {
    answers = [at(LARGE.length - 2, length), (r) => r.writeHead(201).end(), at(0), at(0), json(200, SENT)];
    assert.deepEqual(await phone().putPhotograph("m", "left", LARGE), SENT);
    assert.deepEqual(sentTo().slice(1, 3), [
      ["POST", "upload", undefined, 0],
      ["PATCH", "upload", "0", 2 * 1024 ** 2],
    ]);
  });
}

test("photograph whose upload was begun with other bytes is sent whole", async () => {
  for (const refusal of [
    [json(409, { code: "upload_digest_differs", retryable: false }), json(404, { code: "upload_unknown" }), json(200, { id: "m", images: {}, after: null })],
    [at(0), json(200, withPhotograph("0".repeat(64)))], // by a server that knows no Repr-Digest, which will refuse it
  ]) {
    answers = [at(2 * 1024 ** 2), ...refusal, json(202, SENT)];
    assert.deepEqual(await phone().putPhotograph("m", "left", LARGE), SENT);
    assert.deepEqual(sentTo().at(-1), ["PUT", "left", undefined, LARGE.length]);
  }
});

test("answer without an upload's state, as of a network's sign-in page, is a NetworkError", async () => {
  const portal = (headers) => (response) => response.writeHead(200, { "Content-Type": "application/json", ...headers }).end("{}");
  for (const headers of [{}, { "Upload-Offset": "", "Upload-Length": "5" }, { "Upload-Offset": "x", "Upload-Length": "5" }, { "Upload-Offset": "0" }]) {
    answers = [portal(headers)];
    await assert.rejects(phone().putPhotograph("m", "left", LARGE), NetworkError);
  }
  assert.ok(requests.every(({ method }) => method === "GET"));
});

test("where no digest can be computed a photograph in pieces is not sent again", async () => {
  const subtle = Object.getOwnPropertyDescriptor(Crypto.prototype, "subtle");
  Object.defineProperty(Crypto.prototype, "subtle", { value: undefined, configurable: true });
  try {
    answers = [at(2 * 1024 ** 2), at(0), json(200, SENT)];
    assert.deepEqual(await phone().putPhotograph("m", "left", LARGE), SENT);
    assert.equal(requests[1].headers["repr-digest"], undefined);
  } finally {
    Object.defineProperty(Crypto.prototype, "subtle", subtle);
  }
});

for (const [name, refusals] of [
  ["knows no pieces", [json(404, { code: "not_found" }), json(405, { code: "method_not_allowed" })]],
  ["takes no more of them", [json(404, { code: "upload_unknown" }), json(409, { code: "uploads_too_many" })]],
]) {
  test(`large photograph is sent whole to a server that ${name}`, async () => {
    answers = [...refusals, json(202, { missing: [] })];
    await phone().putPhotograph("m", "left", LARGE);
    assert.deepEqual(sentTo().at(-1), ["PUT", "left", undefined, LARGE.length]);
  });
}

test("lost last answer is made up for by the photograph's digest, which must be its own", async () => {
  for (const [sha256, requestsAtLast] of [[DIGEST.toString("hex"), "GET"], ["0".repeat(64), "PUT"]]) {
    const meal = withPhotograph(sha256);
    answers = [at(2 * 1024 ** 2), cut, json(404, { code: "upload_unknown" }), json(200, meal), json(200, meal)];
    assert.deepEqual(await phone().putPhotograph("m", "left", LARGE), meal);
    assert.equal(requests.at(-1).method, requestsAtLast);
  }
});

test("attempts that bring a photograph no further are counted, others are not", async () => {
  const broken = [1, 2, 3, 4].flatMap((number) => [cut, at(number * 1000)]);
  answers = [at(0), ...broken, cut, at(4000), cut];
  await assert.rejects(phone({ retries: { attempts: 2, firstSeconds: 0 } }).putPhotograph("m", "left", LARGE), NetworkError);
  assert.equal(answers.length, 0);
});

test("barcode is read by the platform where it can, else by the server", async () => {
  const photograph = new Blob(["pack"]);
  answers = [json(200, { key: "off:1" }), json(200, { key: "off:2" }), json(200, { key: "off:3" })];
  assert.equal((await phone().findPackagedFood(photograph)).key, "off:1");
  let codes = [{ rawValue: "3017620422003" }];
  globalThis.createImageBitmap = async () => ({});
  globalThis.BarcodeDetector = class {
    detect = async () => codes;
  };
  try {
    assert.equal((await phone().findPackagedFood(photograph)).key, "off:2");
    codes = [...codes, { rawValue: "96385074" }];
    assert.equal((await phone().findPackagedFood(photograph)).key, "off:3");
  } finally {
    delete globalThis.createImageBitmap;
    delete globalThis.BarcodeDetector;
  }
  assert.deepEqual(requests.map(({ method, url }) => `${method} ${url}`), [
    "POST /v1/barcodes",
    "GET /v1/packaged-foods/3017620422003",
    "POST /v1/barcodes",
  ]);
  assert.equal(requests[0].body.toString(), "pack");
});

test("copy of a meal has what was eaten, by a factor and with its doubt, and is marked", () => {
  const item = { status: "confirmed", food: { key: "apple" }, consumed_g: 100, consumed_interval_g: [90, 111] };
  const copied = (changes, factor) => copyItems({ items: [{ ...item, ...changes }] }, factor);
  assert.deepEqual(copied({}, 0.5), [{ food: "apple", amount: { mass_g: 50, of: "edible", relative_sd: 0.25 }, copied: true }]);
  assert.ok(Math.abs(copied({ consumed_interval_g: [50, 200] })[0].amount.relative_sd - 0.421) < 0.001);
  assert.deepEqual(copied({ consumed_g: null, consumed_interval_g: null }), [{ food: "apple", copied: true }]);
  for (const left of [{ status: "rejected" }, { food: null }, { consumed_g: 0 }]) assert.deepEqual(copied(left), []);
});
