"""An operator's network: what it answers, how it is described, and that no fault of it reaches a meal."""

import hashlib
from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.candidates import classify
from app.candidates.classify import ClassifyFoods, read_classifier, read_model
from app.children.child_pool import ChildPool, ChildResult
from app.core.errors import Failure
from app.core.settings import Settings
from app.meals.estimate.photo_tasks import classify_task
from app.meals.stored.run_answer import RunAnswer
from app.operations.doctor.doctor_settings import look_at_classifier
from app.operations.doctor.finding import Deployment
from app.vision.looks.food_model import NetworkInput, classify_region, load_network
from app.worker import TASKS
from tests.support.estimates import answer, found_item
from tests.support.onnx_models import colour_classifier, colour_segmenter

SIDE = 8
LARGER = 10  # the photograph on the disk
RED_GREEN_BLUE = 4.0 * np.eye(3)
INPUT = NetworkInput(SIDE, SIDE, (0.0, 0.0, 0.0), (1 / 255, 1 / 255, 1 / 255), "rgb", "scores", 3)
SQUARE = [np.array([[20.0, 20.0], [59.0, 20.0], [59.0, 59.0], [20.0, 59.0]])]


def photo(bgr=(0, 0, 255), around=(0, 255, 0)):
    pixels = np.full((80, 100, 3), around, np.uint8)
    pixels[20:60, 20:60] = bgr
    return pixels


def softmax(scores):
    weights = np.exp(np.array(scores) - np.max(scores))
    return weights / weights.sum()


class Here:
    """Children that work in this process."""

    def __init__(self):
        self.asked = 0

    def run(self, request, on_stage, *, seconds=None):
        self.asked += 1
        assert request.task == "classify"
        assert seconds is not None
        return ChildResult("ok", classify_task(request.arguments, on_stage))


@pytest.fixture
def described(tmp_path):
    """Write a network with its description; returns the description's path."""

    def write(content=None, lines="", labels="label,food_key\nred,apple\ngreen,pear\nblue,\n"):
        content = colour_classifier(RED_GREEN_BLUE) if content is None else content
        (tmp_path / "colours.onnx").write_bytes(content)
        (tmp_path / "labels.csv").write_text(labels)
        described = {
            "model": '"colours.onnx"',
            "sha256": f'"{hashlib.sha256(content).hexdigest()}"',
            "labels": '"labels.csv"',
            "width_px": "8",
            "height_px": "8",
        } | dict(line.split(" = ") for line in lines.splitlines())
        (tmp_path / "model.toml").write_text("\n".join(f"{key} = {value}" for key, value in described.items()))
        cv2.imwrite(str(tmp_path / "left.png"), np.kron(photo(), np.ones((LARGER, LARGER, 1), np.uint8)))
        return tmp_path / "model.toml"

    return write


def meal(path, children=None, study="pilot"):
    """An answer of two items, the second out of view, after the classifier saw it."""
    polygon = (LARGER * SQUARE[0]).tolist()
    outside = (SQUARE[0] + 5000.0).tolist()
    run = RunAnswer.model_validate(answer(found_item(polygon=polygon), found_item(polygon=outside)))
    settings = Settings(data_dir=path.parent, classifier=path)
    ClassifyFoods(children or Here(), settings).add_candidates(study, run, path.parent / "left.png")
    return run


def test_classifier_answers_the_softmax_of_the_mean_colour_by_mean_scale_and_order_of_channels():
    network = load_network(colour_classifier(RED_GREEN_BLUE))
    uniform = photo((30, 60, 200), (30, 60, 200))
    expected = softmax(4.0 * np.array([200, 60, 30]) / 255)
    assert np.allclose(classify_region(network, INPUT, uniform, SQUARE), expected, atol=1e-5)
    form = NetworkInput(SIDE, SIDE, (10.0, 20.0, 30.0), (0.01, 0.02, 0.03), "bgr", "scores", 3)
    expected = softmax(4.0 * np.array([20 * 0.01, 40 * 0.02, 170 * 0.03]))
    assert np.allclose(classify_region(network, form, uniform, SQUARE), expected, atol=1e-5)


def test_segmenter_counts_the_outline_s_pixels_alone():
    network = load_network(colour_segmenter(RED_GREEN_BLUE, side=64))
    form = replace(INPUT, width_px=64, height_px=64)
    found = classify_region(network, form, photo(), SQUARE)
    assert np.allclose(found, softmax([4.0, 0.0, 0.0]), atol=0.05)  # the green around it would take a third
    left_half = [np.array([[20.0, 20.0], [40.0, 20.0], [40.0, 59.0], [20.0, 59.0]])]
    assert classify_region(network, form, photo((255, 0, 0)), left_half)[2] > 0.9


@pytest.mark.parametrize("content", [b"", b"no network", colour_classifier(RED_GREEN_BLUE)[:60]])
def test_bytes_that_are_no_network_are_a_failure(content):
    failure = load_network(content)
    assert isinstance(failure, Failure)
    assert failure.code == "classifier_not_loaded"


@pytest.mark.parametrize(
    ("content", "changes"),
    [
        (colour_classifier(RED_GREEN_BLUE), {"labels": 4}),
        (colour_classifier(RED_GREEN_BLUE), {"answers": "probabilities"}),
        (colour_segmenter(RED_GREEN_BLUE), {"labels": 2}),
        (colour_classifier(np.full((3, 3), np.inf)), {}),
    ],
)
def test_answers_of_another_shape_are_a_failure(content, changes):
    failure = classify_region(load_network(content), replace(INPUT, **changes), photo(), SQUARE)
    assert isinstance(failure, Failure)
    assert failure.code == "classifier_wrong_shape"


def test_foods_of_the_network_become_candidates_and_what_is_no_food_does_not(described):
    run = meal(described())
    seen, outside = run.items
    assert [each.food for each in seen.model_candidates] == ["apple", "pear"]
    assert seen.model_candidates[0].probability > seen.model_candidates[1].probability
    assert outside.model_candidates == []
    assert run.parameters["classifier"]["version"].startswith("colours ")
    assert run.parameters["classifier"]["failure"] is None


def test_labels_of_one_food_add_up_and_a_network_of_other_studies_or_unset_sees_nothing(described, tmp_path):
    run = meal(described(labels="label,food_key\nred,apple\ngreen,apple\nblue,apple\n"))
    assert [(each.food, each.probability) for each in run.items[0].model_candidates] == [("apple", 1.0)]
    children = Here()
    run = meal(described(lines='studies = ["other"]'), children)
    assert children.asked == 0
    assert "classifier" not in run.parameters
    assert meal(described(lines='studies = ["other", "pilot"]'), children).items[0].model_candidates
    run = RunAnswer.model_validate(answer(found_item()))
    ClassifyFoods(None, Settings(data_dir=tmp_path)).add_candidates("pilot", run, tmp_path / "left.png")
    assert run.items[0].model_candidates == []


@pytest.mark.parametrize(
    ("lines", "code"),
    [
        (f'sha256 = "{"0" * 64}"', "classifier_digest_differs"),
        ('model = "missing.onnx"', "classifier_unreadable"),
        ('labels = "missing.csv"', "classifier_unreadable"),
        ('labels = "model.toml"', "classifier_unreadable"),
        ("width_px = 100000", "classifier_unreadable"),
        ("mean = [nan, 0.0, 0.0]", "classifier_unreadable"),
        ("surprise = 1", "classifier_unreadable"),
        ('answers = "probabilities"', "classifier_wrong_shape"),
    ],
)
def test_wrong_descriptions_leave_the_meal_its_other_candidates_and_a_note(described, lines, code):
    run = meal(described(lines=lines))
    assert run.failure is None
    assert run.parameters["classifier"]["failure"] == code
    assert all(item.model_candidates == [] for item in run.items)


def test_missing_description_is_noted_and_a_model_beyond_the_limit_not_loaded(tmp_path, described, monkeypatch):
    assert meal(tmp_path / "none.toml").parameters["classifier"]["failure"] == "classifier_unreadable"
    path = described()
    classifier = read_classifier(path)
    assert isinstance(read_model(classifier.model, classifier.sha256), bytes)
    monkeypatch.setattr(classify, "MAX_MODEL_BYTES", 100)
    assert read_model(classifier.model, classifier.sha256).code == "classifier_too_large"


@pytest.mark.parametrize(
    ("ended", "code"),
    [
        (ChildResult("crashed", signal=11), "classifier_crashed"),
        (ChildResult("raised"), "classifier_crashed"),
        (ChildResult("timed_out", limit="30 s"), "classifier_timed_out"),
        (ChildResult("out_of_memory", limit="3 GiB"), "classifier_out_of_memory"),
    ],
)
def test_however_the_child_ends_the_meal_goes_on(described, ended, code):
    class Ended:
        def run(self, *_, **__):
            return ended

    run = meal(described(), Ended())
    assert run.parameters["classifier"]["failure"] == code
    assert run.failure is None


@pytest.mark.slow
def test_hostile_network_is_stopped_by_the_limited_child(described, tmp_path):
    """Its output would take 64 GiB, and the child may have one."""
    huge = colour_segmenter(np.zeros((3, 2**14)), side=1024)
    path = described(huge, "width_px = 1024\nheight_px = 1024", "label,food_key\n" + "x,\n" * 10_000)
    children = ChildPool(Settings(data_dir=tmp_path, estimate_memory_bytes=1024**3), TASKS)
    try:
        run = meal(path, children)
        after = meal(described(), children)
    finally:
        children.close()
    assert run.parameters["classifier"]["failure"] == "classifier_out_of_memory"
    assert [each.food for each in after.items[0].model_candidates] == ["apple", "pear"]


def test_doctor_tells_a_network_that_does_not_fit(described, tmp_path):
    settings = Settings(data_dir=tmp_path, classifier=described(lines='answers = "probabilities"'))
    level, message, _ = look_at_classifier(Deployment(None, settings, requeue=False))
    assert level == "bad"
    assert "sum to 1" in message
    assert look_at_classifier(Deployment(None, Settings(data_dir=tmp_path), requeue=False)) is None
