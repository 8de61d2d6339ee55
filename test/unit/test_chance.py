"""Probabilities by chance."""

import numpy as np
import pytest
from scipy.stats import kstest

from sugiyama_ros.diagnosis.chance import of_best


@pytest.mark.parametrize("tests", [1, 5, 30])
def test_the_smallest_of_several_p_values_is_corrected_to_a_uniform_one(tests):
    rng = np.random.default_rng(5)
    smallest = rng.random((1000, tests)).min(axis=1)
    # a correct p-value fails once in a thousand seeds
    assert kstest([of_best(p, tests) for p in smallest], "uniform").pvalue > 0.001


def test_a_correction_is_close_to_bonferronis_where_it_matters():
    assert of_best(1e-9, 30) == pytest.approx(3e-8, rel=1e-6)
    assert of_best(1e-300, 30) == pytest.approx(3e-299, rel=1e-6)
    assert 0.048 < of_best(0.05 / 30, 30) < 0.05
    assert of_best(0.5, 30) < 1.0
    assert of_best(1.0, 30) == 1.0
