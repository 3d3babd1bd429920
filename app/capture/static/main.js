// The page's start: texts, service worker, the queue's clock, and which page is shown (the address after #).

import { h } from "./dom.js";
import { renewReminders } from "./reminders.js";
import { clientOf, nextTryMs, sendWaiting } from "./sender.js";
import * as store from "./store.js";
import { bestLanguage, loadTexts, showSentence } from "./texts.js";
import { showDays } from "./pages/days.js";
import { showEnrol } from "./pages/enrol.js";
import { showMeal } from "./pages/meal.js";
import { showMeals } from "./pages/meals.js";
import { showPhone } from "./pages/phone.js";
import { showTake } from "./pages/take.js";

const PAGES = { enrol: showEnrol, meals: showMeals, days: showDays, take: showTake, meal: showMeal, phone: showPhone };
const SYNC = "send-meals";
const LONGEST_TIMER_MS = 60_000;

const main = document.querySelector("main");
let close = () => {}; // of the page that is shown
let turn = 0; // counts pages: one whose loading takes long must not replace a later one
let timer;

addEventListener("hashchange", show);
addEventListener("online", send);
addEventListener("unhandledrejection", (event) => showError(event.reason));
document.addEventListener("visibilitychange", () => document.visibilityState === "visible" && (send(), renew()));
store.onChange(send);

if ("serviceWorker" in navigator) {
  await navigator.serviceWorker.register("service-worker.js", { type: "module" }).catch(() => {}); // an old browser: no offline start
}
await show().catch(showError);
renew();
await send();

async function show() {
  const mine = ++turn;
  const phone = await store.phone();
  const t = await textsOf(phone);
  document.querySelector("#error").hidden = true;
  const code = new URLSearchParams(location.hash.slice(1)).get("code");
  if (code) history.replaceState(null, "", "#enrol"); // the code stays out of the browser's history
  const [name, ...rest] = location.hash.slice(1).split("/");
  const page = phone?.token && !code ? (PAGES[name] ?? showMeals) : showEnrol;
  if (mine !== turn) return;
  close();
  close = () => {};
  document.title = t("title");
  document.querySelector("nav").replaceChildren(...(phone?.token ? [link("meals", t("meals")), link("days", t("days")), link("phone", t("phone_page"))] : []));
  const content = h("div"); // of this page alone: what it loads late does not appear on a later one
  main.replaceChildren(content);
  const context = { t, phone, go, client: clientOf(phone) };
  const closing = await page(content, context, ...(code ? [code] : rest));
  if (mine === turn) close = closing ?? (() => {});
  else closing?.();
  main.focus();
}

function textsOf(phone) {
  return loadTexts(bestLanguage([phone?.locale, ...navigator.languages]));
}

function go(address) {
  if (location.hash === `#${address}`) show();
  else location.hash = address;
}

function link(address, text) {
  return h("a", { href: `#${address}`, "aria-current": location.hash === `#${address}` ? "page" : null }, text);
}

// Sends what can be sent now, and comes back when the next try is due, or later if the phone's store has failed.
async function send() {
  let next = Date.now() + LONGEST_TIMER_MS;
  try {
    registerSync().catch(() => {}); // not allowed in private windows
    next = await sendWaiting();
  } finally {
    clearTimeout(timer);
    if (next !== null) timer = setTimeout(send, Math.min(Math.max(next - Date.now(), 1000), LONGEST_TIMER_MS));
  }
}

// Before anything is sent: the tab may be closed while a try still runs.
async function registerSync() {
  if ((await nextTryMs()) === null) return;
  const { sync } = (await navigator.serviceWorker?.getRegistration()) ?? {};
  if (sync && !(await sync.getTags()).includes(SYNC)) await sync.register(SYNC);
}

// Offline it is done another time, when the page is opened again.
async function renew() {
  const registration = await navigator.serviceWorker?.getRegistration();
  await renewReminders(registration).catch(() => {});
}

// Without texts, or a store, the error is shown as it is: a rejection here would be the next one to show.
async function showError(error) {
  const alert = document.querySelector("#error");
  const t = await store.phone().then(textsOf).catch(() => null);
  if (t) showSentence(alert, error, t);
  else alert.textContent = error.message;
  alert.hidden = false;
}
