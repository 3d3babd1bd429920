"""Participants' pages: list, diary with the API's figures, a day's status, profile, withdrawal, group tables."""

import html
import re

import pytest

from app.nutrition.components import HEADLINE_COLUMNS
from tests.integration.dashboard.conftest import figures_of, text_of
from tests.integration.diary.eaten_days import add_meal, close, eaten_item, set_profile

DAYS = ("2026-11-01", "2026-11-02", "2026-11-03", "2026-11-04")
PARTICIPANTS = "/dashboard/studies/pilot/participants"
PATH = f"{PARTICIPANTS}/P001"


@pytest.fixture
def eaten(phone, state):
    """Four days with two items each, three of them closed; a profile."""
    for number, day in enumerate(DAYS):
        amounts = {column: 10.0 + number + place / 7 for place, column in enumerate(HEADLINE_COLUMNS)}
        add_meal(state, "P001", day, eaten_item(100.0 + number, **amounts), eaten_item(50.5, **amounts))
    close(phone, *DAYS[:3])
    set_profile(state, sex="female", birth_year=1990, weight_kg=60.0)
    return phone


def codes_of(client, admin):
    return [row["code"] for row in client.get("/v1/studies/pilot/participants", headers=admin).json()["items"]]


def article(page, day):
    return re.search(rf'<article class="day" id="day-{day}".*?</article>', page, re.DOTALL)[0]


def test_every_figure_of_the_diary_is_the_exports_and_the_comparison_the_feedbacks(client, admin, eaten, enrol, viewer):
    page = viewer.page(PATH)
    rows = client.get("/v1/days", headers=admin, params={"study": "pilot", "participant": "P001"}).json()["items"]
    assert len(rows) == len(DAYS)
    for row in rows:
        shown = figures_of(article(page, row["local_date"]))
        told = [row["energy_kcal"], row["consumed_g"]]
        meals = [row["energy_kcal"], row["consumed_g"]]  # one meal a day
        table = [value for column in HEADLINE_COLUMNS for value in (row[column], row[f"{column}_coverage"])]
        assert shown == pytest.approx([*told, *meals, *table, row["median_upload_delay_seconds"]])
    told = client.get("/v1/studies/pilot/participants/P001/summary", headers=admin).json()["comparison"]["components"]
    assert told
    compared = figures_of(page[page.index('id="compared"') :])
    for found in told.values():
        assert {found["mean"], found["reference"]} <= set(compared)
    enrol("X9", study="other")
    assert viewer.get(f"{PARTICIPANTS}/X9").status_code == 404, "of another study"


def file_of(viewer, page, name):
    """The file that a page offers, and its address."""
    address = html.unescape(re.search(rf'href="(/dashboard/studies/pilot/files/{name}\?[^"]+)"', page)[1])
    file = viewer.get(address)
    assert re.fullmatch(rf'attachment; filename="pilot_{name}[0-9_-]*\.csv"', file.headers["content-disposition"])
    return file.content, address.replace("/dashboard/studies/pilot/files", "/v1/studies/pilot")


def test_intakes_and_adequacy_are_those_of_the_api_and_of_its_files(client, admin, eaten, viewer):
    page = viewer.page("/dashboard/studies/pilot/intakes", **{"from": "2026-01-01"})
    (told,) = client.get("/v1/studies/pilot/intakes", headers=admin).json()["items"]
    shown = figures_of(page)
    assert shown[:3] == [told["closed_days"], told["open_days"], told["silent_days"]]
    assert shown[3:] == [told["components"][column]["mean"] for column in HEADLINE_COLUMNS]
    file, address = file_of(viewer, page, "intakes")
    assert "from=2026-01-01" in address
    assert (file, file[:12]) == (client.get(address, headers=admin).content, b"participant,")
    path, asked = "/dashboard/studies/pilot/adequacy", {"component": "VITC", "from": "2026-01-01"}
    page = viewer.page(path, **asked)
    file, address = file_of(viewer, page, "adequacy")
    assert "from=2026-01-01" in address
    assert (file, file[:11]) == (client.get(address, headers=admin).content, b"life_stage,")
    assert "Vitamin C" in page
    assert "<table" not in page, "its figures are loaded after the page"
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


def test_reviewer_closes_a_day_unless_it_changed_meanwhile(client, admin, eaten, sign_in_browser):
    reviewer = sign_in_browser("rita", pilot="reviewer")
    day = DAYS[3]
    form = dict(re.findall(r'name="(\w+)" value="([^"]*)"', article(reviewer.page(PATH), day)))
    assert form["status"] == "closed"
    address = f"{PATH}/days/{day}"
    close(eaten, day)
    assert reviewer.post(address, **form).status_code == 412, "the participant closed it since"
    form["version"] = "1"
    form["status"] = "open"
    assert reviewer.post(address, **form).status_code == 303
    assert "by a reviewer" in article(reviewer.page(PATH), day)
    assert "Close the day" not in sign_in_browser("vera", pilot="viewer").page(PATH)


def test_owner_adds_many_and_codes_of_present_and_former_participants_are_listed(client, admin, enrol, sign_in_browser):
    for code in ("P001", "P009"):
        enrol(code)
    erase = {"withdrawal_policy": "erase"}
    assert client.patch("/v1/studies/pilot", headers=admin | {"If-Match": "*"}, json=erase).status_code == 200
    assert client.post("/v1/studies/pilot/participants/P009/withdrawal", headers=admin).status_code == 200
    owner = sign_in_browser("olga", pilot="owner")
    answer = owner.post(PARTICIPANTS, codes="P001, P002;P003\r\nP004\tP002,P009")
    assert answer.status_code == 409
    page = text_of(answer.text)
    assert "3 participants were added." in page
    assert "the study has them already: P001." in page
    assert "participants who left the study had these codes: P009." in page
    assert codes_of(client, admin) == ["P001", "P002", "P003", "P004"]
    assert owner.post(PARTICIPANTS, codes="P005").status_code == 201


def test_range_adds_its_participants_and_their_cards_follow_from_there(client, admin, enrol, sign_in_browser):
    enrol()
    owner = sign_in_browser("olga", pilot="owner")
    page = owner.post(PARTICIPANTS, codes="T001-T003, T-009").text
    assert codes_of(client, admin) == ["P001", "T-009", "T001", "T002", "T003"]
    (codes,) = re.findall(r'name="participants" value="([^"]+)"', page)
    cards = owner.post("/dashboard/studies/pilot/enrol", participants=codes).text
    assert re.findall(r'aria-label="Card of ([^"]+)"', cards) == ["T001", "T002", "T003", "T-009"]
    assert cards.count("<svg") == 4  # one code each: the study has no app


def test_range_without_leading_zeros_or_backwards_is_no_code_of_one_person(client, admin, enrol, sign_in_browser):
    enrol()
    owner = sign_in_browser("olga", pilot="owner")
    owner.post(PARTICIPANTS, codes="A8-A11, B003-B001")
    assert codes_of(client, admin) == ["A10", "A11", "A8", "A9", "B001", "B002", "B003", "P001"]


def test_invalid_code_adds_nobody_and_keeps_the_text(client, admin, enrol, sign_in_browser):
    enrol()
    owner = sign_in_browser("olga", pilot="owner")
    rule = "letters A-Z, digits, - and _ only, beginning with a letter or digit"
    for asked, said in (
        ("P002\nP003 P004", f"P003 P004: {rule}; no blanks"),
        ("P002, Müller, _P3", f"Müller: {rule} _P3: letters"),
        ("P002\n<b>x</b>", "&lt;b&gt;x&lt;/b&gt;: letters A-Z, digits"),
        ("P002, " + "P" * 65, "P" * 65 + ": 64 characters at most"),
        (" ,; ", "Name one to 500 participants; these are 0."),
        (",".join(f"Q{number}" for number in range(501)), "Name one to 500 participants; these are 501."),
    ):
        answer = owner.post(PARTICIPANTS, codes=asked)
        assert answer.status_code == 422
        assert said in text_of(answer.text)
        assert f">\n{html.escape(asked.strip())}</textarea>" in answer.text
    assert codes_of(client, admin) == ["P001"]


def test_profile_keeps_filled_fields_and_loses_emptied_ones(client, admin, eaten, sign_in_browser):
    owner = sign_in_browser("olga", pilot="owner")
    filled = {"sex": "male", "birth_year": "1980", "height_cm": "170,5", "starts_on": "2026-10-31"}
    assert owner.post(f"{PATH}/profile", **filled).status_code == 303
    told = client.get("/v1/studies/pilot/participants/P001", headers=admin).json()
    assert told["profile"]["sex"] == "male"
    assert (told["profile"]["height_cm"], told["profile"]["weight_kg"]) == (170.5, None)
    assert told["starts_on"] == "2026-10-31"
    assert owner.post(f"{PATH}/profile", birth_year="1700").status_code == 422
    assert "day 2" in text_of(article(owner.page(PATH), DAYS[0]))


def test_participant_is_withdrawn_only_if_the_code_is_entered(eaten, sign_in_browser):
    owner = sign_in_browser("olga", pilot="owner")
    answer = owner.post(f"{PATH}/withdrawal", code="P01")
    assert answer.status_code == 422
    assert "“P01” is not the code P001: nobody was withdrawn." in text_of(answer.text)
    assert re.search(r"<details open>\s*<summary>Leaving the study", answer.text)
    assert eaten.get("/v1/me").status_code == 200
    assert owner.post(f"{PATH}/withdrawal", code="P001").status_code == 303
    assert eaten.get("/v1/me").status_code == 410
