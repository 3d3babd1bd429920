import math

import numpy as np
import pytest

from app.identification.kernel_classifier import (
    MISSING,
    NEAREST,
    RIDGE,
    WIDTH,
    KernelClassifier,
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
    raised = [(number + MISSING) / number for number in counts]
    return near @ coefficients * np.array(raised)


def test_scores_are_those_of_a_direct_dense_solve_whatever_the_order_of_examples():
    examples, labels = clouds((20, 7, 3))
    asked = clouds((3, 3, 3), seed=9)[0]
    fitted = KernelClassifier(examples, labels, 3).scores(asked)
    assert fitted == pytest.approx(direct_scores(examples, labels, 3, asked), abs=1e-8)
    examples, labels = clouds((20, 10, 5))
    order = np.random.default_rng(1).permutation(35)
    asked = clouds((2, 2, 2), seed=8)[0]
    one = KernelClassifier(examples, labels, 3).scores(asked)
    assert KernelClassifier(examples[order], labels[order], 3).scores(asked) == pytest.approx(one, abs=1e-9)


def test_likeness_and_score_are_near_1_amid_a_class_and_near_0_far_from_all():
    examples, _ = clouds((5, 5))
    assert np.diag(likeness(examples, examples)) == pytest.approx(1.0)
    assert likeness(examples, examples + 50.0) == pytest.approx(0.0)
    examples, labels = clouds((30, 30, 30))
    classifier = KernelClassifier(examples, labels, 3)
    assert classifier.scores(MIDDLES) == pytest.approx(np.eye(3), abs=0.2)
    assert classifier.scores(np.full((1, 3), 30.0)) == pytest.approx(0.0)


def test_only_the_nearest_examples_decide_and_a_class_without_any_scores_0():
    examples, labels = clouds((NEAREST, 20, 20))
    far = np.full((5, 3), 40.0)
    with_far = KernelClassifier(np.concatenate([examples, far]), np.concatenate([labels, np.full(5, 3)]), 4)
    near = np.argsort(np.linalg.norm(examples - MIDDLES[1], axis=1))[:NEAREST]
    asked = MIDDLES[1][None]
    expected = direct_scores(examples[near], labels[near], 3, asked)
    assert with_far.scores(asked)[0] == pytest.approx([*expected[0], 0.0], abs=1e-8)
