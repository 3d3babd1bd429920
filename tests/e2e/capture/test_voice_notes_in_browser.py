"""Voice notes of the capture page: recorded, replaced, sent and played; and what can go wrong."""

import pytest

from tests.e2e.browser import WatchedPage
from tests.e2e.capture.capture_page import enrolled, photograph, require_accessible, send
from tests.e2e.dashboard_server import PASSWORD
from tests.support.waiting import wait_until

pytestmark = pytest.mark.slow

WITHOUT_MICROPHONE = """() => {
  navigator.mediaDevices.getUserMedia = async () => { throw new DOMException("", "NotAllowedError"); };
}"""
SLOW_MICROPHONE = """() => {
  const ask = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
  navigator.mediaDevices.getUserMedia = (options) => new Promise((resolve) => {
    window.allow = async () => {
      const stream = await ask(options);
      window.tracks = stream.getTracks();
      resolve(stream);
    };
  });
}"""
COUNT_RECORDED_BYTES = """
const start = MediaRecorder.prototype.start;
MediaRecorder.prototype.start = function () {
  window.recorder = this;
  window.recordedBytes = 0;
  this.addEventListener("dataavailable", ({ data }) => { window.recordedBytes += data.size; });
  start.call(this);
};"""
RECORDED_BYTES = "() => { recorder.requestData(); return recordedBytes; }"
EMPTY_RECORDING = """() => {
  const listen = MediaRecorder.prototype.addEventListener;
  MediaRecorder.prototype.addEventListener = function (name, ...rest) {
    if (name !== "dataavailable") listen.call(this, name, ...rest);
  };
}"""
UNREADABLE_NOTE = """async () => {
  const store = await import("/capture/store.js");
  const [draft] = await store.meals();
  await store.saveDraft({ ...draft, slots: [...draft.slots, "voice_note"] }, { voice_note: new Blob(["no sound"]) });
}"""
NOTE_BYTES = """async () => {
  const store = await import("/capture/store.js");
  const [meal] = await store.meals();
  return (await store.photograph(meal.id, "voice_note"))?.bytes.byteLength ?? null;
}"""
PLAYED = """async () => {
  const audio = document.querySelector("#voice-note audio");
  audio.muted = true;
  await audio.play();
  await new Promise((resolve) => audio.addEventListener("ended", resolve));
  return audio.currentTime;
}"""


def record_note(page, min_bytes=500):
    """Record a voice note until the microphone has given so many bytes; the page runs COUNT_RECORDED_BYTES."""
    page.get_by_role("button", name="Record a voice note").click()
    page.get_by_text("Recording: speak now").wait_for()
    wait_until(lambda: page.evaluate(RECORDED_BYTES) >= min_bytes, f"{min_bytes} bytes of sound")


def test_voice_note_is_recorded_deleted_replaced_sent_and_played_by_a_reviewer(served, open_phone, browser):
    tab = open_phone()
    tab.page.add_init_script(COUNT_RECORDED_BYTES)
    page = enrolled(served, tab)
    photograph(page)
    record_note(page)
    require_accessible(page)
    page.get_by_role("button", name="Stop").click()
    page.get_by_label("Voice note", exact=True).wait_for()
    assert page.evaluate(NOTE_BYTES) > 0
    page.get_by_role("button", name="Delete the voice note").click()
    page.get_by_role("button", name="Record a voice note").wait_for()
    assert page.evaluate(NOTE_BYTES) is None
    record_note(page, 4_000)
    page.get_by_role("button", name="Stop").click()
    page.get_by_label("Voice note", exact=True).wait_for()
    require_accessible(page)
    page.reload()
    page.get_by_label("Voice note", exact=True).wait_for()
    meal = send(page)
    note = served.meal(meal)["voice_note"]
    assert (note["media_type"], note["durable"]) == ("audio/webm", True)
    assert 2_000 < note["bytes"] < 200_000
    assert list(served.meal(meal)["images"]) == ["left", "right"]

    desk = WatchedPage(browser.new_page(), served.address)
    served.make_staff("rita", capture="reviewer")
    desk.sign_in("rita", PASSWORD, f"/dashboard/studies/capture/meals/P001/{meal}")
    seconds = desk.page.evaluate(PLAYED)
    assert 0.5 < seconds < 10
    desk.require_quiet()
    desk.page.close()


def test_recording_that_still_runs_is_sent_too(served, open_phone):
    tab = open_phone()
    tab.page.add_init_script(COUNT_RECORDED_BYTES)
    page = enrolled(served, tab)
    photograph(page)
    record_note(page)
    assert served.meal(send(page))["voice_note"]["durable"]


def test_no_note_is_sent_without_a_microphone_or_sound_nor_by_a_microphone_that_is_allowed_too_late(served, open_phone):
    page = enrolled(served, open_phone())
    photograph(page)
    record = page.get_by_role("button", name="Record a voice note")
    page.evaluate(WITHOUT_MICROPHONE)
    record.click()
    page.get_by_text("The microphone cannot be used here").wait_for()
    page.reload()  # which ends what the script has changed
    page.evaluate(EMPTY_RECORDING)
    record.click()
    page.get_by_role("button", name="Stop").click()
    page.get_by_text("Nothing was recorded").wait_for()
    page.reload()
    record.wait_for()
    page.evaluate(SLOW_MICROPHONE)
    record.click()
    assert served.meal(send(page))["voice_note"] is None
    page.evaluate("window.allow()")
    ended = "tracks.map((track) => track.readyState)"
    wait_until(lambda: page.evaluate(ended) == ["ended"], "the microphone to be released")


def test_refused_note_does_not_hold_its_meal_back(served, open_phone):
    tab = open_phone()
    tab.expect("status of 422")
    page = enrolled(served, tab)
    photograph(page)
    page.evaluate(UNREADABLE_NOTE)
    meal = send(page)
    page.get_by_text("The voice note could not be kept").wait_for()
    sent = served.meal(meal)
    assert (list(sent["images"]), sent["voice_note"]) == (["left", "right"], None)
    assert page.evaluate(NOTE_BYTES) is None
