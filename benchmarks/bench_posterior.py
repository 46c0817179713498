"""The paper's grinding mill, simulated: are plants drawn from an answer as often unstable as the posterior's own?

For each record (that of `bench_mill`) the analysis draws plants from its normal distribution, as it does for what it
says of today's loop and of new settings. Importance sampling draws from the likelihood of each row itself, noise model
included. Printed are, for both, the share of plants that today's controller does not stabilise, how many independent
draws the sample is worth, and how the net gain of (1, 2) spreads.

    python benchmarks/bench_posterior.py [--records 6] [--draws 10000] [--workers 2]
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from bench_mill import record
from random_plants import decided

from trueplant.identify.fit import evaluate
from trueplant.lti import DrawnPlants
from trueplant.plants import mill
from trueplant.study.loops.metrics import drawn_peaks
from trueplant.study.plant.updated import updated_plant
from trueplant.tune import common_grid

ROUNDS, EACH_ROUND = 6, 4000
"""In which the distribution that is drawn from settles, and draws of each."""
TAILS = 5.0
"""Degrees of freedom of that distribution: its tails are heavier than those of what is sought."""
HIGHEST = 20.0
"""rad/min: well beyond the crossover of both loops."""
SHARES = (0.05, 0.2, 0.5)
"""Of the answer's plants that are to be unstable."""


def sampled(estimate, draws, rng):
    """Samples (n, size) of the row's parameters by its likelihood, drawn by their weights, and their effective number.

    Importance sampling from a Student t distribution that takes mean and covariance from what it has seen. It is one
    of the net gain, and of the logarithms of the larger gain and of the dead times' difference, of elements with two
    delayed terms: their products are what a record knows, so that it is far from normal in the parameters.
    """
    fit = estimate.fit
    low, high = fit.row.bounds()
    size = fit.theta.size
    pairs = [
        (part.start, part.stop - 2)
        for spec, part in zip(fit.row.specs, fit.row.slices, strict=True)
        if spec.structure.delayed == 2
    ]

    def theta_of(x):
        theta = x.copy()
        for gain, dead in pairs:
            theta[gain] = np.exp(x[gain])
            theta[gain + 1] = x[gain + 1] - theta[gain]
            theta[dead + 1] = x[dead] + np.exp(x[dead + 1])
        return theta

    def seen_from(theta):
        x = theta.copy()
        for gain, dead in pairs:
            x[gain], x[gain + 1] = np.log(theta[gain]), theta[gain] + theta[gain + 1]
            x[dead + 1] = np.log(theta[dead + 1] - theta[dead])
        return x

    def log_density(x):
        theta = theta_of(x)
        if np.any(theta[:size] < low) or np.any(theta[:size] > high):
            return -np.inf
        cost = evaluate(fit.row, theta[:size], theta[size:], fit.weights).cost
        volume = sum(x[gain] + x[dead + 1] for gain, dead in pairs)
        return volume - 0.5 * fit.left * np.log(cost) if np.isfinite(cost) else -np.inf

    mean = seen_from(np.concatenate([fit.theta, fit.ar]))
    slopes = np.array([(theta_of(mean + 1e-6 * d) - theta_of(mean - 1e-6 * d)) / 2e-6 for d in np.eye(mean.size)]).T
    spread = fit.variance * np.linalg.inv(slopes.T @ fit.information @ slopes)
    for _ in range(ROUNDS):
        x, weights = _weighted(log_density, mean, spread, EACH_ROUND, rng)
        mean = weights @ x
        spread = (x - mean).T @ ((x - mean) * weights[:, None])
    count = int(1.2 * draws * EACH_ROUND / _effective(_weighted(log_density, mean, spread, EACH_ROUND, rng)[1]))
    x, weights = _weighted(log_density, mean, spread, count, rng)
    picked = rng.choice(count, count, p=weights)
    return np.array([theta_of(one)[:size] for one in x[picked]]), _effective(weights)


def _weighted(log_density, mean, spread, count, rng):
    """Points of a Student t distribution about a mean, and the weights, one in sum, that make them a density's."""
    normal, size = rng.standard_normal((count, mean.size)), mean.size
    stretched = rng.chisquare(TAILS, count) / TAILS
    x = mean + normal @ _root(spread).T / np.sqrt(stretched)[:, None]
    own = -0.5 * (TAILS + size) * np.log1p(np.sum(normal**2, axis=1) / stretched / TAILS)
    logs = np.array([log_density(one) for one in x]) - own
    weights = np.exp(logs - logs.max())
    return x, weights / weights.sum()


def _root(covariance):
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def _effective(weights):
    """Independent samples that weighted ones are worth (Kong 1992)."""
    return float(1 / np.sum(weights**2))


def unstable(plants, controller, gain=1.0):
    """Share of the drawn plants that the controller, its gains raised, does not stabilise."""
    w = common_grid(plants.nominal, controller, HIGHEST)
    stable = [
        drawn_peaks(gain * part.response(w), controller, w).stable
        for part in (_part(plants, k, k + 500) for k in range(0, plants.count, 500))
    ]
    return 1 - float(np.mean(np.concatenate(stable)))


def gain_for(share, plants, controller):
    """The factor on the controller's gains at which so many of the plants are unstable."""
    low, high, some = 1.0, 50.0, _part(plants, 0, 1000)
    for _ in range(12):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if unstable(some, controller, middle) > share else (middle, high)
    return float(np.sqrt(low * high))


def _part(plants, first, last):
    last = min(last, plants.count)
    cut = {at: (structure, values[first:last]) for at, (structure, values) in plants.parameters.items()}
    return DrawnPlants(plants.nominal, cut, last - first)


def net_gain(plants):
    """5, 50 and 95 % quantiles of the gain of (1, 2)."""
    structure, values = plants.parameters[0, 1]
    return np.quantile(values[:, : structure.delayed].sum(axis=1), [0.05, 0.5, 0.95])


def compare(seed, draws):
    """Factor on the gains, and shares of unstable plants by the answer and by the likelihood; what the latter's sample
    is worth; quantiles of the net gain by both."""
    frame, project = record(seed)
    found = decided(project, frame)
    controller = mill("eq37").controller
    plant = updated_plant(mill("eq37").model, found.estimates)
    drawn = plant.draw(draws, seed)
    rng = np.random.default_rng(1000 + seed)
    parameters, sizes = {}, []
    for i, estimate in found.estimates.items():
        sample, size = sampled(estimate, draws, rng)
        sizes.append(size)
        for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
            parameters[i, spec.column] = spec.structure, sample[:draws, part]
    posterior = DrawnPlants(plant.nominal, parameters, min(len(v) for _, v in parameters.values()))
    gains = [1.0, *(gain_for(share, drawn, controller) for share in SHARES)]
    shares = [(gain, unstable(drawn, controller, gain), unstable(posterior, controller, gain)) for gain in gains]
    return shares, min(sizes), net_gain(drawn), net_gain(posterior)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=6)
    parser.add_argument("--draws", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = "1"
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        job = partial(compare, draws=options.draws)
        for k, (shares, size, own, other) in enumerate(pool.map(job, range(options.records))):
            print(f"record {k}: the likelihood's sample is worth {size:.0f} draws", flush=True)
            spreads = " and ".join(np.array2string(one, precision=4) for one in (own, other))
            print(f"  net gain of (1, 2), 5, 50, 95 %, by the answer and by the likelihood: {spreads}")
            for gain, answer, by_likelihood in shares:
                print(f"  gains times {gain:6.3f}: unstable {100 * answer:6.2f} and {100 * by_likelihood:6.2f} %")


if __name__ == "__main__":
    main()
