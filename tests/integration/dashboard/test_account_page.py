"""The account page: the studies to which a new token may be limited."""

import re


def studies_offered(browser):
    return re.findall(r"<option >(\w+)</option>", browser.page("/dashboard/account"))


def test_new_token_may_be_limited_to_any_study_of_its_owner(client, admin, enrol, sign_in_browser):
    enrol()
    assert client.post("/v1/studies", headers=admin, json={"code": "other", "name": "Other"}).is_success
    boss = sign_in_browser("boss", is_admin=True)
    assert studies_offered(boss) == ["other", "pilot"]
    assert studies_offered(sign_in_browser("olga", pilot="owner")) == ["pilot"]
    assert studies_offered(sign_in_browser("sam")) == []
    page = boss.post("/dashboard/account/tokens", name="nightly", scope="read", study="other", days="30").text
    token = re.search(r'id="issued">([^<]+)<', page)[1]
    headers = {"Authorization": f"Bearer {token}"}
    assert client.get("/v1/studies/other", headers=headers).status_code == 200
    assert client.get("/v1/studies/pilot", headers=headers).status_code == 404
