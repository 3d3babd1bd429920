"""Reminders of the capture page: turned on and off, shown, and renewed when phone, browser or server have changed."""

import json

import httpx2
import pytest

from app.extras.reminders.web_push import text_of
from app.people.models import PushSubscription
from tests.e2e.capture.capture_page import capture_link, enrolled, require_accessible
from tests.e2e.dashboard_server import require
from tests.support.push_services import Browser
from tests.support.waiting import PATIENCE_SECONDS, wait_until

PATH = "/v1/me/reminders"
ENDPOINT = "https://push.example.org/send/a"
# Chromium has no push service of its own: subscriptions of the page and of its service worker, as Chromium's are.
PUSH_SERVICE = """([endpoint, p256dh, auth]) => {
  globalThis.endpoint = endpoint;
  let subscription = null;
  Object.defineProperty(Notification, "permission", { get: () => "granted" });
  Notification.requestPermission = async () => "granted";
  PushManager.prototype.subscribe = async ({ applicationServerKey }) => {
    const isOfAnotherKey = subscription !== null && applicationServerKey !== globalThis.pushKey;
    if (isOfAnotherKey) throw new DOMException("", "InvalidStateError");
    globalThis.pushKey = applicationServerKey;
    const { endpoint } = globalThis;
    return subscription ??= {
      endpoint,
      toJSON: () => ({ endpoint, keys: { p256dh, auth } }),
      unsubscribe: async () => {
        subscription = null;
        globalThis.endpoint += "-again";
      },
    };
  };
  PushManager.prototype.getSubscription = async () => subscription;
}"""
CHANGED_SUBSCRIPTION = """async () => {
  const event = new Event("pushsubscriptionchange");
  const done = new Promise((resolve) => { event.waitUntil = resolve; });
  dispatchEvent(event);
  await done;
}"""
NOTIFICATIONS = """async () => {
  const registration = await navigator.serviceWorker.ready;
  const shown = await registration.getNotifications();
  return shown.map(({ title, body, tag, data }) => ({ title, body, tag, address: data.address }));
}"""

RENEWED = """async (times) => {
  const { renewReminders } = await import("/capture/reminders.js");
  const registration = await navigator.serviceWorker.ready;
  await Promise.all(Array.from({ length: times }, () => renewReminders(registration)));
}"""
DELETE_UNANSWERED = """() => {
  const send = window.fetch;
  window.fetch = async (address, options) => {
    const answer = await send(address, options);
    return options?.method === "DELETE" ? new Promise(() => {}) : answer;
  };
}"""
IS_SUBSCRIBED = """() => navigator.serviceWorker.ready
  .then(({ pushManager }) => pushManager.getSubscription()).then((subscription) => subscription !== null)"""
OPENED_AGAIN = 'document.dispatchEvent(new Event("visibilitychange"))'


def reminded_phone(served, open_phone):
    """A phone whose reminders were just turned on, on the page This phone."""
    receiver = Browser().receiver
    page = enrolled(served, open_phone(permissions=["camera", "notifications"]))
    page.evaluate("navigator.serviceWorker.ready.then(() => true)")
    push_service = ENDPOINT, text_of(receiver.public_key), text_of(receiver.auth)
    page.evaluate(PUSH_SERVICE, push_service)
    page.context.add_init_script(f"({PUSH_SERVICE})({json.dumps(push_service)})")
    service_worker(page).evaluate(PUSH_SERVICE, push_service)
    page.get_by_role("link", name="This phone").click()
    page.get_by_role("button", name="Remind me", exact=True).click()
    page.get_by_text("Saved.").wait_for()
    return page


def service_worker(page):
    """Return the page's only service worker; the browser may tell of it after it has begun."""
    workers = page.context.service_workers or [page.context.wait_for_event("serviceworker")]
    (worker,) = workers
    return worker


def token_of(page):
    return page.evaluate('import("/capture/store.js").then((store) => store.phone()).then((phone) => phone.token)')


def reminders_of(served, page):
    """The reminders of this phone as the server has them."""
    headers = {"Authorization": f"Bearer {token_of(page)}"}
    return require(httpx2.get(f"{served.address}{PATH}", headers=headers, timeout=PATIENCE_SECONDS))


def forget_subscriptions(served):
    with served.database.write() as session:
        session.query(PushSubscription).delete()


def only_subscription(served):
    """The server's only subscription, or None."""
    with served.database.read() as session:
        return session.query(PushSubscription).one_or_none()


def wait_for_subscription(served, **values):
    """Wait until the server's only subscription has these values."""

    def has_values():
        row = only_subscription(served)
        return row is not None and all(getattr(row, name) == value for name, value in values.items())

    wait_until(has_values, f"a subscription with {values}")


@pytest.mark.slow
def test_reminders_are_turned_on_set_shown_and_turned_off(served, open_phone):
    page = reminded_phone(served, open_phone)
    page.get_by_label("Time 1").fill("12:15")
    page.get_by_label("Time 2").fill("18:45")
    page.get_by_role("button", name="Save").click()
    page.get_by_text("Saved.").wait_for()
    require_accessible(page)
    reminders = reminders_of(served, page)
    assert (reminders["subscribed"], reminders["times"], reminders["after_meal"]) == (True, ["12:15", "18:45"], True)
    assert page.evaluate("window.pushKey") == reminders["public_key"]

    worker = page.context.new_cdp_session(page)
    registrations = []
    worker.on("ServiceWorker.workerRegistrationUpdated", lambda event: registrations.extend(event["registrations"]))
    worker.send("ServiceWorker.enable")
    wait_until(lambda: page.evaluate("true") and registrations, "the service worker's registration")
    message = {"origin": served.address, "registrationId": registrations[0]["registrationId"]}
    served.server.kill()  # the message comes from the push service, also while the server is away
    worker.send("ServiceWorker.deliverPushMessage", message | {"data": '{"kind": "after_meal"}'})
    wait_until(lambda: page.evaluate(NOTIFICATIONS), "a notification")
    served.server.start()
    served.server.wait_until_ready()
    (notification,) = page.evaluate(NOTIFICATIONS)
    assert notification["body"].startswith("Please photograph what is left")
    assert (notification["tag"], notification["address"]) == ("after_meal", "#meals")

    page.get_by_role("button", name="Remind me no more").click()
    page.get_by_role("button", name="Remind me", exact=True).wait_for()
    assert reminders_of(served, page)["subscribed"] is False
    page.reload()  # nothing is renewed
    page.get_by_role("button", name="Remind me", exact=True).wait_for()
    assert reminders_of(served, page)["subscribed"] is False


@pytest.fixture(autouse=True)
def _no_subscription_of_another_test(served):
    yield
    forget_subscriptions(served)


@pytest.mark.slow
def test_time_zone_of_a_journey_is_sent_when_the_page_is_opened(served, open_phone):
    page = reminded_phone(served, open_phone)
    page.get_by_label("Time 1").fill("12:15")
    page.get_by_label("Time 2").fill("")
    page.get_by_role("button", name="Save").click()
    wait_for_subscription(served, times=["12:15"])
    page.context.new_cdp_session(page).send("Emulation.setTimezoneOverride", {"timezoneId": "Asia/Shanghai"})
    page.reload()
    wait_for_subscription(served, time_zone="Asia/Shanghai", times=["12:15"])


def test_service_worker_sends_the_browser_s_new_subscription(served, open_phone):
    page = reminded_phone(served, open_phone)
    worker = service_worker(page)
    worker.evaluate(f'endpoint = "{ENDPOINT}-new"')
    worker.evaluate(CHANGED_SUBSCRIPTION)
    assert only_subscription(served).endpoint == f"{ENDPOINT}-new"


@pytest.mark.slow
def test_subscription_that_the_server_gave_up_or_has_another_key_for_is_replaced_with_its_wishes(served, open_phone):
    page = reminded_phone(served, open_phone)
    page.get_by_label("Time 1").fill("12:15")
    page.get_by_label("Not from").fill("21:30")
    page.get_by_role("button", name="Save").click()
    page.get_by_text("Saved.").wait_for()
    assert only_subscription(served).quiet_from_minutes == 21 * 60 + 30
    forget_subscriptions(served)
    page.evaluate(OPENED_AGAIN)
    wishes = {"times": ["12:15"], "quiet_from_minutes": 21 * 60 + 30}
    wait_for_subscription(served, endpoint=f"{ENDPOINT}-again", **wishes)
    page.evaluate('pushKey = "of the former secret key"')
    page.evaluate(OPENED_AGAIN)
    wait_for_subscription(served, endpoint=f"{ENDPOINT}-again-again", **wishes)
    assert page.evaluate("pushKey") == reminders_of(served, page)["public_key"]


@pytest.mark.slow
def test_nothing_is_sent_again_while_nothing_has_changed_and_once_by_two_renewals_at_once(served, open_phone):
    page = reminded_phone(served, open_phone)
    calls = []
    page.on("requestfinished", lambda request: calls.append(request.method) if PATH in request.url else None)
    page.evaluate(OPENED_AGAIN)
    page.evaluate(OPENED_AGAIN)
    wait_until(lambda: page.evaluate("true") and calls.count("GET") >= 2, "the page to ask twice")
    page.wait_for_load_state("networkidle")
    assert set(calls) == {"GET"}
    forget_subscriptions(served)
    page.evaluate(RENEWED, 2)
    wait_until(lambda: page.evaluate("true") and "PUT" in calls, "the subscription to be sent")
    page.wait_for_load_state("networkidle")
    assert calls.count("PUT") == 1
    assert only_subscription(served).endpoint == f"{ENDPOINT}-again"


@pytest.mark.slow
def test_person_who_left_is_not_subscribed_again_though_the_page_ended_before_the_answer(served, open_phone):
    page = reminded_phone(served, open_phone)
    page.evaluate(DELETE_UNANSWERED)
    page.get_by_role("link", name="Meals").click()
    page.get_by_role("link", name="This phone").click()  # whose client fetches by the changed function
    with page.expect_response(lambda response: response.request.method == "DELETE"):
        page.get_by_role("button", name="Remind me no more").click()
    page.reload()
    page.get_by_role("button", name="Remind me", exact=True).wait_for()
    page.evaluate(RENEWED, 1)
    assert only_subscription(served) is None


@pytest.mark.slow
def test_subscription_ends_when_somebody_else_joins_and_when_the_person_signs_out(served, open_phone):
    require(served.admin.post("/v1/studies/capture/participants", json={"code": "P050"}))
    page = reminded_phone(served, open_phone)
    page.on("dialog", lambda dialog: dialog.accept())
    page.goto(capture_link(served, "P050"))
    page.get_by_text("Participant P050").wait_for()
    assert not page.evaluate(IS_SUBSCRIBED)

    page.get_by_role("link", name="This phone").click()
    page.get_by_role("button", name="Remind me", exact=True).click()
    page.get_by_text("Saved.").wait_for()
    assert page.evaluate(IS_SUBSCRIBED)
    page.get_by_role("button", name="Sign this phone out").click()
    page.get_by_role("heading", name="Join the study").wait_for()
    assert not page.evaluate(IS_SUBSCRIBED)
