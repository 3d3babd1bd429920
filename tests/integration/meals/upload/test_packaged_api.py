"""/v1/packaged-foods: the food of a barcode, typed or photographed, and an entry of a part of the pack."""

import uuid

import cv2
import numpy as np
import pytest

from app.foods.packaged.import_packaged import import_packaged
from app.meals.estimate.barcode_task import barcode_task, read_barcodes
from tests.integration.foods.dumps import NO_LABEL, write_dump
from tests.support.packs import gtin_of, photograph_pack
from tests.support.photographs import photograph

COLA = NO_LABEL | {
    "code": "5449000000996", "product_name": "Cola", "brands": "", "quantity": "6 x 33 cl", "serving_quantity": "",
    "energy-kcal_100g": "42", "carbohydrates_100g": "10.6", "sugars_100g": "10.6",
}  # fmt: skip


@pytest.fixture
def packs(state, tmp_path):
    import_packaged(state.database, write_dump(tmp_path / "dump.csv", {}, COLA), "me", lambda *_: None)


def pixels(encoded):
    return cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR)


def photograph_of(phone, content):
    headers = phone.headers | {"Content-Type": "application/octet-stream"}
    return phone.client.post("/v1/barcodes", headers=headers, content=content)


def declare(phone, food, amount):
    body = {
        "id": str(uuid.uuid4()), "captured_at": "2026-11-21T16:00:00+01:00", "time_zone": "Europe/Berlin",
        "items": [{"food": food, "amount": amount}],
    }  # fmt: skip
    return phone.client.post("/v1/declared-meals", headers=phone.headers, json=body)


@pytest.mark.usefixtures("packs")
def test_food_of_a_barcode_has_its_label_and_its_source(phone):
    cocoa = phone.get("/v1/packaged-foods/3017620422003").json()
    assert (cocoa["key"], cocoa["name"], cocoa["measured_in"]) == ("off:3017620422003", "Cocoa spread, Ferrero", "g")
    assert {row["number"]: row["per_100_g"] for row in cocoa["nutrients"]} == {
        "208": 539, "203": 6.3, "204": 30.9, "606": 10.6, "CHOAVL": 57.5, "269": 56.3, "307": 42.8,
    }  # fmt: skip
    assert cocoa["portions"] == [
        {"amount": 1, "measure": "pack", "mass_g": 400}, {"amount": 1, "measure": "serving", "mass_g": 15},
    ]  # fmt: skip
    assert cocoa["source"] == {
        "name": "Open Food Facts", "release": "open-food-facts 2023-11-14", "licence": "ODbL 1.0",
        "url": "https://world.openfoodfacts.org/product/3017620422003",
    }  # fmt: skip
    assert phone.get("/v1/packaged-foods/03017620422003").json() == cocoa
    assert phone.get("/v1/packaged-foods/5449000000996").json()["measured_in"] == "ml"


def test_barcode_that_is_wrong_or_unknown_is_told(phone):
    for digits in ("3017620422004", "30176204", "301762042200", "abcdefgh", "٣٠١٧٦٢٠٤"):
        answer = phone.get(f"/v1/packaged-foods/{digits}")
        assert (answer.status_code, answer.json()["code"]) == (422, "barcode_invalid"), digits
    answer = phone.get("/v1/packaged-foods/3017620422003")
    assert (answer.status_code, answer.json()["code"], answer.json()["barcode"]) == (
        404, "barcode_unknown", "3017620422003",
    )  # fmt: skip


@pytest.mark.usefixtures("packs")
def test_barcode_is_read_from_a_photograph(phone, state):
    assert photograph_of(phone, photograph_pack("3017620422003", 1)).json()["key"] == "off:3017620422003"
    unknown = photograph_of(phone, photograph_pack(gtin_of("400638133393"), 3)).json()
    assert (unknown["code"], unknown["barcode"]) == ("barcode_unknown", "4006381333931")
    packs = [pixels(photograph_pack(code, 1)) for code in ("3017620422003", "5449000000996")]
    beside = np.hstack([each[200:1400, 150:1050] for each in packs])
    both = photograph_of(phone, cv2.imencode(".jpg", beside, [cv2.IMWRITE_JPEG_QUALITY, 50])[1].tobytes()).json()
    assert (both["code"], both["barcodes"]) == ("barcodes_several", ["3017620422003", "5449000000996"])
    assert photograph_of(phone, photograph(size=(640, 480))).json()["code"] == "barcode_not_found"
    assert photograph_of(phone, b"%PDF-1.7").json()["code"] == "not_an_image"
    assert list(state.blobs.staging_folder().iterdir()) == []


def test_blurred_barcodes_are_read_and_never_misread():
    # one reading of each as it is misses four and takes the fifth for two products
    photographs = [pixels(photograph_pack("7907259271393", seed)) for seed in range(12)]
    reads = [read_barcodes(cv2.resize(each, None, fx=0.75, fy=0.75)) for each in photographs]
    assert reads == [["7907259271393"]] * 12


@pytest.mark.both_stores
@pytest.mark.usefixtures("packs")
def test_part_of_a_pack_is_an_entry_with_the_labels_figures(phone):
    half = declare(phone, "off:3017620422003", {"portion": "pack", "count": 0.5}).json()
    assert (half["status"], half["totals"]["consumed_g"]) == ("confirmed", 200)
    nutrients = {row["tagname"]: row["amount"] for row in half["totals"]["nutrients"]}
    assert (nutrients["ENERC_KCAL"], nutrients["NA"]) == (1078, pytest.approx(85.6))
    assert "CHOCDF" not in nutrients  # fibre is not on the label, so that it is not known
    grams = declare(phone, "off:3017620422003", {"mass_g": 30}).json()
    assert grams["totals"]["nutrients"][0]["amount"] == pytest.approx(161.7)
    can = declare(phone, "off:5449000000996", {"volume_ml": 330}).json()
    assert can["totals"]["nutrients"][0]["amount"] == pytest.approx(138.6)
    # now it is a food like others, with its source
    food = phone.get("/v1/foods/off:3017620422003").json()
    assert (food["release"], food["group"]) == ("open-food-facts 2023-11-14", "Packaged foods")
    assert phone.get("/v1/foods", q="cocoa spread").json()["items"][0]["key"] == "off:3017620422003"
    assert declare(phone, "off:9999999999994", {"mass_g": 30}).json()["code"] == "food_unknown"


def test_barcode_that_takes_little_of_a_large_photograph_is_read(tmp_path):
    large = np.full((2400, 3200, 3), 90, np.uint8)
    pack = pixels(photograph_pack("3017620422003", 6))
    large[800:1520, 1000:1960] = cv2.resize(pack, (960, 720), interpolation=cv2.INTER_AREA)
    photo = tmp_path / "large.jpg"
    photo.write_bytes(cv2.imencode(".jpg", large)[1].tobytes())
    halved = cv2.resize(large, (1600, 1200), interpolation=cv2.INTER_AREA)
    answer = barcode_task({"photo": str(photo), "max_pixels": 10**7}, lambda _: None)
    assert (read_barcodes(halved), answer["barcodes"]) == ([], ["3017620422003"])
