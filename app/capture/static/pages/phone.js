// This phone: whose it is, signing out, leaving the study.

import { button, h } from "../dom.js";
import { endSubscription, showReminders } from "../reminders.js";
import * as store from "../store.js";
import { showSentence } from "../texts.js";

export async function showPhone(main, { t, phone, client, go }) {
  const status = h("p", { role: "alert" });
  const owner = store.ownerOf(phone);
  const reminders = h("section");
  main.append(
    h("h1", {}, t("phone_page")),
    h("p", {}, t("this_phone", { participant: phone.participant, study: phone.name ?? phone.study })),
    button(t("my_data"), downloadMine),
    reminders,
    h("h2", {}, t("sign_out_title")),
    h("p", {}, t("sign_out_explain")),
    button(t("sign_out"), signOut),
    h("h2", {}, t("withdraw_title")),
    h("p", {}, t("withdraw_explain")),
    button(t("withdraw"), withdraw, { kind: "danger" }),
    status,
  );
  showReminders(reminders, t, client).catch(() => {}); // offline, or an older server: they are set another time

  async function downloadMine() {
    await attempt(async () => {
      const address = URL.createObjectURL(await client.getMyExport());
      h("a", { href: address, download: "my-data.zip" }).click();
      setTimeout(() => URL.revokeObjectURL(address), 60_000);
    });
  }

  // The phone's meals that are not sent yet would be lost: they are sent first, or the person says so.
  async function signOut() {
    const unsent = (await store.meals()).filter((record) => record.owner === owner && record.state !== "sent").length;
    if (!confirm(unsent ? t("sign_out_loses", { count: unsent }) : t("sign_out_confirm"))) return;
    await attempt(async () => {
      await client.signOut();
      await store.deleteOwner(phone);
      await endSubscription().catch(() => {});
      go("enrol");
    });
  }

  async function withdraw() {
    if (!confirm(t("withdraw_confirm"))) return;
    await attempt(async () => {
      const receipt = await client.withdraw().catch(passCode("withdrawn"));
      await store.deleteOwner(phone, { locale: phone.locale, ended_by: "withdrawn", receipt: receipt?.id });
      await endSubscription().catch(() => {});
      main.replaceChildren(h("h1", {}, t("withdrawn_title")), ...(receipt ? [h("p", {}, t("withdrawn_explain", { receipt: receipt.id }))] : []));
    });
  }

  async function attempt(action) {
    status.textContent = "";
    try {
      await action();
    } catch (error) {
      showSentence(status, error, t);
    }
  }
}

// The answer to an earlier try was lost: the server already does what it was asked for.
const passCode = (code) => (error) => {
  if (error.code !== code) throw error;
  return null;
};
