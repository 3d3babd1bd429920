// The first page: take a meal, and what became of those that were taken.

import { button, h, picture } from "../dom.js";
import { isUnsent, noteEnd, retryNow, sendWaiting } from "../sender.js";
import * as store from "../store.js";
import { sentenceOf } from "../texts.js";
import { refreshPhone } from "./enrol.js";

const LOW_ROOM_BYTES = 100 * 2 ** 20;
const SERVER_MEALS = 20;
const THUMBNAIL_PX = 320; // a width that the server keeps
const KEPT_MS = 86_400_000; // in this list, after a meal was sent
const FOLLOW_MS = 5000; // while a meal is on its way to an estimate
const ON_ITS_WAY = new Set(["receiving", "queued", "processing"]);

export async function showMeals(main, { t, phone, client, go }) {
  const list = h("ul", { class: "meals" });
  const notices = h("div", { role: "status" });
  const welcome = h("section");
  let sent = []; // of the server, newest first

  async function render() {
    const owner = store.ownerOf(phone);
    const meals = (await store.meals()).filter((meal) => meal.owner === owner || meal.state !== "sent");
    const here = new Set(meals.filter((meal) => meal.part === "meal").map((meal) => meal.id));
    const rows = [
      ...meals.map((meal) => ({ at: meal.captured_at ?? meal.created_ms, element: rowOfPhone(t, meal, meal.owner === owner, sent.find((other) => other.id === meal.id)) })),
      ...sent.filter((meal) => !here.has(meal.id)).map((meal) => ({ at: meal.captured_at, element: rowOfServer(t, meal, thumbnails.get(meal.id)) })),
    ];
    rows.sort((a, b) => new Date(b.at) - new Date(a.at));
    list.replaceChildren(...rows.map((row) => row.element));
    welcome.replaceChildren(...(rows.length ? [] : welcomeParts(t, phone)));
    const waiting = meals.filter(isUnsent).length;
    const { free_bytes, persisted } = await store.room();
    notices.replaceChildren(
      ...(waiting && !navigator.onLine ? [h("p", { class: "offline" }, t("offline", { count: waiting }))] : []),
      ...[
        free_bytes !== null && free_bytes < LOW_ROOM_BYTES && t("storage_low"),
        persisted === false && waiting && t("storage_not_persisted"),
      ]
        .filter(Boolean)
        .map((text) => h("p", { class: "notice" }, text)),
    );
  }

  main.append(
    h("h1", {}, t("meals")),
    h("p", { class: "who" }, t("who", { participant: phone.participant, study: phone.name ?? phone.study })),
    ...(phone.sandbox ? [h("p", { class: "notice" }, t("sandbox"))] : []),
    welcome,
    button(t("take_meal"), () => go("take"), { kind: "main large" }),
    notices,
    list,
  );
  const stop = new AbortController();
  const thumbnails = new Map(); // meal -> Blob, of meals that were sent by another phone or long ago
  let timer;
  store.onChange(render, stop.signal);
  await render();
  refreshPhone(client, phone);
  follow();
  return () => {
    stop.abort();
    clearTimeout(timer);
  };

  // Offline the phone's own list stays.
  async function follow() {
    try {
      await readServer();
    } catch (error) {
      if (await noteEnd(error, phone)) return go("enrol");
    }
    const isPending = sent.some((meal) => ON_ITS_WAY.has(meal.status)) || (await store.meals()).some(isUnsent);
    if (isPending && !stop.signal.aborted) timer = setTimeout(follow, FOLLOW_MS);
  }

  async function readServer() {
    const listed = [];
    for await (const meal of client.listMeals({ order: "newest", limit: SERVER_MEALS }, { signal: stop.signal })) {
      listed.push(meal);
      if (listed.length >= SERVER_MEALS) break;
    }
    sent = listed;
    const serverIds = new Set(sent.map((meal) => meal.id));
    for (const meal of await store.meals()) {
      const isOld = meal.created_ms < Date.now() - KEPT_MS;
      if (meal.state === "sent" && isOld && !serverIds.has(meal.id)) await store.deleteMeal(meal.id);
    }
    if (stop.signal.aborted) return;
    await render();
    for (const { id, links } of sent) {
      if (thumbnails.has(id) || (await store.meal(id)) || !links.photograph_left) continue;
      thumbnails.set(id, await client.getPhotograph(id, "left", { width: THUMBNAIL_PX, signal: stop.signal }));
      await render();
    }
  }
}

// Before the first meal: whose study it is, what to photograph, and what becomes of it.
function welcomeParts(t, phone) {
  const { participant, name, study, retention_days: days, withdrawal_policy, location_policy } = phone;
  const photographs = () => (days === null ? t("privacy_photographs_kept") : t("privacy_photographs_deleted", { days }));
  const policies = () => [photographs(), t(`privacy_place_${location_policy}`), t(`privacy_leave_${withdrawal_policy}`)];
  const isRead = withdrawal_policy !== undefined; // not if the server could not be asked when the person joined
  return [
    h("h2", {}, t("welcome", { study: name ?? study })),
    h("img", { class: "welcome", src: "plate_and_board.svg", alt: t("welcome_picture") }),
    h("p", {}, t("first_explain")),
    h("p", { class: "who" }, [t("privacy", { participant }), ...(isRead ? policies() : [])].join(" ")),
  ];
}

function rowOfPhone(t, record, isOwn, server) {
  const isAfter = record.part === "after";
  const state = server ? server.status : record.state === "waiting" && record.problem ? "waiting_problem" : record.state;
  const address = record.state === "draft" ? `#take/${record.id}` : record.state === "sent" ? `#meal/${record.id}` : null;
  const title = time(record.captured_at ?? record.created_ms);
  return h(
    "li",
    { "data-meal": record.id, "data-state": record.state },
    record.thumbnail && isOwn ? picture(store.blobOf(record.thumbnail), "") : h("span", { class: "no-picture" }),
    h(
      "div",
      {},
      address && isOwn ? h("a", { href: address }, title) : h("strong", {}, title),
      isAfter ? h("p", {}, t(record.all_eaten ? "all_eaten" : "after_pair")) : null,
      record.part === "review" ? h("p", {}, t("confirm")) : null,
      h("p", {}, isOwn ? t(`state_${state}`) : t("state_other_person")),
      foods(server),
      record.problem && isOwn ? problem(t, record) : null,
      record.is_note_refused && isOwn ? h("p", { class: "problem" }, t("voice_refused")) : null,
      record.state === "waiting" || record.state === "refused" || !isOwn ? actions(t, record, isOwn) : null,
    ),
  );
}

function problem(t, record) {
  if (record.problem.code === "network") return h("p", { class: "offline" }, t("problem_network"));
  return h("p", { class: "problem" }, sentenceOf({ retryable: record.state === "waiting", ...record.problem }, t));
}

function actions(t, meal, isOwn) {
  return h(
    "div",
    { class: "actions" },
    isOwn ? button(t("send_now"), async () => { await retryNow(meal.id); await sendWaiting(); }) : null,
    isOwn && meal.slots.length ? button(t("save_photographs"), () => savePhotographs(meal)) : null,
    meal.state === "refused" || !isOwn ? button(t("delete_here"), () => confirm(t("delete_here_confirm")) && store.deleteMeal(meal.id), { kind: "danger" }) : null,
  );
}

// The person can give the study by hand the photographs that the server does not accept.
async function savePhotographs(meal) {
  for (const slot of meal.slots) {
    const kept = await store.photograph(meal.id, slot);
    if (!kept) continue;
    const address = URL.createObjectURL(store.blobOf(kept));
    h("a", { href: address, download: `${meal.meal}-${slot}.${kept.type.split("/")[1] ?? "jpg"}` }).click();
    setTimeout(() => URL.revokeObjectURL(address), 60_000);
  }
}

function rowOfServer(t, meal, thumbnail) {
  return h("li", { "data-meal": meal.id }, thumbnail ? picture(thumbnail, "") : h("span", { class: "no-picture" }), h("div", {}, h("a", { href: `#meal/${meal.id}` }, time(meal.captured_at)), h("p", {}, t(`state_${meal.status}`)), foods(meal)));
}

const foods = (meal) => (meal?.foods?.length ? h("p", { class: "foods" }, meal.foods.map((food) => food.name).join(" · ")) : null);

const time = (instant) => new Date(instant).toLocaleString(document.documentElement.lang, { weekday: "short", day: "numeric", month: "short", hour: "2-digit", minute: "2-digit" });
