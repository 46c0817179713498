"""Two results beside each other: what differs beyond chance, in one unit of time, and what cannot be said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from trueplant.detect.beside import compare_results
from trueplant.result import (
    Element,
    ElementVerdict,
    ExperimentData,
    Importance,
    Parameter,
    Provenance,
    Result,
    Settings,
    Status,
)

NAMES, UNITS = ("gain", "tau1", "dead_time"), ("degC/%", "min", "min")
TRUE, ERRORS = np.array([2.0, 10.0, 3.0]), np.array([0.02, 0.3, 0.1])


def result(values=TRUE, errors=ERRORS, digest="a", unit="min", start=None, span=(0.0, 100.0), elements=1) -> Result:
    half = norm.isf(0.025) * errors
    scale = 60.0 if unit == "s" else 1.0
    factors = (1.0, scale, scale)
    units = (UNITS[0], unit, unit)
    parameters = tuple(
        Parameter(n, u, None, v * f, e * f, ((v - h) * f, (v + h) * f), None, None, None, None)
        for n, u, v, e, h, f in zip(NAMES, units, values, errors, half, factors, strict=True)
    )
    span = (span[0] * scale, span[1] * scale)
    data = ExperimentData("r.csv", "closed", 100, 1.0, start, span, (span,), {}, {}, (), (), None)
    origin = Provenance("0", "p", "", {"r.csv": digest}, {}, unit, 0, Settings("auto", 0.95, 0.0))
    found = tuple(
        Element(
            "y", f"u{k}", "fopdt", "x", "x", "x", parameters, ElementVerdict.UNCHANGED, "", None, Importance(0, ""), "A"
        )
        for k in range(elements)
    )
    return Result(Status.OK, (), origin, (data,), found)


def parameters(first: Result, second: Result):
    return compare_results(first, second).elements[0].parameters


def test_difference_and_its_error_are_those_of_independent_records():
    other = 2 * ERRORS
    found = parameters(result(), result(TRUE + 0.1, other, "b"))
    for one, error in zip(found, np.hypot(ERRORS, other), strict=True):
        assert one.difference == pytest.approx(0.1)
        assert one.std_error == pytest.approx(error, rel=1e-9)
        assert one.p_value == pytest.approx(2 * norm.sf(0.1 / error), rel=1e-6)
    raw = sorted(one.p_value for one in found)
    assert min(one.p_adjusted for one in found) == pytest.approx(3 * raw[0])


def test_order_only_changes_the_sign():
    a, b = result(), result(TRUE + np.array([0.1, -0.5, 0.4]), ERRORS, "b")
    for one, other in zip(parameters(a, b), parameters(b, a), strict=True):
        assert one.difference == pytest.approx(-other.difference)
        assert one.p_adjusted == pytest.approx(other.p_adjusted)


def test_false_alarms_over_all_parameters_are_as_the_confidence_says():
    rng = np.random.default_rng(1)
    alarms = 0
    for _ in range(400):
        drawn = [result(TRUE + ERRORS * rng.standard_normal(3), ERRORS, digest) for digest in "ab"]
        alarms += any(one.differs for one in parameters(*drawn))
    assert 4 <= alarms <= 35  # 20 expected; both ends lie beyond 3.4 standard deviations


def test_other_time_units_are_converted():
    in_minutes, in_seconds = result(TRUE + 0.2, ERRORS, "b"), result(TRUE + 0.2, ERRORS, "b", unit="s")
    for one, other in zip(parameters(result(), in_minutes), parameters(result(), in_seconds), strict=True):
        assert other.unit == one.unit
        assert other.difference == pytest.approx(one.difference)
        assert other.p_value == pytest.approx(one.p_value)


def test_slopes_and_frequencies_are_converted_too():
    def with_units(made: Result, unit: str, factor: float) -> Result:
        one = made.elements[0]
        changed = tuple(
            replace(p, name=n, unit=f"{u}/{unit}", plant=2.0 * factor, std_error=factor, ci=None)
            for p, (n, u) in zip(one.parameters, [("slope", "(degC/%)"), ("omega0", "rad")], strict=False)
        )
        return replace(made, elements=(replace(one, parameters=changed),))

    found = parameters(with_units(result(), "min", 1.0), with_units(result(digest="b", unit="s"), "s", 1 / 60))
    assert [one.unit for one in found] == ["(degC/%)/min", "rad/min"]
    assert [one.difference for one in found] == pytest.approx([0.0, 0.0])


def test_other_units_of_a_signal_are_not_compared():
    other = result(digest="b")
    gain, *rest = other.elements[0].parameters
    other = replace(other, elements=(replace(other.elements[0], parameters=(replace(gain, unit="K/%"), *rest)),))
    found = parameters(result(), other)
    assert found[0].difference is None
    assert "K/%" in found[0].reason
    assert found[1].difference == 0


def test_lopsided_intervals_count_on_the_side_of_the_other():
    a = result()
    one = replace(a.elements[0].parameters[2], plant=0.0, std_error=0.05, ci=(0.0, 1.0))
    a = replace(a, elements=(replace(a.elements[0], parameters=(one,)),))
    above, below = result(TRUE * 0 + 0.5, ERRORS, "b"), result(TRUE * 0 - 0.5, ERRORS, "b")
    assert parameters(a, above)[0].std_error == pytest.approx(np.hypot(1 / norm.isf(0.025), 0.1))
    assert parameters(a, below)[0].std_error == pytest.approx(np.hypot(0.05, 0.1))


@pytest.mark.parametrize(
    ("first", "second", "shared"),
    [
        ({}, {}, ["same-data"]),
        ({"unit": "min"}, {"unit": "s"}, ["same-data"]),
        ({}, {"digest": "b"}, []),
        ({"span": (0.0, 50.0)}, {"span": (50.0, 100.0)}, []),
        ({"start": "2024-01-01T00:00:00"}, {"start": "2024-01-01T00:00:00"}, ["same-data"]),
        ({"start": "2024-01-01T00:00:00"}, {"start": "2024-01-01T01:00:00", "digest": "b"}, ["same-hours"]),
        ({"start": "2024-01-01T00:00:00"}, {"start": "2024-01-01T02:00:00", "digest": "b"}, []),
        (
            {"start": "2024-01-01T00:00:00+00:00"},
            {"start": "2024-01-01T02:00:00+01:00", "digest": "b"},
            ["same-hours"],
        ),
    ],
)
def test_what_is_used_twice_is_noticed(first, second, shared):
    found = compare_results(result(**first), result(TRUE + 5, **second))
    assert [note.code for note in found.notes] == shared
    assert found.independent == (not shared)
    assert all((one.p_value is None) == bool(shared) for one in found.elements[0].parameters)
    assert ("same data" in found.headline) == (shared == ["same-data"])
    assert ("different files of the same hours" in found.headline) == (shared == ["same-hours"])
    assert ("plant differs between the two beyond chance" in found.headline) == (not shared)


def test_elements_of_one_side_are_told_and_nothing_in_common_is_a_refusal():
    found = compare_results(result(elements=2), result(digest="b"))
    assert [note.message for note in found.notes] == ["only the first has u1 -> y"]
    unknown = result(digest="b")
    silent = tuple(replace(p, plant=None, std_error=None, ci=None) for p in unknown.elements[0].parameters)
    unknown = replace(unknown, elements=(replace(unknown.elements[0], parameters=silent),))
    found = compare_results(result(), unknown)
    assert found.status == Status.REFUSED
    assert found.elements[0].parameters[0].reason == "not answered by the second"


def test_a_gain_of_a_flow_in_volume_per_hour_is_not_one_per_time_unit():
    def flow(made: Result) -> Result:
        one = made.elements[0]
        return replace(made, elements=(replace(one, parameters=(replace(one.parameters[0], unit="m3/h"),)),))

    (gain,) = parameters(flow(result(unit="s")), flow(result(digest="b", unit="h")))
    assert gain.reason == "" and gain.difference == pytest.approx(0.0)
