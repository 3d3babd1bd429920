import numpy as np
import pytest

from app.identification.build_index import fit_metric
from app.identification.metric import CLIP_SD, BlockLayout, Metric, squared_distances

LAYOUT = (
    BlockLayout("narrow", 3, is_histogram=False),
    BlockLayout("wide", 40, is_histogram=False),
    BlockLayout("shares", 9, is_histogram=True),
)


def examples(count: int = 150, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shares = rng.dirichlet(np.full(9, 0.7), count)
    units = 10.0 ** rng.uniform(-3.0, 3.0, 43)
    return np.concatenate([rng.normal(5.0, 1.0, (count, 43)) * units, np.sqrt(shares)], axis=1)


def slow_distance(metric: Metric, a: np.ndarray, b: np.ndarray) -> float:
    total = 0.0
    for i in range(len(a)):
        of_a = min(max((a[i] - metric.centre[i]) / metric.sd[i], -CLIP_SD), CLIP_SD)
        of_b = min(max((b[i] - metric.centre[i]) / metric.sd[i], -CLIP_SD), CLIP_SD)
        total += (metric.weight[i] * (of_a - of_b)) ** 2
    return total


def test_distance_of_embedded_vectors_is_that_of_the_slow_formula():
    vectors = examples()
    metric = fit_metric(vectors, LAYOUT)
    embedded = metric.embed(vectors)
    fast = squared_distances(embedded[:10], embedded[10:15])
    for i in range(10):
        for j in range(5):
            assert fast[i, j] == pytest.approx(slow_distance(metric, vectors[i], vectors[10 + j]), rel=1e-9)


def test_blocks_weigh_the_same_and_typical_regions_are_1_apart():
    embedded = fit_metric(examples(), LAYOUT).embed(examples())
    begins = 0
    for block in LAYOUT:
        part = embedded[:, begins : begins + block.size]
        squares = squared_distances(part, part)[np.triu_indices(len(part), 1)]
        assert np.median(squares) == pytest.approx(1.0 / len(LAYOUT), rel=1e-6)
        begins += block.size
    squares = squared_distances(embedded, embedded)[np.triu_indices(len(embedded), 1)]
    assert np.median(squares) == pytest.approx(1.0, rel=0.1)


def test_what_never_varied_weighs_nothing():
    vectors = examples()
    vectors[:, 1] = 4.2  # a measure
    vectors[:, 43:] = 1.0 / 3.0  # a whole block
    metric = fit_metric(vectors, LAYOUT)
    assert (metric.weight[1], *metric.weight[43:]) == (0.0,) * 10
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
    assert 0.0 < fit_metric(vectors, LAYOUT).weight[43] < 10.0


@pytest.mark.parametrize("vectors", [np.zeros((1, 51)), np.zeros((1, 1)), np.zeros(52), np.full((2, 52), np.nan)])
def test_vectors_of_another_length_or_of_no_numbers_raise(vectors):
    with pytest.raises(ValueError, match=r"numbers|finite"):
        fit_metric(examples(), LAYOUT).embed(vectors)
    with pytest.raises(ValueError, match="52"):
        fit_metric(examples()[:, :-1], LAYOUT)
