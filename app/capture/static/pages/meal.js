// One meal as the server sees it: the foods over the photograph, to be confirmed or corrected, and what was left.

import { newId } from "../client/index.js";
import { button, h, svg } from "../dom.js";
import * as store from "../store.js";
import { showSentence } from "../texts.js";
import { localInstant, newDraft } from "./take.js";

const PICTURE_PX = 1024;
const MOST_EVENTS = 1000; // of a meal
const CANDIDATES = 4;
const FOUND_FOODS = 8;
const TYPING_MS = 250;
const TRY_AGAIN_MS = 5000;
const LARGEST_PORTION = 3; // of the slider: times the measured grams
const OPEN = new Set(["proposed", "needs_review", "confirmed", "corrected"]); // an item that is part of the meal
const AFTER_OPEN = new Set([null, "failed"]); // the after-meal pair can be photographed
const EATEN_OPEN = new Set([...AFTER_OPEN, "receiving"]); // the person can say that nothing was left

export async function showMeal(main, { t, phone, client, go }, id) {
  const stop = new AbortController();
  const status = h("p", { role: "status" });
  const following = h("p", { role: "alert" }); // why the meal cannot be read
  const alert = h("p", { role: "alert" }); // why the person's last change failed
  const photograph = h("div", { class: "stage" });
  const items = h("ol", { class: "items" });
  const notes = h("div");
  const eaten = h("div", { role: "status" });
  const actions = h("div", { class: "actions" });
  let meal = null;
  let ownEvents = []; // the participant's events of the meal that were not undone
  const afterId = `${id}/after`;
  const reviewId = `${id}/review`;
  let waitingAfter = await readWaitingAfter();
  let waitingEvents = (await store.meal(reviewId))?.events ?? []; // confirmations without a network
  main.append(h("h1", {}, t("meal")), status, following, alert, photograph, notes, items, eaten, actions);
  store.onChange(noteAfter, stop.signal);
  store.onChange(noteEvents, stop.signal);
  follow().catch(showProblem);
  return () => stop.abort();

  // Until nothing waits for an estimate. A server that is away for a while, or a network, ends only this try.
  async function follow() {
    const kept = await store.meal(id);
    if (kept?.thumbnail) await showPicture(store.blobOf(kept.thumbnail));
    while (!stop.signal.aborted) {
      try {
        return void (await client.waitForEstimate(id, { signal: stop.signal, onChange: showFresh }));
      } catch (error) {
        if (stop.signal.aborted) return;
        showSentence(following, error, t);
        if (error.name !== "NetworkError" && !error.retryable) return;
        await new Promise((resolve) => setTimeout(resolve, TRY_AGAIN_MS));
      }
    }
  }

  async function showFresh(fresh) {
    following.textContent = "";
    await render(fresh);
  }

  async function render(fresh) {
    if (stop.signal.aborted) return;
    const isFirst = meal === null;
    const isRead = meal?.version === fresh.version;
    meal = fresh;
    const failure = meal.failure?.localised?.[document.documentElement.lang] ?? meal.failure?.message;
    status.textContent = failure ?? t(`state_${meal.status}`);
    const parts = meal.items.filter((item) => OPEN.has(item.status));
    items.replaceChildren(...parts.map((item, index) => card(item, index + 1)));
    const isDone = ["estimated", "needs_review", "failed", "confirmed"].includes(meal.status);
    actions.replaceChildren(...(isDone ? mealActions(parts) : []));
    showEaten();
    if (!isRead) readOwnEvents().catch(() => {}); // offline the meal is shown without it
    if (isFirst || parts.length) await drawFoods(parts);
  }

  async function readOwnEvents() {
    const { version } = meal;
    const { body } = await client.request("GET", `/v1/meals/${id}/events`, { query: { limit: MOST_EVENTS }, signal: stop.signal });
    if (version !== meal.version) return; // those of a later version are being read
    ownEvents = body.items.filter((event) => event.layer === "participant" && !event.undone);
    const comments = ownEvents.filter((event) => event.kind === "comment");
    notes.replaceChildren(...comments.map((event) => h("p", {}, t("note_sent", { text: event.new.text }))));
    showEaten();
  }

  async function drawFoods(parts) {
    const size = meal.images.left;
    if (!size?.durable) return;
    if (!photograph.dataset.isFull) {
      const blob = await client.getPhotograph(id, "left", { width: PICTURE_PX, signal: stop.signal }).catch(() => null);
      if (!blob) return;
      await showPicture(blob);
      photograph.dataset.isFull = "true";
    }
    const shapes = parts.flatMap((item, index) => outline(item, index + 1));
    photograph.querySelector("svg")?.remove();
    photograph.append(svg("svg", { class: "outline", viewBox: `0 0 ${size.width_px} ${size.height_px}`, "aria-hidden": "true" }, ...shapes));
  }

  async function showPicture(blob) {
    const image = h("img", { alt: t("photograph_of_meal") });
    image.src = URL.createObjectURL(blob);
    await image.decode().catch(() => {});
    photograph.replaceChildren(image);
    stop.signal.addEventListener("abort", () => URL.revokeObjectURL(image.src), { once: true });
  }

  function card(item, number) {
    const name = item.food?.name ?? t("food_unknown");
    const [low, high] = item.mass_interval_g ?? [item.mass_g, item.mass_g];
    const grams = item.mass_g === null ? t("amount_unknown") : t("grams", { grams: rounded(item.mass_g), low: rounded(low), high: rounded(high) });
    const isSettled = item.status === "confirmed" || item.status === "corrected";
    const canConfirm = item.food && item.mass_g !== null && !isSettled;
    return h(
      "li",
      { "data-item": item.id, "data-status": item.status },
      h("h2", {}, h("span", { class: "number", "aria-hidden": "true" }, String(number)), name, isSettled ? h("span", { class: "good" }, ` ✓ ${t(`item_${item.status}`)}`) : null),
      h("p", {}, grams),
      canConfirm && isWaiting(item) ? h("p", { class: "good" }, `✓ ${t("confirm")} · ${t("state_waiting")}`) : null,
      canConfirm && !isWaiting(item) ? button(t("confirm"), () => say({ kind: "confirm", item: item.id }), { kind: "main" }) : null,
      h("details", { open: !item.food }, h("summary", {}, t("correct")), ...corrections(item)),
    );
  }

  function corrections(item) {
    const chosen = (key) => say({ kind: "set_food", item: item.id, food: key });
    const candidates = item.candidates.filter((candidate) => candidate.food.key !== item.food?.key).slice(0, CANDIDATES);
    return [
      h("div", { class: "choices" }, ...candidates.map((candidate) => button(candidate.food.name, () => chosen(candidate.food.key)))),
      foodSearch(chosen),
      portion(item),
      button(t("not_a_food"), () => say({ kind: "reject", item: item.id }), { kind: "danger" }),
    ];
  }

  // Grams as seen on the plate, by slider or number; sent when the person says so.
  function portion(item) {
    const grams = Math.round(item.mass_g ?? 100);
    const name = `grams-${item.id}`;
    const slider = h("input", { type: "range", min: 0, max: Math.max(50, grams * LARGEST_PORTION), step: 1, value: grams, "aria-label": t("portion_slider") });
    const number = h("input", { type: "number", id: name, min: 1, max: 5000, step: 1, value: grams, inputmode: "numeric" });
    slider.addEventListener("input", () => (number.value = slider.value));
    number.addEventListener("input", () => (slider.value = number.value));
    const set = button(t("set_portion"), () => number.reportValidity() && say({ kind: "set_mass", item: item.id, mass_g: Number(number.value), of: "as_seen" }));
    return h("div", { class: "portion" }, h("label", { for: name }, t("portion")), slider, number, set);
  }

  function foodSearch(onChosen) {
    const name = `search-${newId()}`;
    const field = h("input", { id: name, type: "search", autocomplete: "off", enterkeyhint: "search" });
    const results = h("div", { class: "choices", role: "status" });
    let timer;
    field.addEventListener("input", () => {
      clearTimeout(timer);
      timer = setTimeout(search, TYPING_MS);
    });
    return h("div", { class: "search" }, h("label", { for: name }, t("search_food")), field, results);

    async function search() {
      const words = field.value.trim();
      const foods = words ? await client.searchFoods(words, { limit: FOUND_FOODS, signal: stop.signal }).catch(() => []) : [];
      if (field.value.trim() !== words) return; // typed on meanwhile
      results.replaceChildren(...(words && !foods.length ? [t("no_food")] : foods.map((food) => button(food.name, () => onChosen(food.key)))));
    }
  }

  function mealActions(parts) {
    const isOpen = parts.some((item) => (item.status === "proposed" || item.status === "needs_review") && !isWaiting(item));
    const isFailed = meal.status === "failed";
    const canConfirmAll = isOpen && parts.every((item) => item.food && item.mass_g !== null);
    const after = meal.after?.status ?? null;
    const isAfterLost = after === "receiving" && !Object.keys(meal.after.images).length; // announced, and nothing waits
    const expectsAfter = !waitingAfter && phone.expects_after_pair && meal.images.left;
    return [
      canConfirmAll ? button(t("confirm_all"), () => say({ kind: "confirm_meal" }), { kind: "main large" }) : null,
      isFailed ? button(t("photograph_again"), () => go("take"), { kind: "main large" }) : null,
      h("details", { open: isFailed }, h("summary", {}, t(isFailed ? "enter_eaten" : "something_missing")), addFood()),
      expectsAfter && (AFTER_OPEN.has(after) || isAfterLost) ? button(t("after_pair"), photographLeft) : null,
      expectsAfter && EATEN_OPEN.has(after) ? button(t("all_eaten"), allEaten) : null,
      button(t("erase_meal"), erase, { kind: "danger" }),
    ].filter(Boolean);
  }

  function addFood() {
    const name = `added-${id}`;
    const grams = h("input", { type: "number", id: name, min: 1, max: 5000, value: 100, inputmode: "numeric" });
    const add = (food) => grams.reportValidity() && say({ kind: "add", food, amount: { mass_g: Number(grams.value), of: "edible" } });
    return h("div", {}, h("label", { for: name }, t("grams_eaten")), grams, foodSearch(add));
  }

  async function photographLeft() {
    if (!(await mayReplaceRefused())) return;
    await store.deleteMeal(afterId, "refused");
    go(`take/${afterId}`);
  }

  // Goes by the queue, so it works offline. It takes the place of photographs that were begun, or refused.
  async function allEaten() {
    if (!(await mayReplaceRefused())) return;
    const record = { ...newDraft(phone, id), state: "waiting", captured_at: localInstant(new Date()), all_eaten: { id: newId() } };
    if (!(await store.saveDraft(record, {}, ["draft", "refused"]))) await reread(); // another tab has sent an answer meanwhile
  }

  // That all was eaten, also before it is sent, and the way back. A reviewer's word is not the person's to take back.
  function showEaten() {
    const isEaten = waitingAfter?.all_eaten || meal.after?.status === "nothing_left";
    const event = ownEvents.find((event) => event.kind === "nothing_left");
    const takeBack = waitingAfter ? takeBackWaiting : event && (() => say({ kind: "undo", event: event.id }));
    const parts = [
      h("p", { class: "good" }, `✓ ${t("all_eaten")}`),
      waitingAfter && h("p", {}, t("state_waiting")),
      takeBack && button(t("take_back"), takeBack),
    ];
    eaten.replaceChildren(...(isEaten ? parts.filter(Boolean) : []));
  }

  async function takeBackWaiting() {
    waitingAfter = null;
    await store.deleteMeal(afterId, "waiting");
    await render(meal);
  }

  async function mayReplaceRefused() {
    const record = await store.meal(afterId);
    return record?.state !== "refused" || !record.slots.length || confirm(t("delete_here_confirm"));
  }

  async function readWaitingAfter() {
    const record = await store.meal(afterId);
    return record?.state === "waiting" ? record : null;
  }

  // What was left has been sent, or waits now: show the meal as it is then.
  async function noteAfter() {
    const before = waitingAfter;
    waitingAfter = await readWaitingAfter();
    if (waitingAfter && !before && meal) await render(meal);
    if (before && !waitingAfter) await reread().catch(showProblem);
  }

  // A confirmation waits now, or was sent.
  async function noteEvents() {
    const before = waitingEvents;
    waitingEvents = (await store.meal(reviewId))?.events ?? [];
    if (waitingEvents.length > before.length && meal) await render(meal);
    if (waitingEvents.length < before.length) await reread().catch(showProblem);
  }

  async function erase() {
    if (!confirm(t("erase_confirm"))) return;
    await client.deleteMeal(id).catch((error) => {
      if (error.code !== "meal_deleted") throw error; // the answer to an earlier try was lost
    });
    await store.eraseMeal(id);
    go("meals");
  }

  function isWaiting(item) {
    return waitingEvents.some((event) => event.kind === "confirm_meal" || event.item === item.id);
  }

  // A confirmation goes by the queue where there is no network.
  async function sendOrQueue(event) {
    const canWait = event.kind.startsWith("confirm");
    const passNoNetwork = (error) => {
      if (!canWait || error.name !== "NetworkError") throw error;
    };
    const changed = canWait && !navigator.onLine ? null : await client.sendEvent(meal, event).catch(passNoNetwork);
    if (changed) return changed;
    const { captured_at, version } = meal;
    const first = { ...newDraft(phone, id), id: reviewId, part: "review", state: "waiting", captured_at, version, events: [] };
    await store.addEvent(first, event);
    return meal;
  }

  // One tap, one event. If somebody else changed the meal meanwhile, show how it is now and let the person decide anew.
  async function say(event) {
    alert.textContent = "";
    try {
      await render(await sendOrQueue({ id: newId(), strict: true, ...event }));
    } catch (error) {
      if (error.code === "implausible_amount") {
        if (confirm(t("amount_confirm"))) await say({ ...event, strict: false });
      } else if (error.code === "precondition_failed") {
        showProblem(error);
        await reread();
      } else showProblem(error);
    }
  }

  async function reread() {
    await render(await client.getMeal(id));
  }

  function showProblem(error) {
    showSentence(alert, error, t);
  }
}

function outline(item, number) {
  if (!item.polygon.length) return [];
  const path = item.polygon.map((ring) => `M${ring.map((point) => point.join(",")).join("L")}Z`).join("");
  const xs = item.polygon[0].map(([x]) => x);
  const ys = item.polygon[0].map(([, y]) => y);
  const middle = (values) => (Math.min(...values) + Math.max(...values)) / 2;
  const label = svg("text", { x: middle(xs), y: middle(ys), class: "label" }, String(number));
  return [svg("path", { d: path, "fill-rule": "evenodd", class: "food" }), label];
}

// Whole grams; below ten, two digits, since half a gram is not none.
const rounded = (grams) => grams.toLocaleString(document.documentElement.lang, Math.abs(grams) < 10 ? { maximumSignificantDigits: 2 } : { maximumFractionDigits: 0 });
