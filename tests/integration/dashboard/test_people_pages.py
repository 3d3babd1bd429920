"""Members, devices, enrolment cards, staff, account, settings, webhooks, audit log, marker."""

import html
import re

import pytest

from tests.integration.dashboard.conftest import Browser, text_of
from tests.integration.people.people import PASSWORD, sign_in
from tests.support.estimates import found_item

SETTINGS = "/dashboard/studies/pilot/settings"
ENROL = "/dashboard/studies/pilot/enrol"


def version_of(page):
    return re.search(r'name="version" value="(\d+)"', page)[1]


def protocol(**changes):
    form = {"name": "Pilot", "locale": "de", "day_starts": "03:00", "marker": "plain:9x7:11", "location_decimals": "2"}
    form |= {"location_policy": "round", "retention_days": "30", "withdrawal_policy": "keep"}
    return form | {"after_window_minutes": "240"} | changes


@pytest.fixture
def study(client, admin):
    """The study by the API."""
    return lambda: client.get("/v1/studies/pilot", headers=admin).json()


def test_owner_changes_the_protocol_and_the_api_returns_it(owner, study):
    page = owner.page(SETTINGS)
    changes = {"gives_feedback": "true", "reminder_times": "18:30  12:30 12:30"}
    changes |= {"web_origins": "https://App.example.org:443\r\n\r\n http://localhost:5173"}
    answer = owner.post(SETTINGS, **protocol(version=version_of(page), **changes))
    assert answer.status_code == 303, text_of(answer.text)
    told, origins = study(), ["http://localhost:5173", "https://app.example.org"]
    assert (told["locale"], told["retention_days"], told["gives_feedback"]) == ("de", 30, True)
    assert (told["reminder_times"], told["web_origins"]) == (["12:30", "18:30"], origins)
    page = owner.page(SETTINGS)
    assert 'value="12:30 18:30"' in page
    assert "http://localhost:5173\nhttps://app.example.org</textarea>" in page
    assert owner.post(SETTINGS, **protocol(version=told["version"], retention_days="")).status_code == 303
    told = study()
    assert (told["retention_days"], told["gives_feedback"]) == (None, False), "emptied and unticked"
    assert told["web_origins"] == origins, "the form was without the field"
    assert owner.post(SETTINGS, **protocol(version=told["version"], web_origins="")).status_code == 303
    assert study()["web_origins"] == []


def test_protocol_that_was_changed_meanwhile_is_not_overwritten(client, admin, owner, study):
    version = version_of(owner.page(SETTINGS))
    if_match = {"If-Match": f'"{version}"'}
    assert client.patch("/v1/studies/pilot", headers=admin | if_match, json={"name": "Other"}).is_success
    answer = owner.post(SETTINGS, **protocol(version=version))
    assert answer.status_code == 412
    assert "Other" in answer.text, "the page shows how it stands now"
    assert study()["name"] == "Other"


def test_refused_value_stays_in_the_form_beside_its_error(owner, study):
    page, before = owner.page(SETTINGS), study()
    assert "empty: they are kept" in text_of(page)
    assert "null" not in text_of(page)
    assert "`" not in text_of(page)
    for field, value, shown in (
        ("retention_days", "-3", 'value="-3"'),
        ("location_decimals", "", "enter the number of decimals, 0 to 4."),
        ("reminder_times", "12:30 noon", 'value="12:30 noon"'),
        ("web_origins", "<b>x</b>", "&lt;b&gt;x&lt;/b&gt;</textarea>"),
        ("web_origins", "\n".join(f"https://a{n}.org" for n in range(21)), "https://a20.org</textarea>"),
    ):
        form = {"name": 'A "quoted" <b>name</b>', field: value}
        answer = owner.post(SETTINGS, **protocol(version=version_of(page), **form))
        assert answer.status_code == 422
        assert f'id="{field}-wrong"' in answer.text
        assert shown in html.unescape(answer.text) or shown in answer.text
        assert "<b>" not in answer.text
        assert "A &#34;quoted&#34; &lt;b&gt;name&lt;/b&gt;" in answer.text
    answer = owner.post(SETTINGS, **protocol(version=version_of(page), location_policy="drop"))
    assert answer.status_code == 422
    assert "Leave this empty: places are not rounded." in text_of(answer.text)
    assert study() == before


def test_list_with_an_unknown_code_makes_no_card_and_ends_none(client, owner):
    page = owner.post(ENROL, participants="P001").text
    printed = re.search(r'<p class="secret">([^<]+)</p>', page)[1]
    assert 'value="true" checked' not in owner.post(ENROL, participants="P999").text
    answer = owner.post(ENROL, participants="P001\nP999", app="true")
    assert 'name="app" value="true" checked' in answer.text
    assert answer.status_code == 422
    assert "P999: " in html.unescape(answer.text)
    assert 'class="secret"' not in answer.text
    assert "P001\nP999</textarea>" in answer.text
    body = {"code": printed, "device_name": "phone"}
    assert client.post("/v1/enrolments", json=body).status_code == 201


def test_card_of_the_sheet_enrols_a_phone_once(client, owner):
    page = owner.post(ENROL, participants="P001", app="true").text
    code = re.search(r'<p class="secret">([^<]+)</p>', page)[1]
    assert page.count("<svg") == 2
    assert f'href="http://testserver/capture/#code={code}"' in page
    body = {"code": code, "device_name": "<b>bold</b> phone"}
    assert client.post("/v1/enrolments", json=body).status_code == 201
    assert client.post("/v1/enrolments", json=body).status_code != 201
    devices = owner.page("/dashboard/studies/pilot/devices")
    assert "&lt;b&gt;bold" in devices
    assert code not in devices


def test_revoked_phone_is_shown_as_revoked_and_has_no_access(phone, sign_in_browser):
    owner = sign_in_browser("olga", pilot="owner")
    page = owner.page("/dashboard/studies/pilot/devices")
    address = re.findall(r'action="(/dashboard/studies/pilot/devices/[^"]+/revocation)"', page)[0]
    assert phone.get("/v1/me").status_code == 200
    assert owner.post(address).status_code == 303
    assert phone.get("/v1/me").status_code == 401
    assert "revoked" in owner.page("/dashboard/studies/pilot/devices", participant="P001")


def test_owner_gives_and_takes_roles(owner, sign_in_browser):
    path = "/dashboard/studies/pilot/members"
    sign_in_browser("vera")
    assert owner.post(path, name="vera", role="reviewer").status_code == 303
    page = text_of(owner.page(path))
    assert "vera now has the role reviewer." in page
    assert "vera reviewer" in page
    assert owner.post(path, name="nobody", role="reviewer").status_code == 404
    assert owner.post(f"{path}/removal", name="olga").status_code == 409, "the last owner stays"
    assert owner.post(f"{path}/removal", name="vera").status_code == 303


def test_admin_adds_a_staff_member_who_then_signs_in(client, sign_in_browser):
    boss = sign_in_browser("boss", is_admin=True)
    assert boss.post("/dashboard/staff", name="newcomer", password="short").status_code == 422
    assert boss.post("/dashboard/staff", name="newcomer", password=PASSWORD).status_code == 303
    newcomer = Browser(client, "newcomer")
    assert newcomer.get("/dashboard/staff").status_code == 403
    assert boss.post("/dashboard/staff/change", name="newcomer", is_disabled="true").status_code == 303
    assert newcomer.get("/dashboard").status_code == 303


def test_personal_token_is_shown_once_reads_only_and_may_be_limited_to_a_study(client, enrol, owner, sign_in_browser):
    enrol(study="other")
    boss = sign_in_browser("boss", is_admin=True)
    offered = {
        browser.name: re.findall(r"<option >(\w+)</option>", browser.page("/dashboard/account"))
        for browser in (boss, owner, sign_in_browser("sam"))
    }
    assert offered == {"boss": ["other", "pilot"], "olga": ["pilot"], "sam": []}
    page = boss.post("/dashboard/account/tokens", name="nightly", scope="read", study="pilot", days="30").text
    token = re.search(r'id="issued">([^<]+)<', page)[1]
    headers = {"Authorization": f"Bearer {token}"}
    assert client.get("/v1/studies/pilot", headers=headers).status_code == 200
    assert client.get("/v1/studies/other", headers=headers).status_code == 404
    assert client.post("/v1/studies/pilot/participants", headers=headers, json={"code": "P2"}).status_code == 403
    page = boss.page("/dashboard/account")
    assert token not in page
    end = re.findall(r'action="(/dashboard/account/tokens/[^"]+/revocation)"', page)[0]
    assert boss.post(end).status_code == 303
    assert client.get("/v1/studies/pilot", headers=headers).status_code == 401


def test_new_password_ends_all_sessions(client, owner):
    path = "/dashboard/account/password"
    change = {"current_password": PASSWORD, "new_password": "another horse battery", "again": "another horse battery"}
    assert owner.post(path, **change | {"again": "not the same"}).status_code == 422
    assert owner.post(path, **change | {"current_password": "x"}).status_code == 422
    assert owner.post(path, **change).status_code == 303
    assert owner.get("/dashboard").status_code == 303
    assert sign_in(client, "olga", "another horse battery").status_code == 201


def test_webhook_shows_its_secret_once_and_its_deliveries(owner):
    path = "/dashboard/studies/pilot/webhooks"
    assert owner.post(path, url="http://plain.example", events="*").status_code == 422
    page = owner.post(path, url="https://93.184.215.14/a?b=%22c%22", events="meal.failed").text
    assert "shown once" in page, text_of(page)
    secret = re.search(r'id="issued">([^<]+)<', page)[1]
    page = owner.page(path)
    assert secret not in page
    address = re.search(rf'href="({path}/[^"]+)"', page)[1]
    assert owner.post(f"{address}/test").status_code == 303
    page = owner.page(address)
    assert "ping" in page
    again = re.search(r'action="([^"]+/replay)"', page)[1]
    assert owner.post(again).status_code == 303
    assert owner.post(f"{address}/state", is_enabled="false").status_code == 303
    page = owner.page(address)
    assert owner.post(f"{address}/state", is_enabled="true", version=version_of(page)).status_code == 303
    assert secret not in owner.post(f"{address}/secret").text


def test_audit_log_of_the_page_is_that_of_the_export(client, admin, owner):
    owner.post("/dashboard/studies/pilot/members", name="olga", role="owner")
    page = owner.page("/dashboard/studies/pilot/audit", action="enrolment.issue")
    told = client.get("/v1/studies/pilot/audit", headers=admin, params={"action": "enrolment.issue"}).json()["items"]
    assert page.count("<code>enrolment.issue</code>") == len(told)
    owner.post(SETTINGS, **protocol(version=version_of(owner.page(SETTINGS)), gives_feedback="true"))
    changed = text_of(owner.page("/dashboard/studies/pilot/audit", action="study.change"))
    assert re.search(r"fields: [a-z ]+, gives feedback", changed)
    assert "[" not in changed
    file = owner.get("/dashboard/studies/pilot/audit", format="csv")
    assert file.headers["content-type"].startswith("text/csv")
    assert file.headers["content-disposition"] == 'attachment; filename="pilot_audit.csv"'
    days = {"from": "2026-11-01", "to": "2026-11-30"}
    named = owner.get("/dashboard/studies/pilot/audit", format="csv", **days).headers["content-disposition"]
    assert named == 'attachment; filename="pilot_audit_2026-11-01_2026-11-30.csv"'
    early = {"to": "0001-01-01T00:00:00Z", "format": "csv"}
    assert client.get("/v1/audit", headers=admin, params=early).status_code == 200
    whole = client.get("/v1/studies/pilot/audit", headers=admin, params={"format": "csv"})
    assert file.text.splitlines()[:2] == whole.text.splitlines()[:2]


def test_audit_log_begins_with_the_newest_and_names_participants_by_their_code(client, admin, owner):
    answer = client.patch("/v1/studies/pilot/participants/P001", headers=admin, json={"starts_on": "2026-11-01"})
    assert answer.status_code == 200
    rows = re.findall(r"<tr><td>.*?</tr>", owner.page("/dashboard/studies/pilot/audit"), re.DOTALL)
    assert "participant.change" in rows[0]
    assert "P001" in text_of(rows[0])
    assert not re.search(r"[0-9a-f]{8}-", rows[0])


def test_marker_is_a_pdf(owner):
    assert "plain:9x7:11" in owner.page("/dashboard/marker")
    answer = owner.get("/dashboard/marker.pdf", marker="plain:9x7:11")
    assert answer.content.startswith(b"%PDF")
    assert owner.get("/dashboard/marker.pdf", marker='"><script>').status_code == 422


def test_admin_creates_a_study(client, admin, sign_in_browser):
    boss = sign_in_browser("boss", is_admin=True)
    assert boss.post("/dashboard/new-study", code="bad code", name="x").status_code == 422
    answer = boss.post("/dashboard/new-study", code="fresh", name="<i>Fresh</i>", marker="plain:9x7:11")
    assert answer.headers["location"] == "/dashboard/studies/fresh/settings"
    assert "<i>Fresh" not in boss.page("/dashboard")
    assert client.get("/v1/studies/fresh", headers=admin).status_code == 200


def test_form_with_a_file_is_refused(client, owner):
    headers = {"Sec-Fetch-Site": "same-origin", "Cookie": f"tada_session={owner.cookies['tada_session']}"}
    answer = client.post("/dashboard/studies/pilot/members", headers=headers, files={"name": ("a", b"x")})
    assert (answer.status_code, answer.json()["code"]) == (400, "malformed_request")


def test_change_of_the_marker_names_the_meals_that_it_concerns_and_asks(owner, study, meal_of):
    meal_of(found_item())
    meal_of(captured_at="2026-11-21T12:30:00+08:00")
    form = protocol(version=study()["version"], marker="plain:9x7:22", day_starts=study()["day_starts"])
    asked = owner.post(SETTINGS, **form)
    assert (asked.status_code, study()["marker"]) == (409, "plain:9x7:11")
    told = text_of(asked.text)
    assert "1 photographed meal " in told
    assert "2026-11-20 to 2026-11-20, keeps the volumes that were measured with plain:9x7:11" in told
    assert "All later ones, and 1 that waits now, are measured with plain:9x7:22." in told
    assert owner.post(SETTINGS, **form, agreed_marker="plain:9x7:30").status_code == 409
    assert owner.post(SETTINGS, **form, agreed_marker="plain:9x7:22").status_code == 303
    assert study()["marker"] == "plain:9x7:22"
