// A voice note: recorded here, kept with the meal's photographs, sent as the slot "voice_note".

import { button, h } from "./dom.js";

export const VOICE_NOTE = "voice_note";
const LONGEST_SECONDS = 60;
const BITS_PER_SECOND = 32_000; // speech; a minute is 240 kB
const TYPES = ["audio/webm;codecs=opus", "audio/mp4"]; // what the server takes; Safari records MP4

const recordedType = () => TYPES.find((type) => globalThis.MediaRecorder?.isTypeSupported(type));

/**
 * The part of a page that records, plays and deletes a note; null where this browser cannot record.
 *
 * keep(blob): called with each recording, and with null when it is deleted. Returns {element, stop()}; stop ends the part for good
 * and resolves when a running recording is kept; one whose microphone is still asked for does not begin.
 */
export function voiceNote(t, kept, keep) {
  const type = recordedType();
  if (!type || !navigator.mediaDevices?.getUserMedia) return null;
  const element = h("div", { class: "voice-note" });
  let recorder = null;
  let isKept = Promise.resolve(); // the last recording
  let timer;
  let isOver = false;
  showKept(kept);
  return { element, stop };

  function showKept(blob, alert = "") {
    if (!blob) return element.replaceChildren(button(t("voice_record"), record), h("p", { role: "alert" }, alert));
    const player = h("audio", { controls: true, "aria-label": t("voice_note") });
    player.src = URL.createObjectURL(blob);
    element.replaceChildren(player, button(t("voice_delete"), async () => {
      await keep(null);
      URL.revokeObjectURL(player.src);
      showKept(null);
    }));
  }

  async function record() {
    let stream;
    try {
      stream = await navigator.mediaDevices.getUserMedia({ audio: true });
    } catch {
      return showKept(null, t("microphone_unavailable"));
    }
    if (isOver) return stream.getTracks().forEach((track) => track.stop()); // the page was left meanwhile
    const pieces = [];
    recorder = new MediaRecorder(stream, { mimeType: type, audioBitsPerSecond: BITS_PER_SECOND });
    recorder.addEventListener("dataavailable", ({ data }) => pieces.push(data));
    isKept = new Promise((resolve) => recorder.addEventListener("stop", resolve)).then(async () => {
      clearTimeout(timer);
      stream.getTracks().forEach((track) => track.stop());
      const blob = new Blob(pieces, { type: type.split(";")[0] });
      if (!blob.size) return showKept(null, t("voice_empty"));
      await keep(blob);
      showKept(blob);
    });
    recorder.start();
    timer = setTimeout(end, LONGEST_SECONDS * 1000);
    element.replaceChildren(
      h("p", { role: "status" }, h("span", { class: "recording", "aria-hidden": "true" }), t("voice_recording", { seconds: LONGEST_SECONDS })),
      button(t("voice_stop"), end, { kind: "main" }),
    );
  }

  function stop() {
    isOver = true;
    return end();
  }

  function end() {
    if (recorder?.state === "recording") recorder.stop();
    return isKept;
  }
}
