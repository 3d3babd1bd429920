import math

import numpy as np
import pytest

from app.identification.kernel_classifier import (
    MISSING,
    MOST_RAISED,
    RIDGE,
    WIDTH,
    fit_classifier,
    likeness,
)
from tests.unit.identification.clouds import MIDDLES, clouds


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


def test_scores_are_those_of_a_direct_dense_solve_whatever_the_order_of_examples():
    examples, labels = clouds((20, 7, 3))
    asked = clouds((3, 3, 3), seed=9)[0]
    fitted = fit_classifier(examples, labels, 3).scores(asked)
    assert fitted == pytest.approx(direct_scores(examples, labels, 3, asked), abs=1e-8)
    examples, labels = clouds((20, 10, 5))
    order = np.random.default_rng(1).permutation(35)
    asked = clouds((2, 2, 2), seed=8)[0]
    one = fit_classifier(examples, labels, 3).scores(asked)
    assert fit_classifier(examples[order], labels[order], 3).scores(asked) == pytest.approx(one, abs=1e-9)


def test_likeness_and_score_are_near_1_amid_a_class_and_near_0_far_from_all():
    examples, _ = clouds((5, 5))
    assert np.diag(likeness(examples, examples)) == pytest.approx(1.0)
    assert likeness(examples, examples + 50.0) == pytest.approx(0.0)
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
