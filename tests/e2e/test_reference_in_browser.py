"""An owner uploads weighed days in a real browser and sees how far the study agrees: wide, narrow, legible."""

import pytest
from playwright.sync_api import expect

from tests.e2e.browser import require_legible
from tests.e2e.dashboard_server import PASSWORD
from tests.integration.diary.eaten_days import add_meal, close, eaten_item

pytestmark = pytest.mark.slow
KCAL = {"P001": 1600, "P002": 2000, "P003": 2400, "P004": 1900}


def test_uploaded_reference_is_shown_and_a_wrong_one_says_why(served, open_page):
    served.make_study("weighed")
    served.make_staff("olga-weighed", weighed="owner")
    lines = ["participant,local_date,energy_kcal,protein_g"]
    for number, (code, kcal) in enumerate(KCAL.items()):
        with served.enrol(code, "weighed") as phone:
            item = eaten_item(energy_kcal=kcal, protein_g=60.0 + number)
            add_meal(served, code, "2026-11-20", item, study="weighed")
            close(phone, "2026-11-20")
        lines.append(f"{code},2026-11-20,{kcal + 100 - 60 * number},{66 - number}")
    tab = open_page(served.address)
    tab.sign_in("olga-weighed", PASSWORD, "/dashboard/studies/weighed/reference")
    tab.expect("status of 422")
    for content, shown in (("participant\n", "Column 'local_date' is wrong"), ("\n".join(lines), "has 4 days")):
        file = {"name": "weighed.csv", "mimeType": "text/csv", "buffer": content.encode()}
        tab.page.get_by_label("Reference days, as CSV").set_input_files(file)
        tab.page.get_by_role("button", name="Upload").click()
        expect(tab.page.get_by_text(shown)).to_be_visible()
    expect(tab.page.locator(".bland-altman")).to_have_count(2)
    require_legible(tab.page, "reference")
