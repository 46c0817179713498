"""The tests of levels have power: what they allow is enough for the level, and too little for four times the level."""

import pytest
from scipy.stats import binom

from support.chance import most


@pytest.mark.parametrize(("runs", "level", "count"), [(80, 0.05, 9), (150, 0.05, 14), (400, 0.01, 9)])
def test_counts_are_those_of_the_binomial_distribution(runs, level, count):
    assert most(runs, level) == count
    assert binom.cdf(count, runs, level) >= 0.99 and binom.cdf(count, runs, 4 * level) <= 0.05


@pytest.mark.parametrize(("runs", "level"), [(20, 0.05), (60, 0.05), (200, 0.01)])
def test_too_few_runs_are_refused(runs, level):
    with pytest.raises(ValueError, match="pass at four times the level"):
        most(runs, level)
