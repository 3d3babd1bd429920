"""/v1/me/reminders: a phone's reminders by Web Push. /v1/studies/{study}/reminders: staff remind participants."""

from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, FastAPI, Response
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue

from app.core.settings import Settings
from app.dashboard.forms import Fields, read_form
from app.dashboard.page import CurrentPage
from app.extras.reminders import subscriptions
from app.extras.reminders.remind_now import RemindedOut, remind_now
from app.extras.reminders.subscriptions import Reminders, ReminderSettings
from app.extras.reminders.web_push import VapidKey, bytes_of, is_receiver
from app.http.closed_model import ClosedModel
from app.http.parameters import StudyCode
from app.http.problems import problem_responses
from app.http.text_schemas import Text
from app.meals.stored.meal_time import require_zone
from app.people.access.access_rules import DEVICE, REVIEWER, rules_of
from app.people.access.deps import CurrentDevice, CurrentStaff, State
from app.people.access.page_rules import STUDY_PAGES, study_address
from app.people.access.secret_box import SecretBox
from app.people.schemas import ClockTime, Code, ReminderTimes
from app.people.studies_api import clock, minutes_of
from app.webhooks.safe_address import parse_target

router = APIRouter(
    prefix="/v1/me/reminders", tags=["me"], responses=problem_responses(401, 403, 410)
)
of_staff = APIRouter(tags=["participants"])

CALLS = {
    "GET /v1/me/reminders": DEVICE,
    "PUT /v1/me/reminders": DEVICE,
    "DELETE /v1/me/reminders": DEVICE,
    "POST /v1/studies/{study}/reminders": REVIEWER,
}
PAGE = f"{STUDY_PAGES}/reminders"
# of the examples
BROWSER_KEY = (
    "BCVxsr7N_eNgVRqvHtD0zTZsEc6-VV-JvLexhqUzORcxaOzi6-AYWXvTBHm4bjyPjs7Vd8pZGH6SRpkNtoIAiw4"
)
SERVER_KEY = (
    "BP4z9KsN6nGRTbVYI_c7VJSPQTBtkgcy27mlmlMoZIIgDll6e3vCYLocInmYWAmS6TlzAC8wEqKK6PBru3jl7A8"
)
EXAMPLE: dict[str, JsonValue] = {
    "times": ["12:30", "18:30"],
    "after_meal": True,
    "time_zone": "Europe/Berlin",
    "quiet_from": "22:00",
    "quiet_until": "07:00",
}


def install(app: FastAPI) -> None:
    """Add the routes to an app; a worker sends (send_reminders.py)."""
    app.state.rules |= rules_of(CALLS)
    app.state.rules["POST", PAGE] = replace(REVIEWER, session=True, page=True)
    app.state.features.append("reminders")
    app.include_router(router)
    app.include_router(of_staff)


class PushKeys(BaseModel):
    """A browser's keys, base64url, as `PushSubscription.toJSON()` gives them."""

    p256dh: str = Field(max_length=100, description="Its public key.")
    auth: str = Field(max_length=40, description="Its shared secret.")


def _require_receiver(keys: PushKeys) -> PushKeys:
    if not is_receiver(bytes_of(keys.p256dh), bytes_of(keys.auth)):
        raise ValueError("These are no keys of a subscription.")
    return keys


class SubscriptionIn(BaseModel):
    """A browser's subscription, as `PushSubscription.toJSON()` gives it."""

    endpoint: Text = Field(
        max_length=500, description="Address at the browser's push service, https."
    )
    keys: Annotated[PushKeys, AfterValidator(_require_receiver)] = Field(
        description="By which messages are encrypted."
    )


class RemindersIn(ClosedModel):
    """The times at which this phone asks for reminders, and the subscription to send them to."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "subscription": {
                    "endpoint": "https://push.example.org/send/abc",
                    "keys": {"p256dh": BROWSER_KEY, "auth": "BTBZMqHH6r4Tts7J_aSIgg"},
                },
                **EXAMPLE,
            }
        },
    )

    subscription: SubscriptionIn = Field(description="Where reminders are sent.")
    times: ReminderTimes | None = Field(
        default=None, description="The participant's own times; null: the study's."
    )
    after_meal: bool = Field(
        default=True, description="Whether to remind of what is left of a meal."
    )
    time_zone: Text = Field(
        max_length=64, description="IANA name of the phone's time zone, such as Asia/Shanghai."
    )
    quiet_from: ClockTime = Field(
        default="22:00", description="HH:MM: from then on no reminder but at own times."
    )
    quiet_until: ClockTime = Field(
        default="07:00", description="HH:MM: until then. Equal to `quiet_from`: never quiet."
    )


class RemindersOut(BaseModel):
    """This phone's reminders, and what the server and the study offer."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "available": True,
                "public_key": SERVER_KEY,
                "study_times": ["12:30"],
                "subscribed": True,
                **EXAMPLE,
            }
        }
    )

    available: bool = Field(description="Whether this server sends reminders.")
    public_key: str | None = Field(
        description="The server's key, for `applicationServerKey`; null: not available."
    )
    study_times: list[str] = Field(description="The study's times, HH:MM.")
    subscribed: bool = Field(description="Whether this phone is reminded.")
    times: list[str] | None = Field(description="The participant's own times; null: the study's.")
    after_meal: bool | None = Field(
        description="Whether it is reminded of what is left; null: not subscribed."
    )
    time_zone: str | None = Field(description="In which its times are meant; null: not subscribed.")
    quiet_from: str | None = Field(description="HH:MM; null: not subscribed.")
    quiet_until: str | None = Field(description="HH:MM; null: not subscribed.")


class RemindIn(ClosedModel):
    """Participants to remind now."""

    model_config = ConfigDict(json_schema_extra={"example": {"participants": ["P001"]}})

    participants: list[Code] = Field(
        min_length=1, max_length=500, description="Participants' codes."
    )


@of_staff.post(
    "/v1/studies/{study}/reminders", responses=problem_responses(401, 403, 404, 409, 422)
)
def post_reminders(
    study: StudyCode, body: RemindIn, state: State, caller: CurrentStaff
) -> RemindedOut:
    """Remind participants of their meals now."""
    is_on = state.settings.push_contact is not None
    return remind_now(state.database, caller, study, body.participants, is_on=is_on)


@of_staff.post(PAGE, include_in_schema=False)
def post_reminders_page(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Remind the participants who are marked, and tell who was not reached."""
    body = read_form(RemindIn, {"participants": fields.getlist("participant")})
    reminders = post_reminders(study, body, page.state, page.caller)
    notice = f"{len(reminders.reminded)} of {len(body.participants)} participants are reminded."
    if reminders.unreached:
        notice += " No phone of the others wants reminders, or it has quiet hours now."
    query = page.request.url.query
    return page.redirect(f"{study_address(study, 'participants')}?{query}", notice)


@router.get("")
def get_reminders(state: State, caller: CurrentDevice) -> RemindersOut:
    """Return this phone's reminders, and the server's key to subscribe with."""
    return _render(
        state.settings, state.part(SecretBox), subscriptions.read_reminders(state.database, caller)
    )


@router.put("", responses=problem_responses(409, 422))
def put_reminders(body: RemindersIn, state: State, caller: CurrentDevice) -> RemindersOut:
    """Subscribe this phone to reminders, or change when it wants them."""
    require_zone(body.time_zone)
    parse_target(body.subscription.endpoint, allow_loopback=state.settings.webhook_allow_loopback)
    keys = body.subscription.keys
    wanted = ReminderSettings(
        endpoint=body.subscription.endpoint,
        public_key=keys.p256dh,
        auth=keys.auth,
        times=body.times,
        after_meal=body.after_meal,
        time_zone=body.time_zone,
        quiet_from_minutes=minutes_of(body.quiet_from),
        quiet_until_minutes=minutes_of(body.quiet_until),
    )
    is_on = state.settings.push_contact is not None
    reminders = subscriptions.subscribe(state.database, caller, wanted, is_on=is_on)
    return _render(state.settings, state.part(SecretBox), reminders)


@router.delete("", status_code=204)
def delete_reminders(state: State, caller: CurrentDevice) -> Response:
    """Stop reminding this phone."""
    subscriptions.unsubscribe(state.database, caller)
    return Response(status_code=204)


def _render(settings: Settings, box: SecretBox, reminders: Reminders) -> RemindersOut:
    row, is_on = reminders.subscription, settings.push_contact is not None
    return RemindersOut(
        available=is_on,
        public_key=VapidKey(box).public_key if is_on else None,
        study_times=reminders.study_times,
        subscribed=row is not None,
        times=row.times if row is not None else None,
        after_meal=row.after_meal if row is not None else None,
        time_zone=row.time_zone if row is not None else None,
        quiet_from=clock(row.quiet_from_minutes) if row is not None else None,
        quiet_until=clock(row.quiet_until_minutes) if row is not None else None,
    )
