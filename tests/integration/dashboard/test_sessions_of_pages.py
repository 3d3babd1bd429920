"""Signing in and out, ended sessions, cross-site requests, headers of every response."""

import itertools
from datetime import UTC, datetime, timedelta

import sqlalchemy as sa

from app.dashboard import templates
from app.dashboard.people_pages.account import safe_path
from app.dashboard.templates import static
from app.people.access.caller import SESSION_IDLE
from app.people.access.page_rules import PAGES
from app.people.models import AccessToken
from tests.integration.dashboard.conftest import BROWSER, Browser
from tests.integration.people.people import PASSWORD, make_staff


def test_request_without_session_is_redirected_to_the_form_and_back(client, admin):
    answer = client.get("/dashboard", headers=BROWSER, follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "/dashboard/sign-in")
    answer = client.get("/dashboard?cursor=x", headers=BROWSER, follow_redirects=False)
    assert answer.headers["location"] == "/dashboard/sign-in?next=%2Fdashboard%3Fcursor%3Dx"
    page = client.get(answer.headers["location"], headers=BROWSER).text
    assert 'name="next" value="/dashboard?cursor=x"' in page
    make_staff(client, admin, "ann")
    form = {"name": "ann", "password": PASSWORD, "next": "/dashboard?cursor=x"}
    answer = client.post("/dashboard/sign-in", headers=BROWSER, data=form, follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "/dashboard?cursor=x")
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=lax" in cookie


def test_wrong_password_shows_the_form_again_with_an_error_and_the_escaped_name(client, admin):
    name = '"><script>alert(1)</script>'
    answer = client.post("/dashboard/sign-in", headers=BROWSER, data={"name": name, "password": "wrong"})
    assert answer.status_code == 401
    assert "Name or password are wrong" in answer.text
    assert "<script>alert" not in answer.text
    assert "set-cookie" not in answer.headers


def test_signing_out_ends_the_session_itself_not_only_the_cookie(sign_in_browser):
    ann = sign_in_browser("ann")
    assert ann.get("/dashboard").status_code == 200
    assert ann.post("/dashboard/sign-out").headers["location"] == "/dashboard/sign-in"
    assert ann.get("/dashboard").status_code == 303


def test_session_that_is_idle_or_over_is_redirected_to_the_form(client, state, sign_in_browser):
    ann = sign_in_browser("ann")
    past = datetime.now(UTC) - SESSION_IDLE - timedelta(minutes=1)
    for change in ({"created_at": past, "last_used_at": past}, {"expires_at": past}):
        browser = Browser(client, ann.name)
        assert browser.get("/dashboard").status_code == 200
        with state.database.write() as session:
            session.execute(sa.update(AccessToken).where(AccessToken.kind == "session").values(**change))
        answer = browser.get("/dashboard")
        assert (answer.status_code, answer.headers["location"]) == (303, "/dashboard/sign-in")
        answer = browser.get("/dashboard", headers={"HX-Request": "true"})
        assert (answer.status_code, answer.headers["hx-redirect"]) == (204, "/dashboard/sign-in")


def test_api_token_opens_no_page_and_a_cookie_no_api_route(client, admin, sign_in_browser):
    assert client.get("/dashboard", headers=admin).status_code == 401
    ann = sign_in_browser("ann")
    cookie = {"Cookie": f"tada_session={ann.cookies['tada_session']}"}
    assert client.get("/v1/studies", headers=cookie).status_code == 401
    as_cookie = {"Cookie": f"tada_session={admin['Authorization'].removeprefix('Bearer ')}"}
    answer = client.get("/dashboard", headers=as_cookie)
    assert (answer.status_code, answer.json()["code"]) == (403, "session_needed")


def test_another_sites_form_changes_nothing(client, sign_in_browser):
    ann = sign_in_browser("ann")
    cookie = {"Cookie": f"tada_session={ann.cookies['tada_session']}"}
    for origin in (
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "none"},
        {"Sec-Fetch-Site": "cross-site", "Origin": "http://testserver"},
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://testserver.evil.example"},
        {},
    ):
        answer = client.post("/dashboard/sign-out", headers=cookie | origin, follow_redirects=False)
        assert (answer.status_code, answer.json()["code"]) == (403, "cross_site"), origin
        answer = client.post("/dashboard/sign-in", headers=origin, data={"name": "ann", "password": PASSWORD})
        assert answer.status_code == 403, "nobody is signed in as somebody else by another site"
    assert ann.get("/dashboard").status_code == 200
    own = cookie | {"Origin": "http://testserver"}  # a browser may send no more than the origin
    assert client.post("/dashboard/sign-out", headers=own, follow_redirects=False).status_code == 303


def test_under_https_the_cookie_is_bound_to_host_and_transport(app, client, admin):
    make_staff(client, admin, "ann")
    client.base_url = "https://testserver"
    form = {"name": "ann", "password": PASSWORD}
    answer = client.post("/dashboard/sign-in", headers=BROWSER, data=form, follow_redirects=False)
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith("__Host-tada_session=")
    assert "Secure" in cookie
    token = answer.cookies["__Host-tada_session"]
    client.cookies.clear()
    plain = client.get("/dashboard", headers=BROWSER | {"Cookie": f"tada_session={token}"}, follow_redirects=False)
    assert plain.status_code == 303, "a cookie that plain HTTP could set opens nothing"


def test_every_response_has_the_security_headers(client, sign_in_browser):
    for path in ("/dashboard", "/dashboard/sign-in", "/dashboard/no-such-page", "/dashboard/static/app.css"):
        answer = client.get(path, headers=BROWSER, follow_redirects=False)
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["x-frame-options"] == "DENY"
        assert "cache-control" in answer.headers
    assert sign_in_browser("ann").get("/dashboard").headers["cache-control"] == "private, no-store"


def test_static_file_of_another_version_is_not_cached_for_good(client):
    """As when a page of a new server asks one that is not upgraded yet."""
    own = client.get(static("vendor/htmx/htmx.min.js"))
    assert own.headers["cache-control"] == "public, max-age=31536000, immutable"
    for version in ("?v=0123456789ab", "?v=", ""):
        answer = client.get(f"/dashboard/static/vendor/htmx/htmx.min.js{version}")
        assert (answer.content, answer.headers["cache-control"]) == (own.content, "no-cache")
    unchanged = client.get(static("app.css"), headers={"If-None-Match": client.get(static("app.css")).headers["etag"]})
    assert (unchanged.status_code, "immutable" in unchanged.headers["cache-control"]) == (304, True)
    assert client.get("/dashboard/static/vendor").status_code == 404


def test_error_is_a_page_for_a_browser_a_fragment_for_htmx_and_a_problem_for_a_program(client, sign_in_browser):
    ann = sign_in_browser("ann")
    page = ann.get("/dashboard/studies/nowhere")
    assert page.status_code == 404
    assert "<!doctype html>" in page.text
    piece = ann.get("/dashboard/studies/nowhere", headers={"HX-Request": "true"})
    assert "<!doctype" not in piece.text
    assert piece.headers["hx-retarget"] == "#problem"
    cookie = {"Cookie": f"tada_session={ann.cookies['tada_session']}"}
    assert client.get("/dashboard/studies/nowhere", headers=cookie).json()["code"] == "not_found"


def test_sign_in_redirects_to_no_other_site():
    elsewhere = ("//evil.example", "https://evil.example/dashboard", "/dashboard\\evil", "javascript:alert(1)")
    for path in (*elsewhere, "/dashboardx", "/v1/me", "//[", ""):
        assert safe_path(path) == "/dashboard"


def test_menus_link_only_to_existing_pages():
    assert list(templates.STUDY) == ["Data", "People", "Results", "Setup"]
    for entry in itertools.chain(*templates.STUDY.values()):
        start = "/dashboard" if entry == templates.FOODS else "/dashboard/studies/{study}"
        assert ("GET", "/".join([start, *entry.path])) in PAGES, entry
    for entry in (*templates.SERVER, *templates.ADMIN):
        assert ("GET", "/".join(["/dashboard", *entry.path])) in PAGES, entry


def test_study_of_others_is_not_listed(enrol, sign_in_browser):
    enrol(study="secret")
    enrol(study="pilot")
    text = sign_in_browser("ann", pilot="viewer").page("/dashboard")
    assert "pilot" in text
    assert "secret" not in text
