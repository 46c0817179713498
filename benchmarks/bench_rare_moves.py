"""Coverage where each set-point moves twice in the whole record, up and back: above all of dead times.

Simulated: one loop (2 exp(-4.6 s)/(10 s + 1) under a PI, 1,500 samples of 1 min, AR(1) disturbance with a pole of 0.9
and a standard deviation of 8 % of the move), and Wood-Berry under BLT PI (1,500 samples of 1 min, the two set-points
apart, AR(1) with a pole of 0.8 and 5 % of the move). The model is 20 to 30 % off. Prints for each parameter how often
its 95 % interval covers, and how often its error is beyond 4 standard errors, of the answers given.

    python benchmarks/bench_rare_moves.py [--runs 300] [--first 5000] [--only loop|wood-berry]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.simulated import BLT, WOOD_BERRY, coloured, segment_of
from trueplant.identify import identify_matrix, specs_of, unanswered
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix
from trueplant.lti.structure import structure_of

SAMPLES = 1500
FOPDT = Structure.parse("fopdt")
OFF = np.array([1.2, 0.8, 1.3])
"""The model's gain, lag and dead time over the plant's."""
LOOP = TransferMatrix.of([["2 exp(-4.6 s)/(10 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=0.3, Ti=15.0, sample_time=1.0)])
CASES = {"loop": (LOOP, LAW, 0.9, 0.08), "wood-berry": (WOOD_BERRY, BLT, 0.8, 0.05)}
"""Plant, controllers, the disturbance's pole and its size."""


def run(case: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(errors in standard errors, is the truth in the interval) of each parameter; NaN where there is no answer."""
    plant, law, pole, std = CASES[case]
    rng = np.random.default_rng(seed)
    n = plant.shape[0]
    r = np.zeros((SAMPLES, n))
    for i in range(n):
        up, down = (round(SAMPLES * (at + 0.1 * i)) for at in (0.2, 0.6))
        r[up:down, i] = 1.0
    record = segment_of(simulate(plant, law, r, 1.0, v=coloured(rng, SAMPLES, n, [1, -pole], [1], std)))
    truth = [[structure_of(plant[i, j])[1] for j in range(n)] for i in range(n)]
    model = TransferMatrix(tuple(tuple(FOPDT.transfer(theta * OFF) for theta in row) for row in truth), plant.time_unit)
    errors, covered = np.full((2, n, n, 3), np.nan)
    for i, estimate in identify_matrix([record], model, specs_of(model)).items():
        reasons = unanswered(estimate)
        for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
            true, (low, high) = truth[i][spec.column], estimate.intervals[part].T
            told = np.array([k not in reasons for k in range(part.start, part.stop)])
            z = (estimate.theta[part] - true) / np.sqrt(np.diag(estimate.covariance)[part])
            errors[i, spec.column] = np.where(told, z, np.nan)
            covered[i, spec.column] = np.where(told, (low <= true) & (true <= high), np.nan)
    return errors.reshape(-1, 3), covered.reshape(-1, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--first", type=int, default=5000)
    parser.add_argument("--only", choices=CASES)
    options = parser.parse_args()
    for case in [options.only] if options.only else CASES:
        begun = time.process_time()
        done = [run(case, seed) for seed in range(options.first, options.first + options.runs)]
        errors, covered = (np.concatenate(x) for x in zip(*done, strict=True))
        print(f"{case}, {options.runs} simulated records, seeds {options.first} on")
        for k, name in enumerate(("gain", "lag", "dead time")):
            z = errors[np.isfinite(errors[:, k]), k]
            share, far = 100 * np.nanmean(covered[:, k]), int(np.sum(np.abs(z) > 4))
            print(f"{name:12} covered {share:5.1f} % of {z.size} of {len(errors)}, beyond 4 standard errors {far}")
        print(f"{time.process_time() - begun:.0f} s of CPU", flush=True)


if __name__ == "__main__":
    main()
