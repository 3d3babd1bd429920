import math

import numpy as np
import pytest

from app.identification.held_out import scores_of_unseen_classes, scores_of_unseen_specimens, specimen_folds
from app.identification.kernel_classifier import (
    MISSING,
    MOST_RAISED,
    RIDGE,
    WIDTH,
    fit_classifier,
    held_out_scores,
    likeness,
)

MIDDLES = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.0, 1.2, 0.0]])


def clouds(counts: tuple[int, ...], spread: float = 0.2, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    labels = np.repeat(np.arange(len(counts)), counts)
    rng = np.random.default_rng(seed)
    return MIDDLES[labels] + rng.normal(0.0, spread, (len(labels), 3)), labels


def direct_scores(examples: np.ndarray, labels: np.ndarray, classes: int, asked: np.ndarray) -> np.ndarray:
    """k(asked) (K + ridge N)^-1 Y, by loops and a general solver."""
    count = len(examples)
    kernel = np.zeros((count, count))
    for i in range(count):
        for j in range(count):
            kernel[i, j] = math.exp(-WIDTH * math.dist(examples[i], examples[j]) ** 2)
    roots = [math.sqrt(np.count_nonzero(labels == label)) for label in labels]
    for i in range(count):
        kernel[i, i] += RIDGE * roots[i] / (sum(roots) / count)
    members = np.array([[float(label == each) for each in range(classes)] for label in labels])
    coefficients = np.linalg.solve(kernel, members)
    near = np.array([[math.exp(-WIDTH * math.dist(a, b) ** 2) for b in examples] for a in asked])
    counts = [max(np.count_nonzero(labels == label), 1) for label in range(classes)]
    raised = [min((number + MISSING) / number, MOST_RAISED) for number in counts]
    return near @ coefficients * np.array(raised)


def test_scores_are_those_of_a_direct_dense_solve():
    examples, labels = clouds((20, 7, 3))
    asked = clouds((3, 3, 3), seed=9)[0]
    fitted = fit_classifier(examples, labels, 3).scores(asked)
    assert fitted == pytest.approx(direct_scores(examples, labels, 3, asked), abs=1e-8)


def test_held_out_scores_are_those_of_fitting_again_without_the_fold():
    examples, labels = clouds((12, 9, 6))
    folds = [np.arange(0, 27, 3), np.arange(1, 27, 3), np.arange(2, 27, 3)]
    scores = held_out_scores(examples, labels, 3, folds)
    for held in folds:
        kept = np.setdiff1d(np.arange(27), held)
        again = fit_classifier(examples[kept], labels[kept], 3).scores(examples[held])
        assert scores[held] == pytest.approx(again, abs=1e-9)


def test_likeness_is_1_to_itself_and_0_to_what_is_far():
    examples, _ = clouds((5, 5))
    assert np.diag(likeness(examples, examples)) == pytest.approx(1.0)
    assert likeness(examples, examples + 50.0) == pytest.approx(0.0)


def test_score_is_near_1_amid_a_class_and_near_0_far_from_all():
    examples, labels = clouds((30, 30, 30))
    classifier = fit_classifier(examples, labels, 3)
    assert classifier.scores(MIDDLES) == pytest.approx(np.eye(3), abs=0.2)
    assert classifier.scores(np.full((1, 3), 30.0)) == pytest.approx(0.0)


def test_class_of_five_stands_beside_one_of_seventy():
    asked, truth = clouds((100, 100), spread=0.25, seed=99)
    right = []
    for seed in range(10):
        examples, labels = clouds((70, 5), spread=0.25, seed=seed)
        best = fit_classifier(examples, labels, 2).scores(asked).argmax(axis=1)
        right.append([(best[truth == label] == label).mean() for label in (0, 1)])
    of_seventy, of_five = np.mean(right, axis=0)
    assert of_seventy > 0.97
    assert of_five > 0.85  # five examples do not tell the whole cloud


def test_same_example_twice_and_under_two_names_can_be_solved():
    examples = np.zeros((4, 3))
    scores = fit_classifier(examples, np.array([0, 0, 1, 1]), 2).scores(examples[:1])
    assert scores == pytest.approx(0.5 * min((2 + MISSING) / 2, MOST_RAISED), abs=0.02)


def test_score_is_about_the_same_however_few_examples_a_class_has():
    """Of a class whose examples are all around: what is missing of a small one is made up for."""
    asked = clouds((60, 1), seed=50)[0][:60]
    told = []
    for count in (3, 5, 10, 40):
        examples, labels = clouds((count, 40), seed=3)
        told.append(fit_classifier(examples, labels, 2).scores(asked)[:, 0].mean())
    assert max(told) < 1.25 * min(told)


def test_order_of_examples_does_not_count():
    examples, labels = clouds((20, 10, 5))
    order = np.random.default_rng(1).permutation(35)
    asked = clouds((2, 2, 2), seed=8)[0]
    one = fit_classifier(examples, labels, 3).scores(asked)
    assert fit_classifier(examples[order], labels[order], 3).scores(asked) == pytest.approx(one, abs=1e-9)


# ---- what is held out


def test_specimen_is_never_on_both_sides_and_each_row_is_held_out_once():
    labels = np.repeat([0, 1], [30, 12])
    specimens = [f"{label}-{number // 3}" for number, label in enumerate(labels)]
    folds = specimen_folds(labels, specimens)
    assert sorted(np.concatenate(folds).tolist()) == list(range(42))
    for held in folds:
        kept = set(range(42)) - set(held.tolist())
        assert not {specimens[row] for row in held} & {specimens[row] for row in kept}
    assert len(folds) == 10
    assert [held.tolist() for held in specimen_folds(labels, specimens)] == [held.tolist() for held in folds]


def test_classes_with_one_specimen_are_told():
    examples, labels = clouds((6, 6, 4))
    specimens = ["a1"] * 3 + ["a2"] * 3 + ["b1"] * 3 + ["b2"] * 3 + ["c1"] * 4
    scores, has_another = scores_of_unseen_specimens(examples, labels, specimens, 3)
    assert has_another.tolist() == [True] * 12 + [False] * 4
    assert (scores[:12].argmax(axis=1) == labels[:12]).all()
    assert (scores[12:, 2] == 0.0).all()  # nobody was left to know it by


def test_scores_of_unseen_classes_are_those_of_a_classifier_without_them():
    examples, labels = clouds((8, 7, 6))
    scores = scores_of_unseen_classes(examples, labels, 3)
    kept = labels != 1
    without = fit_classifier(examples[kept], labels[kept] // 2, 2).scores(examples[labels == 1])
    assert scores.shape == (21, 2)
    assert scores[labels == 1] == pytest.approx(without, abs=1e-9)
