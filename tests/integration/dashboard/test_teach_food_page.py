"""The page by which an owner teaches a study a food: photographs, items, what they are confused with, taking back."""

import re
import uuid

import cv2
import numpy as np
import pytest
import sqlalchemy as sa

from app.candidates.identify import IdentifyFoods
from app.identification.food_index import shipped_index
from app.meals.stored.identification_models import IndexEntry, TaughtPhotograph
from app.meals.stored.models import Meal
from app.meals.stored.run_answer import RunAnswer
from app.people.privacy_models import AuditEvent
from app.vision.looks.vcm import describe
from app.vision.looks.vcm_region import regions_of_whole
from tests.integration.dashboard.conftest import BROWSER, text_of
from tests.support.estimates import answer, found_item, identified_item, vcm
from tests.support.looks import vectors_of
from tests.support.photographs import photograph, with_hole

SIZE = 240


def pixels_of(seed):
    """A food with blue and yellow stripes, which nothing else looks like."""
    rng = np.random.default_rng(seed)
    pixels = np.full((SIZE, SIZE, 3), 120, np.uint8)
    cv2.circle(pixels, (SIZE // 2, SIZE // 2), 95, (200, 60, 30), -1)
    for place in range(40, SIZE - 40, 25 + seed % 3):
        cv2.line(pixels, (50, place), (SIZE - 50, place), (20, 220, 240), 6)
    return np.clip(pixels + rng.normal(0, 6, pixels.shape), 0, 255).astype(np.uint8)


def png_of(seed):
    return cv2.imencode(".png", pixels_of(seed))[1].tobytes()


@pytest.fixture
def food_key(client, admin):
    """A food of the table in force that the index does not know."""
    indexed = {food.food_key for food in shipped_index().foods}
    foods = client.get("/v1/foods", params={"q": "soup"}, headers=admin).json()["items"]
    return next(food["key"] for food in foods if food["key"] not in indexed)


@pytest.fixture
def path(food_key):
    return f"/dashboard/studies/pilot/taught-foods/{food_key}"


@pytest.fixture
def rows(state):
    def rows(model):
        with state.database.read() as session:
            return list(session.scalars(sa.select(model)))

    return rows


@pytest.fixture
def named_by(state):
    """The candidates of an item with this vector in a meal."""
    identify = IdentifyFoods(state.database)

    def named_by(meal_id, vector):
        with state.database.read() as session:
            meal = session.scalars(sa.select(Meal).where(Meal.client_id == uuid.UUID(meal_id))).one()
        sealed = RunAnswer.model_validate(answer(found_item(hint=None, vcm=vcm(*vector))))
        identify.add_candidates(meal, sealed)
        return sealed.items[0].candidates

    return named_by


def upload(browser, path, *contents, site="same-origin"):
    cookies = "; ".join(f"{name}={value}" for name, value in browser.cookies.items())
    headers = BROWSER | {"Cookie": cookies, "Sec-Fetch-Site": site}
    files = [("photo", (f"{place}.jpg", content, "image/jpeg")) for place, content in enumerate(contents)]
    return browser.client.post(f"{path}/photographs", headers=headers, files=files, follow_redirects=False)


def verdicts(page):
    """(example, whether it comes first) of the page's table."""
    rows = re.findall(r'<th scope="row">((?:Photograph|Item) \d+)</th>.*?(comes first|confused)', page, re.DOTALL)
    return [(name, verdict == "comes first") for name, verdict in rows]


@pytest.mark.both_stores
def test_three_photographs_name_a_new_food_once_in_force_and_no_more_when_taken_back(
    owner, path, food_key, meal_of, named_by, rows
):
    meal_id, vector = meal_of(found_item(hint=None)), describe(regions_of_whole(pixels_of(9))[1])
    assert food_key not in [candidate.food for candidate in named_by(meal_id, vector)]
    assert upload(owner, path, *map(png_of, range(3)), png_of(0)).status_code == 303
    page = owner.page(path)
    assert verdicts(page) == [(f"Photograph {number}", True) for number in (1, 2, 3)]
    assert food_key not in [candidate.food for candidate in named_by(meal_id, vector)]  # a draft names nothing
    assert owner.post(path).status_code == 303
    best = named_by(meal_id, vector)[0]
    assert (best.food, best.specimens, best.is_sure) == (food_key, 3, True)
    assert best.reasons == []  # it was taught, not eaten
    (first, *_) = re.findall(r'action="([^"]+/removal)"', owner.page(path))
    assert owner.post(first).status_code == 303
    assert named_by(meal_id, vector)[0].specimens == 2
    assert len(rows(TaughtPhotograph)) == 2
    assert owner.post(first).status_code == 404
    actions = [event.action for event in rows(AuditEvent) if event.action.startswith("food.")]
    assert actions == ["food.draft", "food.teach", "food.unteach"]


def test_example_that_looks_like_a_known_food_is_said_to_be_confused_with_it(owner, path, meal_of, state):
    banana = vectors_of(shipped_index(), "banana")[0]
    meal_id = meal_of(identified_item({}, none=1.0, vcm=vcm(*banana)))
    page = owner.page(path)
    (item,) = re.findall(r'name="item" value="([^"]+)"', page)
    assert "What it is confused with" in page
    chosen = owner.page(path, item=item)
    assert verdicts(chosen) == [("Item 1", False)]
    assert re.search(r"Banana.*?\d+(\.\d)? ?%", text_of(chosen))
    assert meal_id in chosen


def test_chosen_item_is_named_and_an_erased_one_teaches_no_more(
    owner, path, food_key, meal_of, rows, client, admin, named_by
):
    banana = vectors_of(shipped_index(), "banana")[0]
    looking, meal_id = meal_of(found_item(hint=None)), meal_of(identified_item({}, none=1.0, vcm=vcm(*banana)))
    (item,) = re.findall(r'name="item" value="([^"]+)"', owner.page(path))
    assert owner.post(f"{path}?item={item}").status_code == 303
    (entry,) = rows(IndexEntry)
    assert (str(entry.item_id), entry.food_key) == (item, food_key)
    assert 'name="item"' not in owner.page(path)
    assert food_key in [candidate.food for candidate in named_by(looking, banana)]
    assert client.delete(f"/v1/meals/{meal_id}", headers=admin).status_code == 200
    assert rows(IndexEntry) == []
    assert food_key not in [candidate.food for candidate in named_by(looking, banana)]


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"no picture", "Photograph 2: "),
        (with_hole(photograph(3))[:9000], "Photograph 2: "),
        (photograph(3, size=(64, 64)), "Photograph 2: "),
    ],
)
def test_bad_photograph_is_refused_with_its_number_and_none_is_kept(owner, path, rows, content, sentence):
    refused = upload(owner, path, png_of(0), content)
    assert refused.status_code == 422
    assert sentence in refused.text
    assert rows(TaughtPhotograph) == []


def test_only_owners_teach_only_foods_and_only_from_our_pages(owner, sign_in_browser, path, rows):
    reviewer = sign_in_browser("rita", pilot="reviewer")
    assert reviewer.get(path).status_code == 403
    assert upload(reviewer, path, png_of(0)).status_code == 403
    assert reviewer.post(path).status_code == 403
    assert sign_in_browser("sam").get(path).status_code == 404
    assert upload(owner, path, png_of(0), site="cross-site").status_code == 403
    assert owner.get("/dashboard/studies/pilot/taught-foods/citrus-fruit").status_code == 422
    assert owner.get("/dashboard/studies/pilot/taught-foods/moon-rock").status_code == 404
    assert rows(TaughtPhotograph) == []
    assert "taught-foods" in owner.page("/dashboard/foods/apple")
    assert "taught-foods" not in reviewer.page("/dashboard/foods/apple")
