"""An index from a folder of labelled photographs, built by the command and used to identify others."""

import json

import cv2
import numpy as np
import pytest

from app.candidates.identify_photo import identify_photo
from app.candidates.labelled_folder import build_from_folder, labelled_photos
from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.identification.food_index import open_index
from app.operations.doctor.doctor_settings import look_at_food_index
from app.operations.doctor.finding import Deployment
from app.vision.model import Photo
from tests.support.commands import run_tada

SIZE = 160
FOODS = {"idli": (210, 220, 230), "chutney": (60, 160, 70), "dosa": (60, 130, 190)}  # BGR


def picture(label, seed):
    """A round food with some grain on a grey plate."""
    rng = np.random.default_rng(seed)
    pixels = np.full((SIZE, SIZE, 3), 120, np.uint8)
    colour = tuple(int(channel) for channel in np.clip(np.array(FOODS[label]) + rng.integers(-12, 12, 3), 0, 255))
    axes = (57, 57) if label != "dosa" else (63, 33)
    cv2.ellipse(pixels, (SIZE // 2, SIZE // 2), axes, float(rng.integers(0, 180)), 0, 360, colour, -1)
    return np.clip(pixels + rng.normal(0, 6, pixels.shape), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def kitchen(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kitchen")
    for place, label in enumerate(FOODS):
        for specimen in range(3):
            (folder / label / f"piece-{specimen}").mkdir(parents=True)
            for view in range(2):
                name = str(folder / label / f"piece-{specimen}" / f"{view}.png")
                cv2.imwrite(name, picture(label, 100 * place + 10 * specimen + view))
    (folder / "foods.csv").write_text('label,name,food_key\nidli,"Idli, steamed",idli-plain\n')
    (folder / "volumes.csv").write_text("label,volume_ml\nidli,62\nidli,58\n")
    (folder / "boxes.csv").write_text("photo,x,y,width,height\nidli/piece-0/0.png,20,20,120,120\n")
    return folder


@pytest.fixture(scope="module")
def built(kitchen, tmp_path_factory):
    output = tmp_path_factory.mktemp("built") / "kitchen.npz"
    done = run_tada("index", "build", kitchen, "-o", output, "--name", "kitchen", "--json")
    return output, json.loads(done.stdout)


def test_command_writes_an_index_that_names_foods_it_has_not_seen(built):
    output, report = built
    assert report["photographs"] == 18
    assert len(open_index(output).examples) == 17 * 2 + 1  # without a box it is described in two ways
    assert report["specimens"] == 9
    assert report["foods"] == ["chutney", "dosa", "idli-plain"]
    assert open_index(output).version == report["version"]
    for label, key in (("idli", "idli-plain"), ("chutney", "chutney"), ("dosa", "dosa")):
        identified = identify_photo(Photo(picture(label, 999)), (13.0, 13.0, 134.0, 134.0), index=output)
        best = identified.place.identification.candidates[0]
        assert best.food_key == key
        assert best.probability > 0.5
        assert identified.place.identification.index_version == report["version"]


def test_same_folder_gives_the_same_version_and_its_files_are_read(built, kitchen):
    index = open_index(built[0])
    again = build_from_folder(kitchen, "kitchen", max_pixels=10**7)
    assert np.array_equal(again.examples, index.examples)
    assert again.calibration == index.calibration
    assert index.volumes_ml == {"idli": (62.0, 58.0)}
    assert [food.name for food in index.foods if food.label == "idli"] == ["Idli, steamed"]
    boxed = [photo.name for photo in labelled_photos(kitchen) if photo.box is not None]
    assert boxed == ["idli/piece-0/0.png"]


@pytest.fixture
def flat(tmp_path):
    """Photographs directly under a label."""
    for label in ("idli", "dosa"):
        (tmp_path / label).mkdir()
        for number in range(2):
            cv2.imwrite(str(tmp_path / label / f"{number}.png"), picture(label, number))
    return tmp_path


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("boxes.csv", "photo,x,y,width,height\nnone.jpg,1,1,1,1\n", "none.jpg"),
        ("boxes.csv", "photo,x,y,width,height\nidli/0.png,1,1,wide,1\n", "wide"),
        ("volumes.csv", "label,volume_ml\npizza,10\n", "pizza"),
        ("foods.csv", "label,name,food_key\nidli,a,same\ndosa,b,same\n", "twice"),
        ("foods.csv", "label,name,food_key\nidli,a,dosa\n", "dosa"),
        ("idli/broken.jpg", "no picture", "broken.jpg"),
    ],
)
def test_wrong_files_are_named(flat, name, text, told):
    (flat / name).write_text(text)
    with pytest.raises(InvalidInputError, match=told) as refused:
        build_from_folder(flat, "wrong", max_pixels=10**7)
    assert refused.value.code == "index_folder_invalid"


def test_empty_folder_and_one_food_alone_are_refused(tmp_path):
    with pytest.raises(InvalidInputError) as refused:
        build_from_folder(tmp_path, "empty", max_pixels=10**7)
    assert refused.value.code == "index_folder_invalid"
    (tmp_path / "idli").mkdir()
    for number in range(2):
        cv2.imwrite(str(tmp_path / "idli" / f"{number}.png"), picture("idli", number))
    with pytest.raises(InvalidInputError) as refused:
        build_from_folder(tmp_path, "one", max_pixels=10**7)
    assert refused.value.code == "index_too_small"


@pytest.mark.parametrize("output", ["index.zip", "missing/index.npz"])
def test_output_that_cannot_be_is_refused_before_the_photographs_are_read(tmp_path, output):
    done = run_tada("index", "build", tmp_path / "no-folder", "-o", tmp_path / output)
    assert done.returncode != 0
    assert output.partition("/")[0] in done.stderr
    assert "photographs" not in done.stderr


def test_unreadable_index_is_told_by_a_code_and_by_the_doctor(tmp_path):
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"no archive")
    broken.with_suffix(".csv").write_text("label,name,food_key\na,a,a\n")
    for path in (broken, tmp_path / "missing.npz"):
        with pytest.raises(InvalidInputError) as refused:
            open_index(path)
        assert refused.value.code == "food_index_unreadable"
        settings = Settings(data_dir=tmp_path, food_index=path)
        level, message, _ = look_at_food_index(Deployment(None, settings, requeue=False))
        assert level == "bad"
        assert str(path) in message
    assert look_at_food_index(Deployment(None, Settings(data_dir=tmp_path), requeue=False)) is None
