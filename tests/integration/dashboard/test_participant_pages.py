"""Participants' pages: list, diary with the API's figures, a day's status, profile, withdrawal, group tables."""

import html
import re

import pytest

from app.meals.record_models import HEADLINE_COLUMNS
from tests.integration.dashboard.conftest import figures_of, text_of
from tests.integration.diary.eaten_days import add_meal, eaten_item, set_profile

DAYS = ("2026-11-01", "2026-11-02", "2026-11-03", "2026-11-04")
PARTICIPANTS = "/dashboard/studies/pilot/participants"
PATH = f"{PARTICIPANTS}/P001"


@pytest.fixture
def eaten(phone, state):
    """Four days with two items each, three of them closed; a profile."""
    for number, day in enumerate(DAYS):
        amounts = {column: 10.0 + number + place / 7 for place, column in enumerate(HEADLINE_COLUMNS)}
        add_meal(state, "P001", day, eaten_item(100.0 + number, **amounts), eaten_item(50.5, **amounts))
    for day in DAYS[:3]:
        answer = phone.put(f"/v1/me/days/{day}", json={"status": "closed"}, headers={"If-Match": "*"})
        assert answer.status_code == 200
    set_profile(state, sex="female", birth_year=1990, weight_kg=60.0)
    return phone


def codes_of(client, admin):
    return [row["code"] for row in client.get("/v1/studies/pilot/participants", headers=admin).json()["items"]]


def article(page, day):
    return re.search(rf'<article class="day" id="day-{day}".*?</article>', page, re.DOTALL)[0]


def test_every_figure_of_the_diary_is_the_exports(client, admin, eaten, sign_in_browser):
    page = sign_in_browser("vera", pilot="viewer").page(PATH)
    rows = client.get("/v1/days", headers=admin, params={"study": "pilot", "participant": "P001"}).json()["items"]
    assert len(rows) == len(DAYS)
    for row in rows:
        shown = figures_of(article(page, row["local_date"]))
        told = [row["energy_kcal"], row["consumed_g"]]
        meals = [row["energy_kcal"], row["consumed_g"]]  # one meal a day
        table = [value for column in HEADLINE_COLUMNS for value in (row[column], row[f"{column}_coverage"])]
        assert shown == pytest.approx([*told, *meals, *table, row["median_upload_delay_seconds"]])


def test_comparison_equals_the_participants_feedback(client, admin, eaten, sign_in_browser):
    page = sign_in_browser("vera", pilot="viewer").page(PATH)
    told = client.get("/v1/studies/pilot/participants/P001/summary", headers=admin).json()["comparison"]["components"]
    assert told
    part = page[page.index('id="compared"') :]
    for found in told.values():
        assert found["mean"] in figures_of(part)
        assert found["reference"] in figures_of(part)


def test_intakes_of_the_page_are_those_of_the_api(client, admin, eaten, sign_in_browser):
    page = sign_in_browser("vera", pilot="viewer").page("/dashboard/studies/pilot/intakes")
    (told,) = client.get("/v1/studies/pilot/intakes", headers=admin).json()["items"]
    shown = figures_of(page)
    assert shown[:3] == [told["closed_days"], told["open_days"], told["silent_days"]]
    assert shown[3:] == [told["components"][column]["mean"] for column in HEADLINE_COLUMNS]


def test_adequacy_figures_are_the_apis_and_are_loaded_after_the_page(client, admin, eaten, sign_in_browser):
    viewer = sign_in_browser("vera", pilot="viewer")
    path, asked = "/dashboard/studies/pilot/adequacy", {"component": "VITC", "from": "2026-01-01"}
    page = viewer.page(path, **asked)
    assert "Vitamin C" in page
    assert "<table" not in page
    address = html.unescape(re.search(r'hx-get="([^"]+)" hx-trigger="load"', page)[1])
    assert f'<noscript><p><a href="{html.escape(address)}">' in page
    (told,) = client.get("/v1/studies/pilot/adequacy", headers=admin, params=asked).json()["groups"]
    part = viewer.get(address, headers={"HX-Request": "true"}).text
    whole = viewer.page(address)
    assert "<title" in whole
    assert "<title" not in part
    for shown in (part, whole):
        assert figures_of(shown) == [told["persons"], told["days"], told["days_left_out"], told["ear"]]
        assert "hx-get" not in shown
        assert f'title="{told["reason"]}"' in shown
        assert "female, 31 to 50" in shown


@pytest.mark.parametrize(
    ("asked", "code"),
    [
        ({"component": "GOLD"}, "component_unknown"),
        ({"from": "2026-11-02", "to": "2026-11-01"}, "days_reversed"),
    ],
)
@pytest.mark.parametrize("path", ["adequacy", "adequacy/figures"])
def test_adequacy_with_impossible_parameters_is_refused_by_the_page(eaten, sign_in_browser, path, asked, code):
    answer = sign_in_browser("vera", pilot="viewer").get(f"/dashboard/studies/pilot/{path}", **asked)
    assert answer.status_code == 422
    assert code in answer.text
    assert "hx-get" not in answer.text


def test_reviewer_closes_a_day_unless_it_changed_meanwhile(client, admin, eaten, sign_in_browser):
    reviewer = sign_in_browser("rita", pilot="reviewer")
    day = DAYS[3]
    form = dict(re.findall(r'name="(\w+)" value="([^"]*)"', article(reviewer.page(PATH), day)))
    assert form["status"] == "closed"
    address = f"{PATH}/days/{day}"
    assert eaten.put(f"/v1/me/days/{day}", json={"status": "closed"}, headers={"If-Match": "*"}).status_code == 200
    assert reviewer.post(address, **form).status_code == 412, "the participant closed it since"
    form["version"] = "1"
    form["status"] = "open"
    assert reviewer.post(address, **form).status_code == 303
    assert "by a reviewer" in article(reviewer.page(PATH), day)
    viewer = sign_in_browser("vera", pilot="viewer")
    assert "Close the day" not in viewer.page(PATH)
    assert viewer.post(address, **form).status_code == 403


def test_owner_adds_many_and_existing_codes_are_listed(client, admin, enrol, sign_in_browser):
    enrol()
    owner = sign_in_browser("olga", pilot="owner")
    answer = owner.post(PARTICIPANTS, codes="P001, P002;P003\r\nP004\tP002,")
    assert answer.status_code == 409
    page = text_of(answer.text)
    assert "3 participants were added." in page
    assert "the study has them already: P001." in page
    assert codes_of(client, admin) == ["P001", "P002", "P003", "P004"]
    assert owner.post(PARTICIPANTS, codes="P005").status_code == 303


def test_codes_of_withdrawn_participants_are_listed(client, admin, enrol, sign_in_browser):
    enrol()
    erase = {"withdrawal_policy": "erase"}
    assert client.patch("/v1/studies/pilot", headers=admin | {"If-Match": "*"}, json=erase).status_code == 200
    assert client.post("/v1/studies/pilot/participants/P001/withdrawal", headers=admin).status_code == 200
    owner = sign_in_browser("olga", pilot="owner")
    answer = owner.post(PARTICIPANTS, codes="P001, P002")
    assert answer.status_code == 409
    assert "participants who left the study had these codes: P001." in text_of(answer.text)
    assert codes_of(client, admin) == ["P002"]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (
            "P001, Anna Müller",
            "Anna Müller: letters A-Z, digits, - and _ only, beginning with a letter or digit; no bl",
        ),
        (
            "P002\nP003 P004",
            "P003 P004: letters A-Z, digits, - and _ only, beginning with a letter or digit; no blanks",
        ),
        (
            "P002, Müller, _P3",
            "Müller: letters A-Z, digits, - and _ only, beginning with a letter or digit _P3: letters",
        ),
        ("P002\n<b>x</b>", "&lt;b&gt;x&lt;/b&gt;: letters A-Z, digits"),
        ("P002, " + "P" * 65, "P" * 65 + ": 64 characters at most"),
        (" ,; ", "Name one to 500 participants; these are 0."),
        (",".join(f"Q{number}" for number in range(501)), "Name one to 500 participants; these are 501."),
    ],
    ids=["name", "blank", "letters", "markup", "long", "none", "many"],
)
def test_invalid_code_adds_nobody_and_keeps_the_text(client, admin, enrol, sign_in_browser, asked, said):
    enrol()
    answer = sign_in_browser("olga", pilot="owner").post(PARTICIPANTS, codes=asked)
    assert answer.status_code == 422
    assert said in text_of(answer.text)
    assert f">\n{html.escape(asked.strip())}</textarea>" in answer.text
    assert codes_of(client, admin) == ["P001"]


def test_profile_keeps_filled_fields_and_loses_emptied_ones(client, admin, eaten, sign_in_browser):
    owner = sign_in_browser("olga", pilot="owner")
    assert owner.post(f"{PATH}/profile", sex="male", birth_year="1980", starts_on="2026-10-31").status_code == 303
    told = client.get("/v1/studies/pilot/participants/P001", headers=admin).json()
    assert told["profile"]["sex"] == "male"
    assert told["profile"]["weight_kg"] is None
    assert told["starts_on"] == "2026-10-31"
    assert owner.post(f"{PATH}/profile", birth_year="1700").status_code == 422
    assert "day 2" in text_of(article(owner.page(PATH), DAYS[0]))


def test_participant_is_withdrawn_only_if_the_code_is_entered(eaten, sign_in_browser):
    owner = sign_in_browser("olga", pilot="owner")
    assert owner.post(f"{PATH}/withdrawal", code="P01").status_code == 422
    assert eaten.get("/v1/me").status_code == 200
    assert owner.post(f"{PATH}/withdrawal", code="P001").status_code == 303
    assert eaten.get("/v1/me").status_code == 410


def test_participant_of_another_study_is_not_found(enrol, eaten, sign_in_browser):
    enrol("X9", study="other")
    viewer = sign_in_browser("vera", pilot="viewer")
    assert viewer.get("/dashboard/studies/pilot/participants/X9").status_code == 404
    assert viewer.get("/dashboard/studies/other/participants/X9").status_code == 404
