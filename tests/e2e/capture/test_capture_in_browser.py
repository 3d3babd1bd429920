"""The capture page on a phone: what is left of a meal, days, participants who come and go, and what can go wrong."""

from contextlib import suppress

import pytest
from playwright.sync_api import Error, expect

from tests.e2e.capture.capture_page import (
    both_photographs,
    capture_link,
    enrolled,
    first_photograph,
    open_estimated,
    photograph,
    require_accessible,
    send,
    sent_meal,
)
from tests.e2e.clients.lossy_line import lossy_line
from tests.e2e.dashboard_server import require
from tests.support import estimates
from tests.support.estimates import identified_item
from tests.support.waiting import wait_until

pytestmark = pytest.mark.slow

REFUSED = """async (id) => {
  const store = await import("/capture/store.js");
  await store.changeMeal(id, (record) => { record.state = "refused"; });
}"""
ANNOUNCED_AFTER = """async (meal) => {
  const { clientOf } = await import("/capture/sender.js");
  const store = await import("/capture/store.js");
  const client = clientOf(await store.phone());
  await client.request("PUT", `/v1/meals/${meal}/after`, { json: { captured_at: new Date().toISOString() } });
}"""
SENT_AFTER = """async (meal) => {
  const store = await import("/capture/store.js");
  const { newDraft } = await import("/capture/pages/take.js");
  const draft = newDraft(await store.phone(), meal);
  Object.assign(draft, { state: "waiting", captured_at: new Date().toISOString(), slots: ["after_left"] });
  await store.saveDraft(draft, { after_left: new Blob(["a photograph"]) });
}"""
KEPT = """async (meal) => {
  const store = await import("/capture/store.js");
  const photograph = await store.photograph(`${meal}/after`, "after_left");
  return [(await store.meals()).map(({ id, state }) => [id, state]), photograph !== undefined];
}"""
# As the browser does when the disk is full: the transaction aborts.
FULL = """() => {
  window.put ??= IDBObjectStore.prototype.put;
  window.error ??= Object.getOwnPropertyDescriptor(IDBTransaction.prototype, "error");
  IDBObjectStore.prototype.put = function () { this.transaction.abort(); };
  const full = { get: () => new DOMException("full", "QuotaExceededError"), configurable: true };
  Object.defineProperty(IDBTransaction.prototype, "error", full);
}"""
WITH_ROOM = """() => {
  IDBObjectStore.prototype.put = window.put;
  Object.defineProperty(IDBTransaction.prototype, "error", window.error);
}"""
FULL_WHILE_SENDING = f"""() => {{
  const wait = window.setTimeout;
  window.setTimeout = (callback, ms) => wait(callback, Math.min(ms, 1000)); // the queue's waits are minutes
  const send = window.fetch;
  window.tries = 0;
  window.fetch = async (address, options) => {{
    if (window.hasRoom || options?.method !== "PUT") return send(address, options);
    window.tries += 1;
    ({FULL})();
    throw new TypeError("Failed to fetch");
  }};
}}"""
STALLED_SERVER = "() => { window.fetch = () => new Promise(() => {}); }"
SYNC_TAGS = "navigator.serviceWorker.ready.then((registration) => registration.sync.getTags())"
DIGESTS = """async () => {
  const store = await import("/capture/store.js");
  const [draft] = await store.meals();
  const digests = {};
  for (const slot of draft.slots) {
    const { bytes } = await store.photograph(draft.id, slot);
    const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes));
    digests[slot] = [Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join(""), bytes.byteLength];
  }
  return digests;
}"""


def test_what_is_left_is_photographed_or_nothing_is(served, open_phone):
    tab = open_phone()
    page, meal = tab.page, sent_meal(served, tab)
    open_estimated(served, page, meal)
    page.get_by_role("button", name="Photograph what is left").click()
    both_photographs(page)
    page.get_by_role("button", name="Send").click()
    page.wait_for_selector(f"li[data-meal='{meal}'][data-state=sent]")
    page.wait_for_selector(f"li[data-meal='{meal}/after']", state="detached")
    assert served.meal(meal)["after"]["status"] == "queued"


def test_refused_pair_gives_way_to_another_answer_once_the_person_agrees(served, open_phone):
    tab = open_phone()
    page, meal = tab.page, sent_meal(served, tab)
    after = f"{meal}/after"
    open_estimated(served, page, meal)
    page.get_by_role("button", name="Photograph what is left").click()
    first_photograph(page)
    page.evaluate(REFUSED, after)
    page.goto(f"{served.address}/capture/#meal/{meal}")
    page.once("dialog", lambda dialog: dialog.dismiss())
    with page.expect_event("dialog"):
        page.get_by_role("button", name="I ate all of it").click()
    assert page.evaluate(KEPT, meal) == [[[after, "refused"], [meal, "sent"]], True]
    page.once("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Photograph what is left").click()
    page.get_by_role("heading", name="First photograph").wait_for()
    assert page.evaluate(KEPT, meal) == [[[meal, "sent"]], False]

    first_photograph(page)
    page.evaluate(REFUSED, after)
    page.evaluate(ANNOUNCED_AFTER, meal)  # its metadata had arrived
    page.goto(f"{served.address}/capture/#meal/{meal}")
    page.get_by_role("button", name="Photograph what is left").wait_for()
    page.once("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="I ate all of it").click()
    page.get_by_role("button", name="I ate all of it").wait_for(state="detached")
    wait_until(lambda: page.evaluate(KEPT, meal) == [[[meal, "sent"]], False], "the answer to be sent")
    expect(page.get_by_role("button", name="Photograph what is left")).to_have_count(0)
    assert served.meal(meal)["after"]["status"] == "nothing_left"


def test_meal_that_was_erased_elsewhere_leaves_nothing_on_the_phone(served, open_phone):
    tab = open_phone()
    tab.expect("status of 410")
    page, meal = tab.page, sent_meal(served, tab)
    require(served.admin.delete(f"/v1/meals/{meal}"))
    page.evaluate(SENT_AFTER, meal)
    wait_until(lambda: page.evaluate(KEPT, meal) == [[], False], "the erased meal to be gone")


def test_full_phone_says_so_keeps_what_it_has_and_goes_on_once_there_is_room(served, open_phone):
    tab = open_phone(service_workers="block")  # it would send the meal itself
    tab.expect("Service Worker registration blocked")
    page = enrolled(served, tab)
    page.get_by_role("button", name="Photograph a meal").click()
    first_photograph(page)
    page.evaluate(FULL)
    page.get_by_role("button", name="Take the photograph").click()
    page.get_by_text("This phone has no room for the photograph").wait_for()
    page.evaluate(WITH_ROOM)
    page.get_by_role("button", name="Take the photograph").click()
    page.get_by_role("heading", name="Are both good?").wait_for()

    page.evaluate(FULL_WHILE_SENDING)
    page.get_by_role("button", name="Send").click()
    page.get_by_text("This phone has no room for the photograph").wait_for()
    wait_until(lambda: page.evaluate("tries") >= 8, "further tries")
    page.evaluate(f"() => {{ window.hasRoom = true; ({WITH_ROOM})(); }}")
    page.wait_for_selector("li[data-state=sent]")
    tab.thrown.clear()  # the error itself


def test_browser_is_asked_to_send_without_the_tab_before_the_tab_has_ended_its_first_try(served, open_phone):
    tab = open_phone(permissions=["camera", "background-sync"])
    page = enrolled(served, tab)
    photograph(page)
    page.evaluate("navigator.serviceWorker.ready.then(() => true)")
    page.evaluate(STALLED_SERVER)
    page.get_by_role("button", name="Send").click()
    page.wait_for_selector("li[data-state=waiting]")
    wait_until(lambda: page.evaluate(SYNC_TAGS) == ["send-meals"], "the browser to be asked")
    expect(page.locator("li[data-state=waiting]")).to_have_count(1)


@pytest.mark.parametrize(("ending", "left"), [("revocation", 1), ("withdrawal", 0)])
def test_phone_that_the_server_no_longer_knows_keeps_its_meals_unless_the_person_has_left(
    served, open_phone, ending, left
):
    participant = {"revocation": "P020", "withdrawal": "P021"}[ending]
    require(served.admin.post("/v1/studies/capture/participants", json={"code": participant}))
    tab = open_phone()
    tab.expect("status of 4(01|10)|ERR_INTERNET_DISCONNECTED")
    tab.page.goto(capture_link(served, participant))
    tab.page.get_by_role("button", name="Photograph a meal").wait_for()
    photograph(tab.page)
    tab.page.evaluate("navigator.serviceWorker.ready.then(() => true)")
    tab.page.context.set_offline(True)
    tab.page.get_by_role("button", name="Send").click()
    tab.page.wait_for_selector("li[data-state=waiting]")
    if ending == "revocation":
        devices = require(served.admin.get("/v1/studies/capture/devices"))["items"]
        device = next(device["id"] for device in devices if device["participant"] == participant)
        require(served.admin.delete(f"/v1/studies/capture/devices/{device}"))
    else:
        require(served.admin.post(f"/v1/studies/capture/participants/{participant}/withdrawal"))
    tab.page.context.set_offline(False)
    tab.page.reload()
    tab.page.get_by_role("heading", name="Join the study").wait_for()
    kept = tab.page.evaluate('import("/capture/store.js").then((store) => store.meals()).then((meals) => meals.length)')
    assert kept == left


def test_day_is_closed_and_a_reviewer_s_question_is_answered(served, open_phone):
    tab = open_phone()
    page, meal = tab.page, sent_meal(served, tab)
    served.say(meal, "question", text="Was the bread buttered?")
    page.get_by_role("link", name="Days").click()
    page.get_by_label("Was the bread buttered?").fill("No")
    page.get_by_role("button", name="Answer").click()
    page.get_by_label("Was the bread buttered?").wait_for(state="detached")
    require_accessible(page)
    day = served.meal(meal)["local_date"]
    assert page.locator("li[data-day]").count() < 7  # none before the person joined, today
    page.locator(f"li[data-day='{day}']").get_by_role("button", name="That was everything").click()
    page.wait_for_selector(f"li[data-day='{day}'][data-status=closed]")
    page.locator(f"li[data-day='{day}']").get_by_role("button", name="Open again").click()
    page.wait_for_selector(f"li[data-day='{day}'][data-status=open]")
    events = require(served.admin.get(f"/v1/meals/{meal}/events"))["items"]
    assert [event["new"]["text"] for event in events if event["kind"] == "answer"] == ["No"]


def reopen_before_the_answer(page, pattern, act):
    """The server carries out a call, but the page ends before it has the answer, and is opened again."""

    def lose_the_answer(route):
        with suppress(Error):  # of a repetition whose page has ended meanwhile
            route.fetch()
            route.abort()

    page.route(pattern, lose_the_answer)
    with page.expect_event("requestfailed", lambda request: request.method == "POST"):
        act()
    address = page.url
    page.goto("about:blank")  # which ends the page's own repetitions of the call before they are let through
    page.unroute_all(behavior="wait")
    page.goto(address)


def test_joining_and_leaving_continue_on_the_page_opened_again_though_the_answers_were_lost(served, open_phone):
    require(served.admin.post("/v1/studies/capture/participants", json={"code": "P030"}))
    tab = open_phone(service_workers="block")  # a worker's requests cannot be routed
    tab.expect("ERR_FAILED|status of 410|Service Worker registration blocked")
    page, link = tab.page, capture_link(served, "P030")
    reopen_before_the_answer(page, "**/v1/enrolments", lambda: page.goto(link))
    expect(page.get_by_label("Code on the card")).to_have_value(link.partition("code=")[2])
    page.get_by_role("button", name="Join").click()
    page.get_by_text("Participant P030").wait_for()
    devices = require(served.admin.get("/v1/studies/capture/devices"))["items"]
    assert [device["participant"] for device in devices].count("P030") == 1
    page.get_by_role("link", name="This phone").click()
    page.once("dialog", lambda dialog: dialog.accept())
    leave = page.get_by_role("button", name="Leave the study for good")
    reopen_before_the_answer(page, "**/v1/me/withdrawal", leave.click)
    page.get_by_role("link", name="Meals").click()
    page.get_by_text("You have left the study. Nothing more is sent.").wait_for()
    receipt = page.get_by_text("Your receipt: ").inner_text().split()[-1]
    assert require(served.admin.get(f"/v1/receipts/{receipt}"))["what"] == "participant"


def test_large_photograph_continues_after_a_broken_line_and_a_reload(served, open_phone):
    require(served.admin.post("/v1/studies/capture/participants", json={"code": "P031"}))
    with lossy_line(served.address, share=0) as line:
        tab = open_phone(line.address)
        tab.expect(r"Failed to load resource: net::|status of 409.*/upload\)$")
        page = tab.page
        page.goto(capture_link(served, "P031").replace(served.address, line.address))
        photograph(page)
        digests = page.evaluate(DIGESTS)
        checked = line.photograph_bytes
        line.broken_bodies += [400_000, *[0] * 100]  # the page tries twice, then its queue waits; Chromium tries, too
        page.get_by_role("button", name="Send").click()
        page.wait_for_selector("li[data-state=waiting] .offline")
        line.broken_bodies.clear()
        page.reload()
        page.wait_for_selector("li[data-state=sent]")
        assert line.photograph_bytes - checked < sum(size for _, size in digests.values()) + 100_000
        images = served.meal(page.get_attribute("li[data-state=sent]", "data-meal"))["images"]
    received = {slot: (image["received_sha256"], image["durable"]) for slot, image in images.items()}
    assert received == {slot: (sha256, True) for slot, (sha256, _) in digests.items()}


def test_used_code_is_refused_and_a_meal_that_cannot_be_accepted_is_kept(served, open_phone):
    tab = open_phone()
    tab.expect("status of 409")
    link = capture_link(served)
    tab.page.goto(link)
    tab.page.get_by_role("button", name="Photograph a meal").wait_for()
    other = open_phone()
    other.expect("status of 404")
    other.page.goto(link)
    other.page.get_by_text("This code is not valid").wait_for()

    photograph(tab.page)
    tab.page.evaluate(  # a phone whose clock is years ahead
        """async () => {
      const store = await import("/capture/store.js");
      const [meal] = await store.meals();
      await store.changeMeal(meal.id, (meal) => { meal.captured_at = "2031-01-01T12:00:00Z"; });
    }"""
    )
    tab.page.get_by_role("button", name="Send").click()
    tab.page.get_by_text("The date or the time of this phone is wrong.").wait_for()
    kept = tab.page.evaluate(
        """async () => {
      const store = await import("/capture/store.js");
      const [meal] = await store.meals();
      return (await store.photograph(meal.id, "right")).bytes.byteLength;
    }"""
    )
    assert kept > 10_000


# Waits until the first try has failed, whose end sets the time of the next.
HOLD_FOR_AN_HOUR = """async () => {
  const store = await import("/capture/store.js");
  const only = async () => (await store.meals())[0];
  while (!(await only()).tries) await new Promise((done) => setTimeout(done, 50));
  const now = Date.now();
  await store.changeMeal((await only()).id, (record) => {
    Object.assign(record, { waited_from_ms: now, next_try_ms: now + 3_600_000 });
  });
}"""


def test_meal_of_another_participant_of_the_phone_is_not_sent_as_one_of_this_one(served, open_phone):
    require(served.admin.post("/v1/studies/capture/participants", json={"code": "P009"}))
    tab = open_phone()
    page = enrolled(served, tab)
    photograph(page)
    page.evaluate("navigator.serviceWorker.ready.then(() => true)")
    page.context.set_offline(True)
    tab.expect("ERR_INTERNET_DISCONNECTED")
    page.get_by_role("button", name="Send").click()
    page.wait_for_selector("li[data-state=waiting]")
    page.evaluate(HOLD_FOR_AN_HOUR)  # else it might be sent before the other person comes
    page.context.set_offline(False)
    page.goto("about:blank")
    page.once("dialog", lambda dialog: dialog.dismiss())
    page.goto(capture_link(served, "P009"))
    page.get_by_text("Participant P001").wait_for()
    page.goto("about:blank")
    tab.expect("status of 404")
    page.once("dialog", lambda dialog: dialog.accept())
    page.goto(f"{served.address}/capture/#code=wrong")
    page.get_by_text("This code is not valid").wait_for()
    page.get_by_role("link", name="Meals").click()
    page.get_by_text("Participant P001").wait_for()  # a wrong code ends no enrolment
    page.goto("about:blank")
    page.once("dialog", lambda dialog: dialog.accept())
    page.goto(capture_link(served, "P009"))
    page.get_by_text("Participant P009").wait_for()
    page.get_by_text("Belongs to another participant").wait_for()
    listed = served.admin.get("/v1/meals", params={"study": "capture", "participant": "P009"}).json()["items"]
    assert listed == []


def test_meal_is_followed_again_after_the_server_was_away(served, open_phone):
    tab = open_phone()
    tab.expect("ERR_(CONNECTION|EMPTY|INCOMPLETE)")
    page, meal = tab.page, sent_meal(served, tab)
    page.click(f"li[data-meal='{meal}'] a")
    page.get_by_text("Waiting to be measured").wait_for()
    served.server.kill()
    page.get_by_text("This needs a network connection.").wait_for(timeout=90_000)
    estimates.save(served, meal, identified_item({"apple": 0.9}))
    served.server.start()
    served.server.wait_until_ready()
    page.get_by_role("button", name="That is right").wait_for(timeout=90_000)
    expect(page.get_by_text("This needs a network connection.")).to_have_count(0)


def test_meal_whose_erasure_was_not_answered_is_gone_all_the_same(served, open_phone):
    tab = open_phone(service_workers="block")  # a worker's requests cannot be routed
    tab.expect("ERR_FAILED|status of 410|Service Worker registration blocked")
    page, meal = tab.page, sent_meal(served, tab)
    estimates.save(served, meal, identified_item({"apple": 0.9}))
    page.click(f"li[data-meal='{meal}'] a")
    page.get_by_role("button", name="Photograph what is left").click()
    first_photograph(page)
    page.goto(f"{served.address}/capture/#meal/{meal}")
    lost = []

    def lose_the_first_answer(route):
        if route.request.method != "DELETE" or lost:
            return route.fallback()
        lost.append(route.fetch().status)
        return route.abort()

    page.once("dialog", lambda dialog: dialog.accept())
    page.route("**/v1/meals/*", lose_the_first_answer)
    page.get_by_role("button", name="Erase this meal").click()
    page.get_by_role("button", name="Photograph a meal").wait_for()
    expect(page.locator(f"li[data-meal='{meal}']")).to_have_count(0)
    assert served.admin.get(f"/v1/meals/{meal}").status_code == 404
    assert lost == [200]
    assert page.evaluate(KEPT, meal) == [[], False]


def test_pages_are_accessible_in_light_and_dark_and_their_targets_are_large(served, open_phone):
    tab = open_phone(reduced_motion="reduce")
    page = tab.page

    def look():
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            require_accessible(page)

    tab.goto("/capture/")
    page.get_by_role("button", name="Scan the card").wait_for()
    look()
    enrolled(served, tab)
    look()
    page.get_by_role("button", name="Photograph a meal").click()
    page.get_by_role("button", name="Take the photograph").wait_for()
    look()
    both_photographs(page)
    look()
    meal = send(page)
    open_estimated(served, page, meal)
    page.get_by_text("Correct it").click()
    page.wait_for_selector("svg .food")
    look()
    page.get_by_role("link", name="This phone").click()
    page.get_by_role("button", name="Leave the study for good").wait_for()
    look()
