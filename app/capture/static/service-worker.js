// Keeps the page's files, so that it opens offline, sends what waits when the network is back and no tab is open, shows
// reminders, and renews their subscription.
// The server puts `const SHELL = {version, files, texts}` before this script (app/capture/files.py).

import { renewReminders } from "./reminders.js";
import { sendWaiting } from "./sender.js";
import * as store from "./store.js";
import { bestLanguage } from "./texts.js";

const CACHE = `tada-capture-${SHELL.version}`;
const SCOPE = new URL(self.registration.scope);

self.addEventListener("install", (event) => event.waitUntil(keepFiles()));
self.addEventListener("activate", (event) => event.waitUntil(forgetOtherVersions()));
self.addEventListener("sync", (event) => event.waitUntil(sendOrAskAgain()));

self.addEventListener("fetch", (event) => {
  const { url, method, mode } = event.request;
  const { origin, pathname } = new URL(url);
  if (method !== "GET" || origin !== SCOPE.origin || !pathname.startsWith(SCOPE.pathname)) return; // the API's: never kept
  event.respondWith(fromCache(mode === "navigate" ? SCOPE.href : origin + pathname, event.request));
});

self.addEventListener("push", (event) => event.waitUntil(remind(event.data?.json() ?? {})));
self.addEventListener("pushsubscriptionchange", (event) => event.waitUntil(renewReminders(self.registration)));
self.addEventListener("notificationclick", (event) => {
  event.notification.close();
  event.waitUntil(openPage(event.notification.data.address));
});

// A message says only of what kind it is; the texts are this page's. They are a part of this script, and the store may
// fail: a browser ends the subscription of a page that shows nothing.
async function remind({ kind }) {
  const phone = await store.phone().catch(() => null);
  const texts = SHELL.texts[bestLanguage([phone?.locale, ...navigator.languages])];
  const t = (key) => texts[key];
  const isAfter = kind === "after_meal";
  await self.registration.showNotification(t("title"), {
    body: t(isAfter ? "remind_after_meal" : "remind_meal"),
    tag: isAfter ? "after_meal" : "meal", // a newer one takes the older one's place
    icon: "icon-180.png",
    data: { address: isAfter ? "#meals" : "#take" },
  });
}

async function openPage(address) {
  const tabs = await self.clients.matchAll({ type: "window" });
  const tab = tabs.find(({ url }) => url.startsWith(SCOPE.href));
  await (tab ? tab.focus() : self.clients.openWindow(SCOPE.href + address));
}

// The browser repeats a sync whose promise is rejected.
async function sendOrAskAgain() {
  if ((await sendWaiting()) !== null) throw new Error("Something still waits.");
}

async function keepFiles() {
  const cache = await caches.open(CACHE);
  await cache.addAll(SHELL.files.map((name) => new Request(new URL(name, SCOPE), { cache: "no-cache" })));
}

// This version is active only when no tab shows an older one.
async function forgetOtherVersions() {
  const names = await caches.keys();
  await self.clients.claim(); // the tab that was open before the first version was kept
  await Promise.all(names.filter((name) => name.startsWith("tada-capture-") && name !== CACHE).map((name) => caches.delete(name)));
}

async function fromCache(address, request) {
  const cache = await caches.open(CACHE);
  return (await cache.match(address)) ?? fetch(request);
}
