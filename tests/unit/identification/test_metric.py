import numpy as np
import pytest

from app.identification.metric import CLIP_SD, Metric, squared_distances
from tools.food_metric import MOST_AXES, BlockLayout, fit_metric

LAYOUT = (
    BlockLayout(3, is_histogram=False, share=0.25),
    BlockLayout(40, is_histogram=False, share=0.25),
    BlockLayout(9, is_histogram=True, share=0.5),
)


def examples(count: int = 150, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shares = rng.dirichlet(np.full(9, 0.7), count)
    units = 10.0 ** rng.uniform(-3.0, 3.0, 43)
    return np.concatenate([rng.normal(5.0, 1.0, (count, 43)) * units, np.sqrt(shares)], axis=1)


def slow_distance(metric: Metric, a: np.ndarray, b: np.ndarray) -> float:
    apart = []
    for i in range(len(a)):
        of_a = min(max((a[i] - metric.centre[i]) / metric.sd[i], -CLIP_SD), CLIP_SD)
        of_b = min(max((b[i] - metric.centre[i]) / metric.sd[i], -CLIP_SD), CLIP_SD)
        apart.append(of_a - of_b)
    return sum(float(np.dot(apart, axis)) ** 2 for axis in metric.axes.T)


def squares_between(vectors: np.ndarray, embedded: np.ndarray) -> np.ndarray:
    return squared_distances(embedded, embedded)[np.triu_indices(len(vectors), 1)]


def test_distance_of_embedded_vectors_is_that_of_the_slow_formula():
    vectors = examples()
    metric = fit_metric(vectors, LAYOUT)
    embedded = metric.embed(vectors)
    fast = squared_distances(embedded[:10], embedded[10:15])
    for i in range(10):
        for j in range(5):
            assert fast[i, j] == pytest.approx(slow_distance(metric, vectors[i], vectors[10 + j]), rel=1e-9)


def test_blocks_have_their_shares_of_the_distance_and_typical_regions_are_1_apart():
    vectors = examples()
    metric = fit_metric(vectors, LAYOUT)
    begins = 0
    for block in LAYOUT:
        alone = np.full_like(vectors, np.nan)
        alone[:, begins : begins + block.size] = vectors[:, begins : begins + block.size]
        squares = squares_between(vectors, metric.embed(alone))
        assert np.median(squares) == pytest.approx(block.share, rel=5e-3)
        begins += block.size
    assert np.median(squares_between(vectors, metric.embed(vectors))) == pytest.approx(1.0, rel=0.1)


def test_axes_are_those_along_which_examples_differ_and_few_keep_the_distances():
    rng = np.random.default_rng(3)
    vectors = rng.normal(0.0, 1.0, (600, 12)) @ rng.normal(0.0, 1.0, (12, 500))
    metric = fit_metric(vectors, (BlockLayout(500, is_histogram=False, share=1.0),))
    assert metric.axes.shape == (500, MOST_AXES)
    squares = squares_between(vectors, metric.embed(vectors))
    assert np.median(squares) == pytest.approx(1.0, rel=0.05)


def test_numbers_that_are_missing_are_those_of_the_average_region():
    vectors = examples()
    metric = fit_metric(vectors, LAYOUT)
    missing, average = vectors[:5].copy(), vectors[:5].copy()
    missing[:, 43:], average[:, 43:] = np.nan, metric.centre[43:]
    assert metric.embed(missing) == pytest.approx(metric.embed(average))


def test_what_never_varied_weighs_nothing():
    vectors = examples()
    vectors[:, 1] = 4.2  # a measure
    vectors[:, 43:] = 1.0 / 3.0  # a whole block
    metric = fit_metric(vectors, LAYOUT)
    assert (metric.axes[[1, *range(43, 52)]] == 0.0).all()
    other = vectors[:1].copy()
    other[0, 1], other[0, 43:] = 9.9, np.eye(9)[0]
    assert metric.embed(other) == pytest.approx(metric.embed(vectors[:1]))


def test_metric_of_one_example_is_finite_distances_never_negative_and_weights_bounded():
    metric = fit_metric(examples(1), LAYOUT)
    assert np.isfinite(metric.embed(examples(5, seed=2))).all()
    vectors = 1e4 + examples(40)
    assert (squared_distances(vectors, vectors) >= 0.0).all()
    vectors = examples()
    vectors[20:, 43:] = 1.0 / 3.0
    assert 0.0 < np.linalg.norm(fit_metric(vectors, LAYOUT).axes[43]) < 10.0


@pytest.mark.parametrize("vectors", [np.zeros((1, 51)), np.zeros((1, 1)), np.zeros(52), np.full((2, 52), np.inf)])
def test_vectors_of_another_length_or_of_no_numbers_raise(vectors):
    with pytest.raises(ValueError, match=r"numbers|finite"):
        fit_metric(examples(), LAYOUT).embed(vectors)
    with pytest.raises(ValueError, match="52"):
        fit_metric(examples()[:, :-1], LAYOUT)
