// Enrolling this phone: by the link of a card's QR code (#code=...), by scanning the code here, or by typing it.

import { openCamera } from "../camera.js";
import { TadaClient, newId } from "../client/index.js";
import { button, h } from "../dom.js";
import { endSubscription } from "../reminders.js";
import { clientOf } from "../sender.js";
import * as store from "../store.js";
import { sentenceOf } from "../texts.js";

export async function showEnrol(main, { t, phone, go }, code) {
  const begun = code ? null : await store.joining();
  const status = h("p", { role: "alert" });
  const field = h("input", { id: "code", autocomplete: "off", autocapitalize: "none", spellcheck: "false", required: true });
  field.value = begun?.code ?? "";
  const video = h("video", { playsinline: true, muted: true, hidden: true, "aria-label": t("enrol_preview") });
  const join = h("button", {}, t("enrol_button"));
  let camera = null;

  async function enrol(code) {
    status.textContent = "";
    if (phone?.token && !confirm(t("enrol_replace", { participant: phone.participant, study: phone.name ?? phone.study }))) return go("meals");
    try {
      await enrolPhone(code, t("enrol_device_name"));
    } catch (error) {
      if (error.code === "enrolment_code_invalid") await store.endJoining();
      status.textContent = error.code === "enrolment_code_invalid" ? t("enrol_code_invalid") : t("enrol_failed", { detail: sentenceOf(error, t) });
      return;
    }
    // Only now, so that a wrong code does not end the enrolment that works. Where it fails, the study's list keeps the old one.
    await clientOf(phone, { retries: { attempts: 1 } })?.signOut().catch(() => {});
    if (store.ownerOf(phone) !== store.ownerOf(await store.phone())) await endSubscription().catch(() => {});
    go("meals");
  }

  function stopScan() {
    camera?.close();
    camera = null;
    video.hidden = true;
  }

  async function scan() {
    const opened = await openCamera(video).catch(() => null);
    if (!video.isConnected) return opened?.close(); // the page was left while the browser asked
    if (!opened) return void (status.textContent = t("camera_unavailable"));
    camera = opened;
    video.hidden = false;
    const code = await scannedCode(video, () => camera !== null).finally(stopScan);
    if (code) await enrol(code);
  }

  const ended = phone?.ended_by && { unauthenticated: "enrol_again", withdrawn: "enrol_withdrawn" }[phone.ended_by];
  main.append(
    h("h1", {}, t("enrol_title")),
    ...(ended ? [h("p", { class: "notice" }, t(ended))] : []),
    h("p", {}, t("enrol_explain")),
    video,
    button(t("enrol_scan"), scan, { kind: "main" }),
    h(
      "form",
      {
        onsubmit: async (event) => {
          event.preventDefault();
          join.disabled = true; // a second tap would use the code a second time
          await enrol(codeIn(field.value) || field.value.trim());
          join.disabled = false;
        },
      },
      h("label", { for: "code" }, t("enrol_type")),
      field,
      join,
    ),
    status,
  );
  if (phone?.receipt) status.textContent = t("withdrawn_explain", { receipt: phone.receipt });
  if (code) await enrol(code);
  return stopScan;
}

// A code works once: the secret that asks for its token again is stored before it is used, and the token before anything
// else is asked of the server.
async function enrolPhone(code, deviceName) {
  const server = location.origin;
  const client = new TadaClient({ server });
  const kept = await store.joining();
  const attempt = kept?.code === code ? kept : { code, secret: newId() + newId() };
  await store.saveJoining(attempt);
  const { token, study, participant, marker } = await client.enrol({ ...attempt, device_name: deviceName, model: navigator.userAgentData?.model || null }).catch(async (error) => {
    if (error.code === "enrolment_code_invalid") await store.endJoining(); // the next attempt draws another secret
    throw error;
  });
  const enrolled = { server, token, study, participant, marker };
  await store.savePhone(enrolled);
  await store.endJoining();
  await store.askToPersist();
  await refreshPhone(client, enrolled);
}

/** Read the study's protocol and keep it, for when there is no network. Without one, what was kept stays. */
export async function refreshPhone(client, { token }) {
  const me = await client.getMe().catch(() => null);
  if (!me) return;
  const { code, version, ...protocol } = me.study;
  await store.changePhone(token, (phone) => ({ ...phone, ...protocol, joined_at: me.joined_at }));
}

async function scannedCode(video, isOpen) {
  const { scan } = await import("../qr_scan.js"); // the decoder is large, and most phones come by the link
  return scan(video, codeIn, isOpen);
}

/** The enrolment code in a QR code's text, a link with #code=... or the app's JSON; "" in another QR code's. */
export function codeIn(text) {
  try {
    return JSON.parse(text).code ?? "";
  } catch {
    return new URLSearchParams(text.split("#")[1]).get("code") ?? "";
  }
}
