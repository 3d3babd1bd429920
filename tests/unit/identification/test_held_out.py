import numpy as np
import pytest

from app.identification.build_index import scores_of_unseen_classes, scores_of_unseen_specimens, specimen_folds
from app.identification.kernel_classifier import KernelClassifier
from tests.unit.identification.clouds import clouds


def test_scores_of_unseen_specimens_are_those_of_fitting_again_and_classes_with_one_are_told():
    examples, labels = clouds((12, 9, 6))
    specimens = [f"{label}-{number // 3}" for number, label in enumerate(labels)]
    scores, _ = scores_of_unseen_specimens(examples, labels, specimens, 3)
    for held in specimen_folds(labels, specimens):
        kept = np.setdiff1d(np.arange(27), held)
        again = KernelClassifier(examples[kept], labels[kept], 3).scores(examples[held])
        assert scores[held] == pytest.approx(again, abs=1e-9)
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
    without = KernelClassifier(examples[kept], labels[kept] // 2, 2).scores(examples[labels == 1])
    assert scores.shape == (21, 2)
    assert scores[labels == 1] == pytest.approx(without, abs=1e-9)
