"""Forms that correct foods: previewed, with a reason, as the API; no change is undone unseen."""

import html
import re

import pytest

from tests.integration.dashboard.conftest import text_of
from tests.integration.foods.editing import QUARK

EDIT = "/dashboard/foods/apple/edit"


class Form:
    """The fields of a page's form as a browser would send them back."""

    def __init__(self, page):
        part = page[page.index('<form method="post" class="food-form">') :]
        self.fields = {}
        for tag in re.findall(r"<input [^>]*>", part):
            name, value = re.search(r'name="([^"]+)"', tag), re.search(r'value="([^"]*)"', tag)
            if name:
                self.fields[name[1]] = html.unescape(value[1]) if value else ""
        for name, text in re.findall(r'<textarea [^>]*name="([^"]+)"[^>]*>\n?(.*?)</textarea>', part, re.DOTALL):
            self.fields[name] = html.unescape(text).replace("\n", "\r\n")
        for name, options in re.findall(r'<select [^>]*name="([^"]+)"[^>]*>(.*?)</select>', part, re.DOTALL):
            chosen = re.search(r'<option value="([^"]*)" selected', options) or re.search(r'value="([^"]*)"', options)
            self.fields[name] = html.unescape(chosen[1])


@pytest.fixture
def boss(sign_in_browser):
    return sign_in_browser("boss", is_admin=True)


@pytest.fixture
def food(client, admin):
    """A food by the API: food("apple")."""

    def read(key="apple"):
        answer = client.get(f"/v1/foods/{key}", headers=admin)
        assert answer.status_code == 200, answer.text
        return answer.json()

    return read


def known(food):
    return {nutrient["number"]: nutrient["per_100_g"] for nutrient in food["nutrients"]}


def send(browser, path, fields, **changes):
    changes = {name.replace("__", "-"): text for name, text in changes.items()}
    return browser.request("POST", path, data=fields | changes)


def test_unchanged_form_shows_the_food_of_the_api_and_makes_no_version(client, admin, boss, food):
    assert client.post("/v1/foods", headers=admin, json=QUARK).status_code == 201
    for key in ("apple", "quark-low-fat"):
        before, path = food(key), f"/dashboard/foods/{key}/edit"
        form = Form(boss.page(path))
        preview = send(boss, path, form.fields, do="preview")
        assert "Nothing differs" in preview.text, "every field reads back as it was written"
        assert send(boss, path, form.fields, do="save", reason="nothing").status_code == 303
        assert food(key) == before
    assert form.fields["nutrient-301"] == "120"
    assert form.fields["densities"] == "1.05; 0.03; as sold; bulk; measured; as_seen; weighed in a cup"


def test_preview_equals_the_saved_change_and_writes_nothing(client, admin, boss, food):
    before = food()
    form = Form(boss.page(EDIT))
    changes = {"nutrient__401": "9.5", "nutrient__307": "", "aliases": "Apfel\r\n<i>Apple</i>", "add__0": "314"}
    changes |= {"figure__0": "0.004", "unit__0": "mg"}
    page = text_of(send(boss, EDIT, form.fields, do="preview", **changes).text)
    assert "What would change" in page
    assert "Vitamin C, total ascorbic acid 4.6 mg 9.5 mg" in page
    assert "Sodium, Na 1.0 mg not known mg" in page
    assert food() == before, "a preview writes nothing"
    assert send(boss, EDIT, form.fields, do="save", **changes).status_code == 422, "a reason is asked for"
    assert send(boss, EDIT, form.fields, do="save", reason="analysed", **changes).status_code == 303
    after = food()
    assert after["version"] == before["version"] + 1
    assert after["aliases"] == ["Apfel", "<i>Apple</i>"]
    expected = known(before) | {"401": 9.5, "314": 4.0}
    assert known(after) == {number: figure for number, figure in expected.items() if number != "307"}
    (change,) = client.get("/v1/foods/apple/changes", headers=admin).json()["items"]
    assert (change["author"], change["reason"]) == ("staff: boss", "analysed")
    assert set(change["differences"]) == {"aliases", "nutrients.401", "nutrients.307", "nutrients.314"}


def test_conflict_shows_the_other_change_and_keeps_both(client, admin, boss, food):
    form = Form(boss.page(EDIT))
    etag = client.get("/v1/foods/apple", headers=admin).headers["etag"]
    other = {"nutrients": {"NA": {"per_100_g": 2, "unit": "mg"}}, "reason": "by another hand <b>"}
    assert client.patch("/v1/foods/apple", headers=admin | {"If-Match": etag}, json=other).status_code == 200
    answer = send(boss, EDIT, form.fields, do="save", reason="mine", nutrient__401="9.5")
    assert answer.status_code == 412
    assert "by another hand &lt;b&gt;" in answer.text
    assert known(food())["401"] == 4.6, "nothing of the second was written"
    again = Form(answer.text)
    assert (again.fields["nutrient-307"], again.fields["nutrient-401"], again.fields["reason"]) == ("2", "9.5", "mine")
    assert send(boss, EDIT, again.fields, do="save").status_code == 303
    assert (known(food())["307"], known(food())["401"]) == (2.0, 9.5), "nobody's change was undone"


def test_refused_field_keeps_its_text_and_says_what_is_wrong(boss, food):
    form = Form(boss.page(EDIT))
    for changes, sign in (
        ({"nutrient__203": "1,500"}, 'id="nutrient-203-wrong"'),
        ({"nutrient__203": "99"}, 'role="alert"'),  # by the food's own rules: more than there is of it
        ({"name": ""}, 'id="name-wrong"'),
        ({"form": "gas"}, 'id="form-wrong"'),
        ({"densities": "0.8; 0.1; raw; solid; rumour; as_seen; a friend"}, 'id="densities-wrong"'),
        ({"portions": "1 cup"}, 'id="portions-wrong"'),
        ({"add__0": "314", "figure__0": ""}, 'id="figure-0-wrong"'),
        ({"food__0": "apple-raw", "mass__0": ""}, 'id="recipe-wrong"'),
    ):
        answer = send(boss, EDIT, form.fields, do="save", reason="x", **changes)
        assert answer.status_code == 422
        assert sign in answer.text
        kept = Form(answer.text).fields
        for name, text in changes.items():
            assert kept[name.replace("__", "-")] == text or name == "form"
    assert food()["version"] == 1


def test_earlier_version_is_restored_with_a_reason_if_the_food_is_unchanged(boss, food):
    before = food()
    form = Form(boss.page(EDIT))
    send(boss, EDIT, form.fields, do="save", reason="wrong", name="Pear")
    page = boss.page("/dashboard/foods/apple")
    base = re.search(r'name="base" value="(\d+)"', page)[1]
    path = "/dashboard/foods/apple/restore"
    assert boss.post(path, base=base, version="1", reason="").status_code == 422
    assert boss.post(path, base=form.fields["base"], version="1", reason="it is an apple").status_code == 412
    assert food()["name"] == "Pear"
    assert boss.post(path, base=base, version="1", reason="it is an apple").status_code == 303
    assert food() == before | {"version": 3, "release": "local 1"}


def test_dish_is_made_from_rows_and_its_recipe_is_changed_by_them(boss, food):
    form = Form(boss.page("/dashboard/new-food"))
    dish = {"key": "compote-ours", "name": '<b>"Compote"</b>', "group": "Fruit dishes", "form": "heap"}
    dish |= {"reason": "canteen", "state": "cooked", "yield_factor": "0.95"}
    dish |= {"food-0": "apple", "mass-0": "800", "state-0": "raw"}
    dish |= {"retention-0": "VITC 0.75", "source-0": "as measured", "food-1": "no-such-food", "mass-1": "200"}
    answer = send(boss, "/dashboard/new-food", form.fields | dish, do="save", state__1="as_eaten")
    assert answer.status_code == 422
    assert "no-such-food" in answer.text
    assert "<b>&#34;Compote" not in answer.text
    dish |= {"food-1": "milk-whole", "state-1": food("milk-whole")["state"]}
    made = send(boss, "/dashboard/new-food", form.fields | dish, do="save")
    assert made.status_code == 303, text_of(made.text)
    told = food("compote-ours")
    assert told["is_mixed_dish"]
    assert [part["mass_g"] for part in told["recipe"]["ingredients"]] == [800.0, 200.0]
    assert told["recipe"]["ingredients"][0]["retention"] == {"401": 0.75}
    path = "/dashboard/foods/compote-ours/edit"
    form = Form(boss.page(path))
    assert "Nothing differs" in send(boss, path, form.fields, do="preview").text
    assert send(boss, path, form.fields, do="save", reason="more milk", mass__1="300").status_code == 303
    assert [part["mass_g"] for part in food("compote-ours")["recipe"]["ingredients"]] == [800.0, 300.0]
    again = send(boss, "/dashboard/new-food", Form(boss.page("/dashboard/new-food")).fields | dish, do="save")
    assert again.status_code == 409
    assert 'id="key-wrong"' in again.text or "already a food" in again.text


def test_measured_density_has_priority_and_an_impossible_specimen_is_refused(boss, food):
    path = "/dashboard/foods/apple/densities"
    base = re.search(r'name="base" value="(\d+)"', boss.page(path))[1]
    form = {"base": base, "state": "raw", "kind": "solid", "weighs": "as_seen", "method": "scale", "reason": "ours"}
    wrong = boss.post(path, **form, specimens="168 200 1\r\n250 204")
    assert wrong.status_code == 422
    assert "168 200 1" in wrong.text
    assert boss.post(path, **form, specimens="1 200\r\n1 204").status_code == 422, "volume and mass are swapped"
    assert boss.post(path, **form, g_per_ml="0.8", specimens="200 168\r\n250 204").status_code == 422
    assert boss.post(path, **form, specimens="200 168\r\n250 204", volume_step_ml="1").status_code == 303
    assert food()["densities"][0]["g_per_ml"] == pytest.approx(0.828)
    assert boss.post(path, **form, g_per_ml="0.8", sd_g_per_ml="0.02").status_code == 412, "of the version before"
