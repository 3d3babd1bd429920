import io
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from app.identification.build_index import write_index
from app.identification.examples import NumberedIndex
from app.identification.food_index import (
    KnownFood,
    read_index,
    read_labels,
)
from app.identification.identifier import Identifier
from app.identification.kernel_classifier import Calibration
from tests.unit.identification.small_index import pictures_of, small_index

VOLUMES = {"apple": (150.0, 180.0), "egg": (55.0,)}


def written(tmp_path, index, name="index.npz") -> bytes:
    write_index(tmp_path / name, index)
    return (tmp_path / name).read_bytes()


def arrays_of(content: bytes) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def archive_of(arrays: dict[str, np.ndarray]) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def test_index_is_read_as_it_was_written(tmp_path):
    index = small_index(volumes_ml=VOLUMES)
    again = read_index(io.BytesIO(written(tmp_path, index)), index.foods)
    assert (again.vcm_version, again.foods, again.specimens) == (index.vcm_version, index.foods, index.specimens)
    assert (again.calibration, dict(again.volumes_ml)) == (index.calibration, VOLUMES)
    for name in ("centre", "sd", "axes"):
        assert np.array_equal(getattr(again.metric, name), getattr(index.metric, name))
    assert np.array_equal(again.examples, index.examples)
    assert np.array_equal(again.labels, index.labels)
    asked = pictures_of("egg", 1, seed=9)[0]
    told, expected = (Identifier(NumberedIndex(one)).identify(asked) for one in (again, index))
    assert told.candidates == expected.candidates


@pytest.mark.parametrize(
    "change",
    [
        {"calibration": Calibration(0.2, 0.4)},
        {"volumes_ml": {"apple": (151.0, 180.0)}},
        {"vcm_version": "2"},
        {"specimens": ("other",) * 80},
        {"examples": np.zeros((80, 10))},
    ],
)
def test_version_changes_with_whatever_the_index_holds(tmp_path, change):
    index = small_index(volumes_ml=VOLUMES)
    first = read_index(io.BytesIO(written(tmp_path, index)), index.foods)
    other = read_index(io.BytesIO(written(tmp_path, replace(index, **change))), index.foods)
    assert other.version != first.version


def test_truncated_damaged_and_empty_archives_and_those_of_something_else_are_refused(tmp_path):
    content = written(tmp_path, small_index())
    for part in (b"", content[:20], content[: len(content) // 2], content[:-30], b"no archive" * 50):
        with pytest.raises(ValueError, match="no index of foods"):
            read_index(io.BytesIO(part), small_index().foods)
    one_array = io.BytesIO()
    np.save(one_array, np.zeros(3))
    text = io.BytesIO()
    with zipfile.ZipFile(text, "w") as archive:
        archive.writestr("vectors.npy", "no array")
    for content in (one_array.getvalue(), archive_of({"a": np.zeros(3)}), text.getvalue()):
        with pytest.raises(ValueError, match="no index of foods"):
            read_index(io.BytesIO(content), small_index().foods)


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("a pickle was loaded",))


def test_pickle_in_an_archive_is_refused_and_not_loaded(tmp_path):
    arrays = arrays_of(written(tmp_path, small_index()))
    for name in ("specimens", "examples"):
        content = archive_of(arrays | {name: np.array([Bomb()], object)})
        with pytest.raises(ValueError, match="no index of foods"):
            read_index(io.BytesIO(content), small_index().foods)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("labels", np.full(80, 4, np.uint8)),
        ("examples", np.zeros((80, 9), np.float16)),
        ("examples", np.full((80, 10), np.nan, np.float16)),
        ("examples", np.zeros((0, 10), np.float16)),
        ("centre", np.zeros(9)),
        ("axes", np.zeros((9, 10))),
        ("axes", np.zeros((10, 9))),
        ("calibration", np.array([0.0, 0.4])),
    ],
)
def test_parts_that_do_not_fit_together_are_refused(tmp_path, name, value):
    content = archive_of(arrays_of(written(tmp_path, small_index())) | {name: value})
    with pytest.raises(ValueError, match="no index of foods"):
        read_index(io.BytesIO(content), small_index().foods)


def test_label_that_is_not_known_is_named_and_labels_that_stand_twice_are_refused(tmp_path):
    content = written(tmp_path, small_index())
    with pytest.raises(ValueError, match="egg, plum"):
        read_index(io.BytesIO(content), small_index().foods[:2])
    header = "label,name,food_key\n"
    assert read_labels(header + "bun,Bun,bun\n") == (KnownFood("bun", "Bun", "bun"),)
    for twice in ("bun,Bun,bun\nbun,Roll,roll\n", "bun,Bun,bun\nroll,Roll,bun\n"):
        with pytest.raises(ValueError, match="twice"):
            read_labels(header + twice)
