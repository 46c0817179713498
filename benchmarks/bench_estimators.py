"""Continuous-time estimators on the field's benchmarks: error against the Cramer-Rao bound of each record, and bias.

Simulated records, seeds 20000 on, one process. For every method and parameter: mean and standard deviation over the
runs, rms error over the bound, bias in standard errors of the mean. The bound is that of the record used, operating
point (and start, where the record starts in motion) unknown, the noise model known up to its coefficients.

    python benchmarks/bench_estimators.py [--runs 1000] [--case NAME]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from bench_wood_berry import arma_bound

from support.benchmark_records import (
    CLOSED_LOOP,
    DELAYED,
    RAO_GARNIER,
    closed_loop_record,
    delayed_record,
    rao_garnier_record,
    tustin,
)
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of, wood_berry
from trueplant.errors import Refused
from trueplant.identify import Row, RowFit, Spec, estimate_row, fit_row, identify_matrix, pieces_of, specs_of
from trueplant.identify.estimate import fit_noise, largest_order
from trueplant.identify.instrumental import (
    ArmaNoise,
    Order,
    PolynomialFit,
    clsrivc,
    rivc,
    srivc,
    state_variable_filter,
    two_stage,
)
from trueplant.identify.instrumental.noise import without_noise_directions
from trueplant.identify.instrumental.refine import evaluate
from trueplant.identify.instrumental.samples import samples_of
from trueplant.identify.varx import varx
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix, tf
from trueplant.lti.structure import structure_of
from trueplant.mismatch import fit_locally
from trueplant.mismatch.sampling import sampled_frequency_response
from trueplant.record.types import Segment

FIRST_SEED = 20_000
Shared = dict[str, PolynomialFit]
"""SRIVC's result on the same record, from which the methods after it start."""
Method = Callable[[Segment, Shared], tuple[np.ndarray, np.ndarray]]
"""Estimate and claimed standard errors."""


def coefficients(method: Callable[[Segment, np.ndarray | None], PolynomialFit]) -> Method:
    def run(segment: Segment, shared: Shared) -> tuple[np.ndarray, np.ndarray]:
        fit = method(segment, shared["SRIVC"].theta if "SRIVC" in shared else None)
        if fit.method == "SRIVC":
            shared["SRIVC"] = fit
        return fit.theta, fit.std

    return run


def direct(order: Order, structure: str) -> Method:
    """The fit of `trueplant run` through a named structure, from SRIVC, noise order chosen, known dead time kept."""

    def run(segment: Segment, shared: Shared) -> tuple[np.ndarray, np.ndarray]:
        found, start = structure_of(shared["SRIVC"].transfer())
        assert found == Structure.parse(structure), found
        row = Row((Spec(0, found),), pieces_of([segment], 0))
        free = np.array([not name.startswith("dead") for name in found.names])
        fit = fit_row(row, start, np.zeros(0), free=free)
        for _ in range(2):
            ar = fit_noise(fit, None, largest_order(row, 30))
            fit = fit_row(row, fit.theta, ar, free=free)
        return as_coefficients(fit, order)

    return run


def searched(order: Order, structure: Structure) -> Method:
    """`estimate_row` with SRIVC for its model, knowing the structure alone: its own search comes after."""

    def run(segment: Segment, shared: Shared) -> tuple[np.ndarray, np.ndarray]:
        start = tuple(float(x) for x in shared["SRIVC"].as_structure(structure)[0])
        row = Row((Spec(0, structure, start),), pieces_of([segment], 0))
        return as_coefficients(estimate_row(row, 1.0), order)

    return run


def as_coefficients(fit: RowFit, order: Order) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the polynomials of a fitted structure, with standard errors to first order."""
    structure = fit.row.specs[0].structure

    def polynomials(p: np.ndarray) -> np.ndarray:
        (term,) = structure.transfer(p).terms
        padded = np.concatenate([np.zeros(order.zeros + 1 - len(term.num)), term.num])
        return np.array([*term.den[1:], *padded, *([] if order.keeps_dead_time else [term.dead_time])])

    step = 1e-6 * np.maximum(np.abs(fit.theta), 1e-3)
    moving = [k for k, name in enumerate(structure.names) if fit.free[k] or not name.startswith("dead")]
    slopes = np.zeros((polynomials(fit.theta).size, fit.theta.size))
    for k in moving:
        ahead, behind = fit.theta.copy(), fit.theta.copy()
        ahead[k] += step[k]
        behind[k] -= step[k] if not structure.names[k].startswith("dead") else 0.0
        slopes[:, k] = (polynomials(ahead) - polynomials(behind)) / (ahead[k] - behind[k])
    return polynomials(fit.theta), np.sqrt(np.diag(slopes @ fit.covariance @ slopes.T))


def bound(order: Order, truth: np.ndarray, segment: Segment, variance: float, noise: ArmaNoise) -> np.ndarray:
    """Variances of the Cramer-Rao bound; the coefficients of the noise model are unknown."""
    point = evaluate([order], truth, samples_of([segment], 0), noise=noise)
    zetas = without_noise_directions(noise, point.instruments, point.raw, point.errors, point.usable)
    information = sum(z.T @ z for z in zetas)
    scale = np.sqrt(np.diag(information))
    return variance * np.diag(np.linalg.inv(information / np.outer(scale, scale))) / scale**2


def compare(
    title: str,
    names: tuple[str, ...],
    truth: np.ndarray,
    record: Callable[[int], Segment],
    bound_of: Callable[[Segment], np.ndarray],
    methods: dict[str, Method],
    runs: int,
    wrong: Callable[[np.ndarray], bool] = lambda _: False,
) -> None:
    found: dict[str, list[np.ndarray]] = {name: [] for name in methods}
    claimed: dict[str, list[np.ndarray]] = {name: [] for name in methods}
    seconds = dict.fromkeys(methods, 0.0)
    failed = dict.fromkeys(methods, 0)
    bounds = []
    for k in range(runs):
        segment = record(FIRST_SEED + k)
        bounds.append(bound_of(segment))
        shared: Shared = {}
        for name, method in methods.items():
            begun = time.perf_counter()
            try:
                theta, std = method(segment, shared)
            except (AssertionError, np.linalg.LinAlgError) as error:
                print(f"  {name}, seed {FIRST_SEED + k}: {type(error).__name__} {error}")
                failed[name] += 1
                continue
            seconds[name] += time.perf_counter() - begun
            found[name].append(theta)
            claimed[name].append(std)
        if (k + 1) % 200 == 0 or k + 1 == runs:
            summarise(f"{title}: {k + 1} of {runs} runs", names, truth, bounds, found, claimed, seconds, failed, wrong)


def summarise(
    title: str,
    names: tuple[str, ...],
    truth: np.ndarray,
    bounds: list[np.ndarray],
    found: dict[str, list[np.ndarray]],
    claimed: dict[str, list[np.ndarray]],
    seconds: dict[str, float],
    failed: dict[str, int],
    wrong: Callable[[np.ndarray], bool],
) -> None:
    limit = np.sqrt(np.mean(bounds, axis=0))
    print(f"\n{title}, seeds {FIRST_SEED} on")
    print(f"{'':26}" + "".join(f"{n:>11}" for n in names))
    print(f"{'true':26}" + "".join(f"{v:11.5g}" for v in truth))
    print(f"{'Cramer-Rao std':26}" + "".join(f"{v:11.4g}" for v in limit))
    for name in found:
        theta = np.array(found[name])
        count = len(theta)
        spread = theta.std(axis=0)
        rms = np.sqrt(np.mean((theta - truth) ** 2, axis=0)) / limit
        bias = (theta.mean(axis=0) - truth) / spread * np.sqrt(count)
        ratio = np.sqrt(np.mean(np.square(claimed[name]), axis=0)) / spread
        hits = np.mean(np.abs(theta - truth) <= 1.96 * np.array(claimed[name]), axis=0)
        missed = sum(wrong(t) for t in theta)
        print(
            f"{name}: {seconds[name] / max(count, 1) * 1000:.0f} ms a run, {failed[name]} failed, {missed} wrong minima"
        )
        rows = {"mean": theta.mean(axis=0), "std": spread, "rms/bound": rms, "std/bound": spread / limit}
        rows |= {"bias in s.e.": bias, "claimed/std": ratio, "coverage": hits}
        for label, values in rows.items():
            print(f"  {label:24}" + "".join(f"{v:11.4g}" for v in values))
    sys.stdout.flush()


def rao_garnier(runs: int) -> None:
    order = Order(0, 4, 1)
    methods = {
        "equation error (25 rad/s)": coefficients(lambda s, p: state_variable_filter([s], 0, order, 25.0)),
        "its instrument": coefficients(lambda s, p: state_variable_filter([s], 0, order, 25.0, instrument=True)),
        "SRIVC": coefficients(lambda s, p: srivc([s], 0, [order], p)),
        "direct fit": direct(order, "pair+pair+lead"),
    }

    def limit(segment: Segment) -> np.ndarray:
        return bound(order, RAO_GARNIER, segment, 1.0638**2, ArmaNoise())

    compare("Rao-Garnier", order.names, RAO_GARNIER, rao_garnier_record, limit, methods, runs)


def closed(runs: int, noise: str) -> None:
    order = Order(0, 2, 1)
    methods = {
        "SRIVC": coefficients(lambda s, p: srivc([s], 0, [order], p)),
        "CLSRIVC": coefficients(lambda s, p: clsrivc([s], {0: [order]}, tustin(), {0: p})[0]),
        "CLSRIVC, wrong Q": coefficients(lambda s, p: clsrivc([s], {0: [order]}, tustin(6.0, 10.0), {0: p})[0]),
        "two-stage": coefficients(lambda s, p: two_stage([s], 0, [order], p)),
        "direct fit": direct(order, "pair+lead"),
    }
    if noise == "coloured":
        methods["RIVC"] = coefficients(lambda s, p: rivc([s], 0, [order], initial=p))
    model = ArmaNoise(np.array([-0.85]), np.array([0.5])) if noise == "coloured" else ArmaNoise()
    innovation = 0.00498**2
    if noise == "coloured":
        clean = closed_loop_record(0, "none").y[30:, 0]
        innovation = clean.var() / 10 / (1 + (0.5 + 0.85) ** 2 / (1 - 0.85**2))

    def limit(segment: Segment) -> np.ndarray:
        return bound(order, CLOSED_LOOP, segment, innovation, model)

    def record(seed: int) -> Segment:
        return closed_loop_record(seed, noise)

    compare(f"closed loop, {noise} noise", order.names, CLOSED_LOOP, record, limit, methods, runs)


def delay(runs: int) -> None:
    order = Order(0, 2, 1, None)
    std = np.std(delayed_record(0, np.inf).y[30:]) * 10 ** (-15 / 20)
    methods = {
        "SRIVC, dead time searched": coefficients(lambda s, p: srivc([s], 0, [order], p)),
        "direct fit, all searched": searched(order, Structure.parse("pair+lead")),
    }

    def limit(segment: Segment) -> np.ndarray:
        # dead time is on a whole sample, where the derivative has two sides: the mean of both informations
        sides = [DELAYED + side * np.array([0, 0, 0, 0, 1e-6]) for side in (-1, 1)]
        return 2 / sum(1 / bound(order, side, segment, std**2, ArmaNoise()) for side in sides)

    def wrong(theta: np.ndarray) -> bool:
        return bool(abs(theta[-1] - 8.0) > 0.1)

    compare("dead time with several minima", order.names, DELAYED, delayed_record, limit, methods, runs, wrong)


def quantised(runs: int) -> None:
    """Wood-Berry under BLT PI, AR(1) disturbance of std 0.3, PV rounded; no method is told the controller."""
    fopdt = Structure.parse("fopdt")
    for share in (0.5, 1.0, 0.1):
        quantum = 0.3 * share
        for i in range(2):
            truth = np.concatenate([structure_of(WOOD_BERRY[i, j])[1] for j in range(2)])
            start = truth * np.tile([1.3, 0.7, 1.5], 2)

            def record(seed: int, quantum: float = quantum) -> Segment:
                rng = np.random.default_rng(seed)
                r = random_switching(rng, 4000, 2, 20.0)
                v = coloured(rng, 4000, 2, [1, -0.8], [1], 0.3)
                return segment_of(simulate(WOOD_BERRY, BLT, r, 1.0, v=v, quantisation=quantum))

            def fitted(
                segment: Segment, _: Shared, i: int = i, start: np.ndarray = start
            ) -> tuple[np.ndarray, np.ndarray]:
                specs = tuple(Spec(j, fopdt, tuple(start[3 * j : 3 * j + 3])) for j in range(2))
                fit = estimate_row(Row(specs, pieces_of([segment], i)), 20.0)
                return fit.theta, np.sqrt(np.diag(fit.covariance))

            def limit(segment: Segment, i: int = i, truth: np.ndarray = truth, quantum: float = quantum) -> np.ndarray:
                row = Row(tuple(Spec(j, fopdt) for j in range(2)), pieces_of([segment], i))
                c, innovation = rounded_ar1(0.8, 0.3**2 * (1 - 0.8**2), quantum**2 / 12)
                return arma_bound(row, truth, [1, -0.8], [1, c], innovation)

            names = tuple(f"{p}{i + 1}{j + 1}" for j in range(2) for p in ("K", "tau", "theta"))
            title = f"Wood-Berry, output {i + 1}, PV rounded to {share:g} of the disturbance's std"
            compare(title, names, truth, record, limit, {"direct fit": fitted}, runs)


def black_box(runs: int) -> None:
    """How often the chi-square test of `identify.varx` rejects elements of the true Wood-Berry plant at 5 %."""
    print("\nBlack-box test of the true plant, share rejected at 5 %, by lags of the ARX model")
    segments = [segment_of(wood_berry(FIRST_SEED + k)) for k in range(min(runs, 100))]
    for lags in (12, 24, 48, 64):
        # without the check that refuses too short a memory: this shows why it is there
        models = [varx([segment], lags) for segment in segments]
        p = np.array([m.distance(sampled_frequency_response(WOOD_BERRY, m.tested, m.h), m.tested)[0] for m in models])
        shares = ", ".join(f"{x:.3f}" for x in np.mean(p < 0.05, axis=0).ravel())
        print(f"{lags:4d} lags, {len(segments)} runs: {shares} (elements 11, 12, 21, 22)", flush=True)


LEADS = {
    "inverse response": "6.6 (-8 s + 1) exp(-3 s)/((10.9 s + 1)(5 s + 1))",
    "overshoot": "6.6 (25 s + 1) exp(-7 s)/((10.9 s + 1)(5 s + 1))",
}
LEADLESS = (6.6, 10.9, 0.545, 1.09, 7.4)
"""Where the search begins for a first-order model under the structure with a lead."""


def leads(runs: int) -> None:
    """How often an element with a lead in a 2x2 loop is found: from one start, and as every analysis searches."""
    print("\nRight minimum of an element of two lags and a lead (lead within 30 % of the truth), of all records")
    structure, fopdt = Structure.parse("sopdt+lead"), Structure.parse("fopdt")
    law = Controller.diagonal([PID(Kc=0.2, Ti=12, sample_time=1.0), PID(Kc=-0.05, Ti=25, sample_time=1.0)])
    known = tuple(structure_of(WOOD_BERRY[1, 1])[1])
    for name, element in LEADS.items():
        plant = TransferMatrix((WOOD_BERRY.elements[0], (tf(element), WOOD_BERRY[1, 1])), "min")
        truth = structure_of(tf(element))[1]
        for said, start, model in (("no model", None, "0"), ("no lead", LEADLESS, "6.6 exp(-7.4 s)/(10.9 s + 1)")):
            specs = {(1, 0): Spec(0, structure, start), (1, 1): Spec(1, fopdt, known)}
            declared = TransferMatrix((WOOD_BERRY.elements[0], (tf(model), WOOD_BERRY[1, 1])), "min")
            right = {"one start": 0, "both": 0}
            for k in range(runs):
                rng = np.random.default_rng(FIRST_SEED + k)
                r, v = random_switching(rng, 3000, 2, 20.0), coloured(rng, 3000, 2, [1, -0.8], [1], 0.3)
                segment = segment_of(simulate(plant, law, r, 1.0, v=v))
                alone = estimate_row(Row((specs[1, 0], specs[1, 1]), pieces_of([segment], 1)), known[1])
                both = identify_matrix([segment], declared, specs)[1]
                for way, theta in (("one start", alone.theta), ("both", both.theta)):
                    right[way] += bool(abs(theta[3] - truth[3]) < 0.3 * abs(truth[3]))
            print(f"{name}, model: {said}: {right['one start']} from one start, {right['both']} of {runs}", flush=True)


def forms(runs: int) -> None:
    """Closed form and joint form on one loop, by the size of a slow disturbance, and under a controller that is not."""
    print("\nOne loop, AR(1) disturbance with pole 0.9: gain, lag and dead time; rms error over that of the direct fit")
    plant = TransferMatrix.of([["2.0 exp(-3.2 s)/(10 s + 1)"]], "min")
    model = TransferMatrix.of([["1.6 exp(-3 s)/(10 s + 1)"]], "min")
    law, other = (Controller.diagonal([PID(Kc=k, Ti=9.0, sample_time=0.5)]) for k in (0.9, 0.6))
    fopdt, truth = {(0, 0): Structure.parse("fopdt")}, np.array([2.0, 10.0, 3.2])
    ways = {
        "joint": ("joint", None),
        "closed-form": ("closed-form", law),
        "closed-form, Kc 0.6": ("closed-form", other),
    }
    for size in (0.34, 0.11, 0.046):
        found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"direct": [], **{way: [] for way in ways}}
        for k in range(runs):
            rng = np.random.default_rng(FIRST_SEED + k)
            r, v = random_switching(rng, 3000, 1, 60.0), coloured(rng, 3000, 1, [1, -0.9], [1], size)
            segment = segment_of(simulate(plant, law, r, 0.5, v=v))
            direct = identify_matrix([segment], model, specs_of(model))[0]
            found["direct"].append((direct.theta, np.sqrt(np.diag(direct.covariance))))
            for way, (method, controller) in ways.items():
                try:
                    fit = fit_locally([segment], fopdt, model, method, controller)
                except Refused:
                    continue
                found[way].append((fit.parameters[0, 0], np.sqrt(np.diag(fit.covariance[0, 0]))))
        least = np.sqrt(np.mean([(p - truth) ** 2 for p, _ in found["direct"]], axis=0))
        for way, answers in found.items():
            if not answers:
                print(f"std {size:g}, {way}: answers none of {runs}", flush=True)
                continue
            p, e = (np.array([answer[q] for answer in answers]) for q in (0, 1))
            rms, covered = (
                np.sqrt(np.mean((p - truth) ** 2, axis=0)) / least,
                np.mean(np.abs(p - truth) < 1.96 * e, axis=0),
            )
            print(
                f"std {size:g}, {way}: answers {len(answers)} of {runs}, mean {np.round(p.mean(axis=0), 3)}, "
                f"rms {np.round(rms, 2)}, coverage {np.round(100 * covered, 1)} %",
                flush=True,
            )


def rounded_ar1(pole: float, driving: float, white: float) -> tuple[float, float]:
    """c and innovation variance of the ARMA(1, 1) that AR(1) noise plus white rounding errors is (spectral factor)."""
    total, cross = driving + white * (1 + pole**2), -white * pole
    innovation = (total + np.sqrt(total**2 - 4 * cross**2)) / 2
    return cross / innovation, innovation


def main() -> None:
    cases: dict[str, Callable[[int], None]] = {
        "rao-garnier": rao_garnier,
        "closed-coloured": lambda runs: closed(runs, "coloured"),
        "delay": delay,
        "closed-white": lambda runs: closed(runs, "white"),
        "quantised": quantised,
        "black-box": black_box,
        "leads": leads,
        "forms": forms,
    }
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--case", choices=["all", *cases], default="all")
    options = parser.parse_args()
    for name, case in cases.items():
        if options.case in ("all", name):
            begun = time.perf_counter()
            case(options.runs)
            print(f"{name}: {time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
