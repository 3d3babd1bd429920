// Photographing a meal: left, right, a look at the server's check, sending. Each photograph is in the store before the
// next step begins, so that a reload continues where it broke off. With "after" the pair shows what was left of a meal.
//
// Addresses: #take (a new meal), #take/ID (a draft), #take/ID/after. Only drafts are changed here: one that another tab has
// sent, or the browser's "back" leads to, belongs to the queue.

import { canTakeStills, grabFrame, openCamera, pickPhotograph, thumbnail } from "../camera.js";
import { isPhotograph, takenAt } from "../chosen_file.js";
import { newId } from "../client/index.js";
import { button, h, picture, svg } from "../dom.js";
import * as store from "../store.js";
import { VOICE_NOTE, voiceNote } from "../voice_note.js";

const FRAME_PX = 640;
const CHECK_SECONDS = 15;

export async function showTake(main, { t, phone, client, go }, id, part) {
  const isAfter = part === "after";
  const slots = isAfter ? ["after_left", "after_right"] : ["left", "right"];
  const stored = id ? await store.meal(isAfter ? `${id}/after` : id) : null;
  if (stored ? stored.state !== "draft" : id && !isAfter) return go("meals");
  let draft = stored ?? newDraft(phone, id);
  const page = h("div"); // of this page alone: what ends late does not touch the page that is shown by then
  let close = () => {};
  main.append(page);
  await next();
  return () => close();

  async function next() {
    close();
    close = () => {};
    if (!page.isConnected) return;
    page.replaceChildren();
    const slot = slots.find((slot) => !draft.slots.includes(slot));
    if (slot) await shoot(slot);
    else await review();
  }

  // One photograph: the preview with its advice, or the system's camera.
  async function shoot(slot) {
    const isSecond = slot === slots[1];
    const video = h("video", { playsinline: true, muted: true, "aria-label": t("preview") });
    const outline = svg("svg", { class: "outline", "aria-hidden": "true" });
    const advice = h("p", { class: "advice", role: "status" });
    const alert = h("p", { role: "alert" });
    let camera = null;
    let help = null;

    async function keep(blob, taken = new Date()) {
      if (!blob || !page.isConnected) return;
      await keepPhotograph(slot, blob, taken, help?.board() ?? null);
      await next();
    }
    // Not awaited: a browser may never tell that the person has cancelled, and the buttons must stay usable.
    const pick = (fromCamera) => void pickPhotograph({ fromCamera }).then((file) => file && keepFile(file, fromCamera));

    async function keepFile(file, fromCamera) {
      const bytes = new Uint8Array(await file.arrayBuffer());
      alert.textContent = isPhotograph(bytes) ? "" : t("not_a_photograph");
      if (!isPhotograph(bytes)) return;
      const taken = fromCamera ? new Date() : takenAt(bytes);
      const isTimeKnown = isSecond || (taken && taken <= new Date()); // a meal's time is that of its first photograph
      if (isTimeKnown) await keep(file, taken ?? new Date());
      else askTime(file);
    }

    function askTime(file) {
      const time = h("input", { id: "taken", type: "datetime-local", max: localInstant(new Date()).slice(0, 16), required: true });
      close();
      page.replaceChildren(
        h("h1", {}, t("taken_title")),
        h("p", {}, t("taken_explain")),
        h("label", { for: "taken" }, t("taken_time")),
        time,
        button(t("taken_keep"), () => time.reportValidity() && keep(file, new Date(time.value)), { kind: "main large" }),
        h("div", { class: "actions" }, button(t("cancel"), next)),
      );
    }


    page.append(
      h("h1", {}, t(isSecond ? "second_title" : "first_title")),
      h("p", {}, t(isSecond ? "second_explain" : "first_explain")),
    );
    if (canTakeStills()) {
      camera = await openCamera(video).catch(() => null);
      if (!page.isConnected) return camera?.close();
      if (!camera) page.append(h("p", { class: "notice" }, t("camera_unavailable")));
    }
    if (camera) {
      const stage = h("div", { class: "stage" }, video, outline);
      page.append(stage, advice, button(t("shutter"), async () => keep(await camera.takePhoto()), { kind: "main shutter" }));
      help = startHelp(video, outline, advice, t, phone.marker, isSecond ? draft.first_board : null);
    } else {
      page.append(button(t("open_camera"), () => pick(true), { kind: "main shutter" }));
    }
    page.append(
      h(
        "div",
        { class: "actions" },
        button(t("choose_file"), () => pick(false)),
        isSecond && !isAfter ? button(t("only_one"), () => send()) : null,
        button(t("cancel"), cancel),
      ),
      alert,
    );
    close = () => {
      help?.stop();
      camera?.close();
    };
  }

  // Both are here: ask the server what it thinks of them, if there is a network; the person decides.
  async function review() {
    const note = h("input", { id: "note", maxlength: 500, autocomplete: "off" });
    const result = h("div", { role: "status" });
    const kept = await Promise.all(slots.map((slot) => store.photograph(draft.id, slot)));
    if (!page.isConnected || !kept.every(Boolean)) return go("meals"); // another tab has sent them
    const pictures = kept.map(store.blobOf);
    const recording = draft.slots.includes(VOICE_NOTE) ? await store.photograph(draft.id, VOICE_NOTE) : null;
    const voice = isAfter ? null : voiceNote(t, recording ? store.blobOf(recording) : null, keepVoice);
    page.append(
      h("h1", {}, t("review_title")),
      h("div", { class: "pair" }, ...slots.map((slot, index) => h("figure", {}, picture(pictures[index], ""), button(t("take_again"), () => retake(slot))))),
      result,
      ...(isAfter ? [] : [h("div", {}, h("label", { for: "note" }, t("note")), note, voice?.element ?? "")]),
      button(t("send"), sendBoth, { kind: "main large" }),
      h("div", { class: "actions" }, button(t("cancel"), cancel)),
    );
    async function sendBoth() {
      await voice?.stop();
      await send(note.value.trim());
    }
    const stop = new AbortController();
    close = () => {
      voice?.stop();
      stop.abort();
    };
    showCheck(result, pictures, stop.signal).catch(() => {}); // offline, or too busy: the meal can be sent in any case
  }

  async function showCheck(result, [left, right], signal) {
    if (!navigator.onLine) return;
    result.append(h("p", {}, t("checking")));
    const check = await client
      .checkPair(left, right, { locale: document.documentElement.lang }, { seconds: CHECK_SECONDS, signal })
      .catch(() => null);
    if (signal.aborted) return;
    const sentences = check ? [...new Set(check.problems.map((problem) => problem.message))] : [];
    result.replaceChildren(
      ...(check && !check.ok ? [h("p", { class: "bad" }, t("check_bad"))] : []),
      ...(check?.ok && !sentences.length ? [h("p", { class: "good" }, t("check_good"))] : []),
      ...(sentences.length ? [h("ul", {}, ...sentences.map((sentence) => h("li", {}, sentence)))] : []),
    );
  }

  async function keepPhotograph(slot, blob, taken, board) {
    const changed = { ...draft, slots: [...draft.slots.filter((other) => other !== slot), slot] };
    if (slot === slots[0]) {
      Object.assign(changed, { captured_at: localInstant(taken), first_board: board, thumbnail: await store.keptBlob(await thumbnail(blob)) });
    }
    changed.captured_at ??= localInstant(taken);
    if (!(await store.saveDraft(changed, { [slot]: blob }))) return go("meals");
    draft = changed;
    if (page.isConnected) history.replaceState(null, "", `#take/${draft.id}`); // a reload finds the draft again
  }

  async function keepVoice(blob) {
    if (!page.isConnected) return; // left while recording
    const others = draft.slots.filter((slot) => slot !== VOICE_NOTE);
    const changed = { ...draft, slots: blob ? [...others, VOICE_NOTE] : others };
    if (!(await store.saveDraft(changed, blob ? { [VOICE_NOTE]: blob } : {}))) return go("meals");
    draft = changed;
  }

  async function retake(slot) {
    const changed = { ...draft, slots: draft.slots.filter((other) => other !== slot) };
    if (!(await store.saveDraft(changed))) return go("meals");
    draft = changed;
    await next();
  }

  async function send(comment = "") {
    await store.changeMeal(draft.id, (record) => {
      if (record.state !== "draft") return false;
      Object.assign(record, { state: "waiting", next_try_ms: 0, comment: comment ? { id: newId(), text: comment } : null });
    });
    navigator.vibrate?.(50);
    go("meals");
  }

  async function cancel() {
    if (draft.slots.length && !confirm(t("cancel_confirm"))) return;
    await store.deleteMeal(draft.id, "draft");
    go("meals");
  }
}

/** A record of which nothing is photographed yet. meal: whose leftovers it shows; none: it is a new meal. */
export function newDraft(phone, meal) {
  const id = meal ? `${meal}/after` : newId();
  return {
    id,
    meal: meal ?? id,
    part: meal ? "after" : "meal",
    owner: store.ownerOf(phone),
    state: "draft",
    captured_at: null,
    time_zone: Intl.DateTimeFormat().resolvedOptions().timeZone,
    created_ms: Date.now(),
    slots: [],
    durable: [],
    is_announced: false,
    comment: null,
    all_eaten: null,
    tries: 0,
    waited_from_ms: 0,
    next_try_ms: 0,
    problem: null,
    thumbnail: null,
    first_board: null,
  };
}

/** RFC 3339 with the phone's offset, to the second. */
export function localInstant(date) {
  const minutes = -date.getTimezoneOffset();
  const local = new Date(date.getTime() + minutes * 60_000).toISOString().slice(0, 19);
  const offset = `${String(Math.floor(Math.abs(minutes) / 60)).padStart(2, "0")}:${String(Math.abs(minutes) % 60).padStart(2, "0")}`;
  return `${local}${minutes < 0 ? "-" : "+"}${offset}`;
}

// Analyses frames in a worker while the preview runs, one at a time; shows the board's outline and one piece of advice.
function startHelp(video, outline, advice, t, marker, first) {
  const worker = new Worker(new URL("../live/frame_worker.js", import.meta.url), { type: "module" });
  const canvas = document.createElement("canvas");
  let size = null; // of the frame that is being analysed
  let board = null; // {corners, width, height}
  let isRunning = true;

  worker.addEventListener("message", ({ data }) => {
    board = data.board && { corners: data.board.corners, ...size };
    const text = t(`advice_${data.advice}`);
    if (advice.textContent !== text) advice.textContent = text;
    advice.dataset.advice = data.advice;
    drawBoard(outline, board, first);
    if (isRunning) requestAnimationFrame(analyse);
  });
  analyse();

  function analyse() {
    if (!isRunning) return;
    const frame = grabFrame(video, canvas, FRAME_PX);
    if (!frame) return void setTimeout(analyse, 100);
    size = { width: frame.width, height: frame.height };
    worker.postMessage({ pixels: frame.data.buffer, ...size, marker, first }, [frame.data.buffer]);
  }

  return {
    board: () => board,
    stop() {
      isRunning = false;
      worker.terminate();
    },
  };
}

function drawBoard(outline, board, first) {
  const size = board ?? first;
  if (size) outline.setAttribute("viewBox", `0 0 ${size.width} ${size.height}`);
  outline.replaceChildren(
    ...[first && ["first", first], board && ["now", board]]
      .filter(Boolean)
      .map(([name, { corners }]) => svg("polygon", { class: name, points: corners.map((corner) => corner.join(",")).join(" ") })),
  );
}
