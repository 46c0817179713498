"""How many chance events a test of a level may allow: enough for that level, too few for four times that level.

Every such test states the probability with which it passes at its level and at four times that level (binomial).
"""

from __future__ import annotations

from scipy.stats import binom

PASSES, FAILS = 0.99, 0.95
"""Smallest probability of passing at the level, and of failing at four times the level."""


def most(runs: int, level: float) -> int:
    """The most events in so many independent runs; raises if they are too few to tell the level from its fourfold."""
    count = int(binom.ppf(PASSES, runs, level))
    undetected = binom.cdf(count, runs, 4 * level)
    if undetected > 1 - FAILS:
        raise ValueError(f"{runs} runs pass at four times the level of {level} with a probability of {undetected:.2f}")
    return count
