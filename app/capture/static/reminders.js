// Reminders by Web Push: the part of the phone's page that turns them on, sets their times, and turns them off; and their
// renewal, when the browser has another subscription, the phone another time zone, or the server another key.

import { button, h } from "./dom.js";
import { clientOf } from "./sender.js";
import * as store from "./store.js";
import { sentenceOf } from "./texts.js";

const LOCK = "tada-capture-reminders";
const OWN_TIMES = 4;

// Tabs and the service worker change the browser's only subscription one after the other.
const alone = (change) => navigator.locks.request(LOCK, change);

/**
 * Send the server this browser's subscription and time zone, if it has others. What the person wants is kept here too: the
 * server forgets a subscription that has ended. Nothing happens on a phone that has no reminders.
 */
export async function renewReminders(registration) {
  if (registration?.pushManager && globalThis.Notification?.permission === "granted") await alone(() => renew(registration.pushManager));
}

async function renew(pushManager) {
  const phone = await store.phone();
  const client = clientOf(phone);
  if (!client) return;
  const reminders = await client.getReminders();
  const wishes = reminders.subscribed ? wishesOf(reminders) : phone.reminders?.wishes;
  if (!reminders.available || !wishes) return;
  const kept = await pushManager.getSubscription();
  if (!reminders.subscribed && kept?.endpoint === phone.reminders.endpoint) await kept?.unsubscribe(); // it has ended
  const subscription = await subscribe(pushManager, reminders.public_key);
  const isSent = reminders.subscribed && subscription.endpoint === phone.reminders?.endpoint && reminders.time_zone === timeZone();
  if (!isSent) await putReminders(client, wishes, subscription);
}

const timeZone = () => Intl.DateTimeFormat().resolvedOptions().timeZone;

const wishesOf = ({ times, after_meal, quiet_from, quiet_until }) => ({ times, after_meal, quiet_from, quiet_until });

async function putReminders(client, wishes, subscription) {
  const reminders = await client.putReminders({ ...wishes, subscription, time_zone: timeZone() });
  const kept = { wishes: wishesOf(reminders), endpoint: subscription.endpoint };
  await store.changePhone(client.token, (phone) => ({ ...phone, reminders: kept }));
  return reminders;
}

/** End the browser's subscription: the person whose reminders it brings has signed out, or somebody else has joined. */
export async function endSubscription() {
  const registration = await navigator.serviceWorker?.getRegistration();
  if (registration?.pushManager) await alone(() => unsubscribe(registration.pushManager));
}

/** Show the reminders of this phone in `section`; nothing where the server sends none. */
export async function showReminders(section, t, client) {
  const reminders = await client.getReminders();
  if (!reminders.available) return;
  section.append(h("h2", {}, t("reminders_title")));
  if (!("PushManager" in globalThis && "serviceWorker" in navigator)) return section.append(h("p", {}, t("reminders_unsupported")));
  const status = h("p", { role: "status" });
  const content = h("div");
  section.append(h("p", {}, t("reminders_explain")), content, status);
  render(reminders);

  function render({ subscribed, study_times, times, after_meal, quiet_from, quiet_until }) {
    const explained = study_times.length ? h("p", {}, t("reminders_study", { times: study_times.join(", ") })) : null;
    const wishes = { times: study_times.length ? null : [], after_meal: true };
    if (!subscribed) return content.replaceChildren(...[explained, button(t("reminders_on"), () => save(wishes))].filter(Boolean));
    const shown = times ?? study_times;
    const own = Array.from({ length: Math.max(OWN_TIMES, shown.length) }, (_, place) => field(t("reminders_time", { number: place + 1 }), { type: "time", value: shown[place] ?? "" }));
    const after = h("input", { type: "checkbox", id: "after-meal", checked: after_meal });
    const from = field(t("reminders_quiet_from"), { type: "time", value: quiet_from, required: true });
    const until = field(t("reminders_quiet_until"), { type: "time", value: quiet_until, required: true });
    const form = h("form", {}, ...own.map(({ element }) => element), h("label", { class: "check", for: "after-meal" }, after, t("reminders_after")), from.element, until.element);
    const changed = () => {
      const entered = [...new Set(own.map(({ input }) => input.value).filter(Boolean))].sort();
      const isStudys = study_times.length > 0 && entered.join() === study_times.join();
      return { times: isStudys ? null : entered, after_meal: after.checked, quiet_from: from.input.value, quiet_until: until.input.value };
    };
    content.replaceChildren(
      ...[explained, form, h("div", { class: "actions" }, button(t("reminders_save"), () => form.reportValidity() && save(changed()), { kind: "main" }), button(t("reminders_off"), leave))].filter(Boolean),
    );
  }

  function field(text, attributes) {
    const input = h("input", attributes);
    return { input, element: h("label", {}, text, input) };
  }

  async function save(wishes) {
    await attempt(async () => {
      if ((await Notification.requestPermission()) !== "granted") throw new DOMException("", "NotAllowedError");
      const { pushManager } = await navigator.serviceWorker.ready;
      render(await alone(async () => putReminders(client, wishes, await subscribe(pushManager, reminders.public_key))));
      status.textContent = t("reminders_saved");
    });
  }

  async function leave() {
    await attempt(async () => {
      const registration = await navigator.serviceWorker.ready;
      await alone(async () => {
        await store.changePhone(client.token, ({ reminders, ...phone }) => phone); // first: else the page, if it ends here, subscribes again
        await client.deleteReminders();
        await unsubscribe(registration.pushManager);
      });
      render({ ...reminders, subscribed: false });
    });
  }

  async function attempt(action) {
    status.textContent = "";
    try {
      await action();
    } catch (error) {
      status.textContent = error.name === "NotAllowedError" ? t("reminders_denied") : sentenceOf(error, t);
    }
  }
}

// The browser's subscription for this server's key: {endpoint, keys}. One for another key is given up first.
async function subscribe(pushManager, key) {
  const options = { userVisibleOnly: true, applicationServerKey: key };
  const subscription = await pushManager.subscribe(options).catch(async (error) => {
    if (error.name !== "InvalidStateError") throw error;
    await unsubscribe(pushManager);
    return pushManager.subscribe(options);
  });
  const { endpoint, keys } = subscription.toJSON();
  return { endpoint, keys };
}

const unsubscribe = async (pushManager) => (await pushManager.getSubscription())?.unsubscribe();
