"""Calibration: probabilities by Bayes' rule, and the temperature that makes them honest."""

import math

import numpy as np
import pytest

from app.identification.build_index import LEAST_TEMPERATURE, fit_calibration
from app.identification.kernel_classifier import NONE_PRIOR, posterior
from benchmarks.calibration_error import expected_calibration_error

CLASSES = 6


def simulated_scores(spread: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scores of known classes, their labels, and scores of unknown ones: normal around 1 in the own class and 0 else.

    log p(x | k) / p(x | none) = (x_k - 1/2) / spread^2: the temperature is spread^2, the none score 1/2.
    """
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, CLASSES, 6000)
    known = np.eye(CLASSES)[labels] + rng.normal(0.0, spread, (6000, CLASSES))
    return known, labels, rng.normal(0.0, spread, (6000, CLASSES))


@pytest.mark.parametrize("spread", [0.3, 0.45])
def test_temperature_and_none_score_of_simulated_scores_are_found(spread):
    found = fit_calibration(*simulated_scores(spread))
    assert found.temperature == pytest.approx(spread**2, rel=0.06)
    assert found.none_score == pytest.approx(0.5, abs=0.03)


def test_scores_that_part_all_classes_give_a_finite_calibration():
    labels = np.arange(CLASSES)
    found = fit_calibration(np.eye(CLASSES), labels, np.zeros((4, CLASSES - 1)))
    assert found.temperature >= LEAST_TEMPERATURE
    shares, none = posterior(*found.log_likelihoods(np.eye(CLASSES)), np.full(CLASSES, -math.log(CLASSES)))
    assert np.isfinite(shares).all()
    assert (shares[labels, labels] > 0.9).all()
    assert np.isfinite(none).all()


def test_calibration_without_examples_of_both_kinds_raises():
    known, labels, unknown = simulated_scores(0.3)
    for few in ((known[:0], labels[:0], unknown), (known, labels, unknown[:0])):
        with pytest.raises(ValueError, match="left out"):
            fit_calibration(*few)


def test_calibration_error_is_that_by_hand_0_for_certainty_that_is_right_and_1_for_one_that_is_wrong():
    probabilities = np.array([0.95, 0.97, 0.90, 0.55, 0.45, 0.41])
    is_right = np.array([True, True, False, True, False, True])
    # ten bins: two between 0.9 and 1 and 0.90 itself, one in 0.5, two in 0.4
    by_hand = (3 * abs(2 / 3 - 2.82 / 3) + 1 * abs(1.0 - 0.55) + 2 * abs(0.5 - 0.43)) / 6
    assert expected_calibration_error(probabilities, is_right, bins=10) == pytest.approx(by_hand)
    assert expected_calibration_error(np.ones(5), np.ones(5, bool)) == 0.0
    assert expected_calibration_error(np.ones(5), np.zeros(5, bool)) == 1.0
    with pytest.raises(ValueError, match="no probability"):
        expected_calibration_error(np.zeros(0), np.zeros(0, bool))


def test_posterior_is_bayes_rule_by_hand():
    likelihoods, none_likelihood = [0.2, 0.6, 0.1], 0.3
    prior, none_prior = [0.5, 0.2, 0.3], 0.1
    joint = [likelihood * share * 0.9 for likelihood, share in zip(likelihoods, prior, strict=True)]
    total = sum(joint) + none_likelihood * none_prior
    shares, none = posterior(
        np.log([likelihoods]) + 7.0, math.log(none_likelihood) + 7.0, np.log(prior), none_prior
    )  # up to one constant
    assert shares[0] == pytest.approx([each / total for each in joint])
    assert none[0] == pytest.approx(none_likelihood * none_prior / total)


def test_posterior_adds_up_to_1_however_far_the_likelihoods_are_and_takes_a_prior_a_row():
    likelihoods = np.array([[0.0, -800.0, 5.0], [900.0, -900.0, 0.0], [-1e6, -1e6, -1e6]])
    shares, none = posterior(likelihoods, -2.0, np.log([0.2, 0.3, 0.5]))
    assert shares.sum(axis=1) + none == pytest.approx(1.0)
    assert none[2] == pytest.approx(1.0)
    log_prior = np.log([[0.9, 0.1], [0.1, 0.9]])
    shares, _ = posterior(np.zeros((2, 2)), 0.0, log_prior)
    assert shares == pytest.approx(np.exp(log_prior) * (1.0 - NONE_PRIOR))
