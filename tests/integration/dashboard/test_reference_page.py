"""A study's days against days of another method that an owner uploads: figures by nutrient, and refusals by row."""

import csv
import io
import uuid
from functools import partial

import pytest
import sqlalchemy as sa

from app.core.errors import InvalidInputError
from app.diary.references.models import ReferenceDay
from app.diary.references.reference_days import read_reference, replace_reference
from app.people.access.caller import StaffCaller
from app.people.models import Staff, Study
from app.people.privacy_models import AuditEvent
from tests.integration.dashboard.conftest import BROWSER, figures_of, text_of
from tests.integration.diary.eaten_days import add_meal, close, eaten_item
from tests.integration.records.at_once import at_once

PAGE, STUDY = "/dashboard/studies/pilot/reference", "/v1/studies/pilot"
DAYS = ("2026-11-20", "2026-11-21")
OWN_KCAL = {"P001": (1500, 1700), "P002": (2100, 1900), "P003": (2500, 2300), "P004": (1800, 2200)}
REFERENCE_KCAL = {"P001": (1400, 1600), "P002": (2300, 2100), "P003": (2600, 2600), "P004": (1700, 1900)}


def put(client, headers, content):
    return client.put(
        f"{STUDY}/reference-days", headers=headers | {"Content-Type": "text/csv"}, content=content.encode()
    )


def upload(browser, content):
    cookies = "; ".join(f"{name}={value}" for name, value in browser.cookies.items())
    files = {"metadata": ("weighed.csv", content.encode(), "text/csv")}
    return browser.client.post(PAGE, headers=BROWSER | {"Cookie": cookies}, files=files, follow_redirects=False)


@pytest.fixture
def weighed(state, enrol):
    """Four participants of two closed days each; the reference of the same days as CSV."""
    lines = ["participant,local_date,energy_kcal,protein_g"]
    for code, amounts in OWN_KCAL.items():
        phone = enrol(code)
        for day, own, reference in zip(DAYS, amounts, REFERENCE_KCAL[code], strict=True):
            add_meal(state, code, day, eaten_item(energy_kcal=own / 3), eaten_item(energy_kcal=2 * own / 3))
            close(phone, day)
            lines.append(f"{code},{day},{reference},")
    return "\n".join(lines) + "\n"


def agreement(client, headers):
    return client.get(f"{STUDY}/reference-agreement", headers=headers).json()["items"]


@pytest.mark.both_stores
def test_figures_are_of_participants_means_over_the_days_of_both(state, client, admin, enrol, weighed):
    # a day without any own entry, one that is open, one whose protein nobody knows
    add_meal(state, "P001", "2026-11-22", eaten_item(energy_kcal=9000))
    others = "P001,2026-11-22,1,\nP002,2026-11-29,1,\nP003,2026-11-20,2600,70\n"
    weighed = weighed.replace("P003,2026-11-20,2600,\n", "")
    assert put(client, admin, weighed + others).status_code == 204
    energy, protein = agreement(client, admin)
    assert (energy["nutrient"], energy["participants"], energy["days"], energy["days_left_out"]) == (
        "energy_kcal",
        4,
        8,
        2,
    )
    # by numpy and scipy.stats (pearsonr, ttest_1samp), of the means 1600 2000 2400 2000 and 1500 2200 2600 1800
    assert energy["mean"] == pytest.approx(2000)
    assert energy["reference_mean"] == pytest.approx(2025)
    assert energy["bias"] == pytest.approx({"value": -25, "low": -353.0391, "high": 303.0391}, abs=1e-3)
    assert energy["lower"]["value"] == pytest.approx(-429.0644, abs=1e-3)
    assert energy["upper"]["value"] == pytest.approx(379.0644, abs=1e-3)
    assert energy["correlation"] == pytest.approx({"value": 0.938083, "low": -0.233731, "high": 0.998733}, abs=1e-5)
    assert (protein["participants"], protein["days_left_out"], protein["mean"], protein["bias"]) == (0, 1, None, None)


def test_page_shows_the_figures_of_the_api_and_offers_them_as_csv(client, admin, owner, weighed):
    assert "No reference" in text_of(owner.page(PAGE))
    answer = upload(owner, weighed)
    assert (answer.status_code, answer.headers["location"]) == (303, PAGE)
    (energy,) = agreement(client, admin)
    html = owner.page(PAGE)
    shown = figures_of(html)
    for name in ("bias", "lower", "upper", "correlation"):
        assert all(value in shown for value in energy[name].values()), name
    assert 'class="bland-altman"' in html
    (row,) = csv.DictReader(io.StringIO(owner.page(PAGE, format="csv")))
    assert (row["nutrient"], float(row["bias_low"])) == ("energy_kcal", energy["bias"]["low"])


def test_refused_file_names_the_line_and_changes_nothing(state, client, admin, owner, weighed):
    put(client, admin, weighed)
    answer = upload(owner, weighed.replace("P004,2026-11-21", "P004,21.11.2026"))
    assert answer.status_code == 422
    assert "Line 9: local_date is '21.11.2026', which is no day such as 2026-11-30." in text_of(answer.text).replace(
        "&#39;", "'"
    )
    assert agreement(client, admin)[0]["days"] == 8
    assert put(client, admin, "participant,local_date\n").status_code == 204  # none any more
    assert agreement(client, admin) == []
    with state.database.read() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(ReferenceDay)) == 0
        query = sa.select(AuditEvent.details).where(AuditEvent.action == "reference.put").order_by(AuditEvent.at)
        assert list(session.scalars(query)) == [{"days": 8}, {"days": 0}]


def test_viewer_sees_the_figures_and_uploads_nothing(client, viewer):
    assert '<form method="post" enctype' not in viewer.page(PAGE)
    assert upload(viewer, "participant,local_date\n").status_code == 403


@pytest.mark.both_stores
def test_files_uploaded_at_once_are_one_of_them_and_not_a_mixture(state, enrol):
    enrol("P001")
    with state.database.read() as session:
        study, staff = session.scalars(sa.select(Study)).one(), session.scalars(sa.select(Staff)).first()
    caller = StaffCaller(staff.id, staff.name, False, uuid.uuid4(), {study.id: "owner"})
    for _ in range(5):
        files = [f"{HEAD}P001,2026-11-20,{kcal}\nP001,2026-11-{21 + kcal},{kcal}\n".encode() for kcal in (1, 2, 3)]
        at_once(*(partial(replace_reference, state.database, caller, "pilot", file) for file in files))
        with state.database.read() as session:
            amounts = [day.amounts["energy_kcal"] for day in session.scalars(sa.select(ReferenceDay))]
        assert amounts in ([1, 1], [2, 2], [3, 3])


HEAD = "participant,local_date,energy_kcal\n"
REFUSED = {
    "P009,2026-11-20,1": ("reference_participant_unknown", 2, "participant"),
    "P001,2026-11-20,1\nP001,20.11.2026,1": ("reference_date_invalid", 3, "local_date"),
    "P001,2026-11-20,1\nP001,2026-11-20,2": ("reference_day_repeated", 3, "local_date"),
    "P001,2026-11-20,about 5": ("reference_amount_invalid", 2, "energy_kcal"),
    "P001,2026-11-20,-1": ("reference_amount_invalid", 2, "energy_kcal"),
    "P001,2026-11-20,inf": ("reference_amount_invalid", 2, "energy_kcal"),
    "P001,2026-11-20,1,5": ("csv_unreadable", None, None),
    "P001": ("reference_date_invalid", 2, "local_date"),
}


@pytest.mark.parametrize("rows", REFUSED)
def test_each_error_has_a_code_and_its_place(rows):
    with pytest.raises(InvalidInputError) as refused:
        read_reference((HEAD + rows).encode(), {"P001": None})
    facts = refused.value.facts
    assert (refused.value.code, facts.get("line"), facts.get("column")) == REFUSED[rows]


@pytest.mark.parametrize(
    ("head", "column"),
    [("participant,energy_kcal", "local_date"), ("participant,local_date,kcal", "kcal"), ("", "participant"),
     ("participant,local_date,fat_g,fat_g", "fat_g"), ("participant;local_date", "participant")],
)  # fmt: skip
def test_columns_must_be_those_of_days(head, column):
    with pytest.raises(InvalidInputError) as refused:
        read_reference(f"{head}\n".encode(), {})
    assert (refused.value.code, refused.value.facts["column"]) == ("reference_column_wrong", column)


def test_what_is_no_utf_8_is_refused_and_a_mark_of_excel_is_not():
    with pytest.raises(InvalidInputError) as refused:
        read_reference("participant,größe\n".encode("latin-1"), {})
    assert refused.value.code == "csv_unreadable"
    assert read_reference(f"\ufeff{HEAD}\r\nP001,2026-11-20,\r\n".encode(), {"P001": 1}) != {}
