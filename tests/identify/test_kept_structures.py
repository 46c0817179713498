"""Structures that are kept though the record rejects them: gain and time to answer are those of the plant yet."""

from __future__ import annotations

from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import Spec, identify_matrix
from trueplant.identify.kept_structures import Told, counting, with_richer
from trueplant.identify.moments import directions, moments
from trueplant.identify.output import OutputEstimate
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix
from trueplant.result.budget import Source

Array = np.ndarray
FOPDT = Structure.parse("fopdt")
LAW = Controller.diagonal([PID(Kc=0.3, Ti=12.0, sample_time=1.0)])
TIMES = {
    "2 exp(-3 s)/(12 s + 1)": 15.0,
    "2 (-4 s + 1) exp(-3 s)/((12 s + 1)(5 s + 1))": 24.0,
    "2 exp(-3 s)/((12 s + 1)(8 s + 1))": 23.0,
    "2 exp(-3 s)/(100 s^2 + 10 s + 1)": 13.0,
    "2 (70 s + 1) exp(-2 s)/((10 s + 1)(100 s + 1))": 42.0,
}
"""Plants of gain 2, and the first moments of their impulse responses."""
PARAMETERS = {
    "fopdt": [2.0, 10.0, 3.0],
    "sopdt+lead": [2.0, 10.0, 4.0, -3.0, 1.0],
    "pair+lag": [-1.5, 8.0, 0.2, 0.6, 2.0],
    "fopdt+delayed": [3.0, -1.0, 10.0, 1.0, 6.0],
    "integrator+lag": [0.4, 5.0, 2.0],
    "gain": [2.0],
}


def found(plant: str, seed: int) -> OutputEstimate:
    """A simulated single loop under PI, declared as of first order, which is kept."""
    rng = np.random.default_rng(seed)
    r, v = random_switching(rng, 1500, 1, 40.0), coloured(rng, 1500, 1, [1, -0.8], [1], 0.1)
    record = segment_of(simulate(TransferMatrix.of([[plant]], "min"), LAW, r, 1.0, v=v))
    model = TransferMatrix.of([["2 exp(-3 s)/(12 s + 1)"]], "min")
    return identify_matrix([record], model, {(0, 0): Spec(0, FOPDT, (2.0, 12.0, 3.0))})[0]


@pytest.mark.parametrize("name", PARAMETERS)
def test_gain_and_time_are_moments_of_the_impulse_response(name: str) -> None:
    """Of the transfer function at 0, without its integrators: G(0), and -G'(0)/G(0); derivatives by differences."""
    structure, p = Structure.parse(name), np.array(PARAMETERS[name])
    (gain, time), derivatives = moments(structure, p)
    step, transfer = 1e-4, structure.transfer(p)

    def at(s: float) -> float:
        return float(np.real(transfer(np.array([s + 0j])))[0]) * s**structure.integrators

    assert gain == pytest.approx((at(step) + at(-step)) / 2, rel=1e-5)
    if structure.delayed == 1:
        assert time == pytest.approx((at(-step) - at(step)) / (2 * step) / gain, rel=1e-4, abs=1e-6)
    for k in range(p.size):
        there = p.copy()
        there[k] += 1e-6
        moved, _ = moments(structure, there)
        assert derivatives[:, k] == pytest.approx((moved - [gain, time]) / 1e-6, abs=1e-3)


@pytest.mark.parametrize("name", PARAMETERS)
def test_an_element_moves_by_its_gain_or_its_time_alone(name: str) -> None:
    structure, p = Structure.parse(name), np.array(PARAMETERS[name])
    _, derivatives = moments(structure, p)
    has_time = np.any(derivatives[1])
    assert directions(structure, p) @ derivatives.T == pytest.approx(np.diag([1.0, float(has_time)]), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("plant", TIMES)
def test_the_true_gain_and_time_are_covered_whatever_the_plant_is(plant: str) -> None:
    by_time = np.array([0.0, 1.0, 1.0])
    estimates = [found(plant, seed) for seed in range(3)]
    for estimate in estimates:
        assert estimate.row.specs[0].structure == FOPDT
        assert estimate.kept == (() if plant.endswith("3 s)/(12 s + 1)") else (0,))
        low, high = estimate.intervals[0]
        assert low <= 2 <= high
        error = np.sqrt(by_time @ estimate.covariance @ by_time)
        assert abs(by_time @ estimate.theta - TIMES[plant]) < 3 * error
        assert (Source.STRUCTURE in estimate.budget.parts) is bool(estimate.kept)


def of(name: str, p: list[float], errors: list[float], copies: int = 1) -> Any:
    """An estimate of a row of that many elements, all alike."""
    size = copies * len(p)
    slices = [slice(first, first + len(p)) for first in range(0, size, len(p))]
    row = Stub(specs=[Spec(m, Structure.parse(name)) for m in range(copies)], slices=slices)
    fit = Stub(standard_errors_by_data=np.zeros(size))
    return Stub(row=row, theta=np.tile(p, copies), covariance=np.diag(np.tile(np.square(errors), copies)), fit=fit)


@pytest.mark.holds("identify.RICHER_MEANT")
def test_a_richer_structure_is_as_likely_meant_as_what_comes_nearest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains 2 and 3, times 13 and 18: on average 2.5 and 15.5, and half of what the richer one knows less well."""
    monkeypatch.setattr(
        "trueplant.identify.kept_structures.averaged",
        lambda own, shifts, shares, _confidence, _source, spreads: (shares @ shifts, np.tensordot(shares, spreads, 1)),
    )
    own = of("fopdt", [2.0, 10.0, 3.0], [0.1, 0.5, 0.1])
    other = of("sopdt", [3.0, 10.0, 6.0, 2.0], [0.4, 1.0, 1.0, 0.1])
    shift, spread = with_richer(own, other, 0.95)  # type: ignore[misc]
    assert shift == pytest.approx([0.5, 2.5, 0.0], rel=0.2)
    assert np.diag(spread) == pytest.approx([(0.4**2 - 0.1**2) / 2, (2.01 - 0.26) / 2, 0.0], rel=0.2)


def test_a_gain_is_not_known_beside_a_richer_structure_that_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trueplant.identify.kept_structures.averaged", lambda *given: given[-1][1])
    own, other = of("fopdt", [2.0, 10.0, 3.0], [0.1, 0.5, 0.1]), of("integrator", [0.2, 2.0], [0.01, 0.1])
    spread: Any = with_richer(own, other, 0.95)
    assert np.sqrt(np.diag(spread)) == pytest.approx([2.0, 13.0, 0.0])


def test_elements_that_keep_their_structure_count_what_the_rest_of_the_row_may_have(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beside two richer rows, as likely as 0.2 and 0.3, in which the second element has gains 3 and 1 and times 13."""
    monkeypatch.setattr("trueplant.identify.kept_structures.averaged", lambda _own, *given: given)
    own = of("fopdt", [2.0, 10.0, 3.0], [0.1, 0.5, 0.1], copies=2)
    first, second = Told.of(own.row, own.theta, own.covariance)
    rows = [[first, Told(0, np.array([gain, 13.0]), np.array([0.04, second.variances[1]]))] for gain in (3.0, 1.0)]
    shifts, shares, _, source, spreads = counting(own, [first, second], rows, np.array([0.2, 0.3]), 0.95)  # type: ignore[misc]
    assert (source, shares) == (Source.STRUCTURE, pytest.approx([0.5, 0.2, 0.3]))
    assert shifts == pytest.approx(np.array([[0.0] * 6, [0.0] * 3 + [1.0, 0.0, 0.0], [0.0] * 3 + [-1.0, 0.0, 0.0]]))
    assert np.diagonal(spreads, axis1=1, axis2=2)[1:, 3] == pytest.approx(0.03)
    assert np.count_nonzero(spreads) == 2
