"""Mean intakes and adequacy as files of their pages: the API's files."""

import html
import re

import pytest

from tests.integration.dashboard.conftest import BROWSER


@pytest.mark.parametrize("of", ["intakes", "adequacy"])
def test_file_of_the_page_is_that_of_the_api(client, admin, enrol, sign_in_browser, of):
    enrol()
    viewer = sign_in_browser("vera", pilot="viewer")
    asked = {"component": "VITC"} if of == "adequacy" else {}
    page = viewer.page(f"/dashboard/studies/pilot/{of}", **asked, **{"from": "2026-01-01"})
    address = html.unescape(re.search(rf'href="(/dashboard/studies/pilot/files/{of}\?[^"]+)"', page)[1])
    assert "from=2026-01-01" in address
    answer = client.get(address, headers=BROWSER | {"Cookie": f"tada_session={viewer.cookies['tada_session']}"})
    api = client.get(address.replace(f"/dashboard/studies/pilot/files/{of}", f"/v1/studies/pilot/{of}"), headers=admin)
    assert (answer.status_code, answer.content) == (200, api.content)
    assert answer.headers["content-disposition"] == f'attachment; filename="{of}.csv"'
    assert answer.text.splitlines()[0].startswith("participant," if of == "intakes" else "life_stage,")
