import math

import numpy as np
import pytest

from app.identification.calibrate import NONE_PRIOR, Calibration, posterior


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


def test_higher_temperature_brings_likelihoods_together():
    scores = np.array([[0.9, 0.3]])
    cold, _ = Calibration(0.1, 0.4).log_likelihoods(scores)
    warm, none = Calibration(0.2, 0.4).log_likelihoods(scores)
    assert np.ptp(cold) == pytest.approx(2.0 * np.ptp(warm))
    assert none == pytest.approx(2.0)
