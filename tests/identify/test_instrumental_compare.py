"""Order selection, and the estimators beside each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.benchmark_records import DELAYED, closed_loop_record, delayed_record, rao_garnier_record
from support.simulated import BLT, WOOD_BERRY, segment_of, wood_berry
from trueplant.errors import FormulaError, Refused
from trueplant.identify import Row, Spec, estimate_row, pieces_of
from trueplant.identify.instrumental import choose_orders
from trueplant.lti import Structure
from trueplant.lti.structure import structure_of
from trueplant.study.methods.estimators import ESTIMATORS, compare_estimators

FOPDT = Structure.parse("fopdt")
ALL = {(i, j): FOPDT for i in range(2) for j in range(2)}


def test_orders_are_chosen_with_a_reason():
    choice = choose_orders([rao_garnier_record(1)], 0, [0], 0.0, ((2, 1, 0), (3, 1, 0), (4, 1, 0)))
    assert (choice.orders[0].poles, choice.orders[0].zeros) == (4, 1)
    assert "4 poles, 1 zero, clearly better than" in choice.reason
    assert [c.bic for c in choice.candidates[0]] == sorted(c.bic for c in choice.candidates[0])
    closed = choose_orders([closed_loop_record(1, "coloured")], 0, [0], 0.0, ((1, 0, 0), (2, 1, 0), (3, 1, 0)))
    assert (closed.orders[0].poles, closed.orders[0].zeros) == (2, 1)


def test_a_resonance_with_inverse_response_is_found_from_nothing():
    """The search begins without a model, with a lead of the wrong sign."""
    segment, structure = delayed_record(20_001), Structure.parse("pair+lead")
    fit = estimate_row(Row((Spec(0, structure),), pieces_of([segment], 0)), 1.0)
    error = np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(fit.theta - [0.125, 2, 0.25, -8, DELAYED[-1]]) < 4 * error + [0, 0, 0, 0, 0.005])


def test_estimators_agree_where_they_should():
    segment = segment_of(wood_berry(5, samples=2500))
    compared = compare_estimators([segment], ALL, BLT)
    assert set(compared.found) == set(ESTIMATORS) - {"equation-error"}
    assert "one denominator" in compared.not_applied["equation-error"]
    for name in ("direct", "rivc", "clsrivc", "two-stage"):
        for place, (value, covariance) in compared.found[name].items():
            truth = structure_of(WOOD_BERRY[place])[1]
            assert np.all(np.abs(value - truth) < 4 * np.sqrt(np.diag(covariance))), (name, place)
    assert np.all(compared.black_box["direct"] > 0.001)
    gain, covariance = compared.found["rivc"][0, 1]
    assert f"rivc {gain[0]:.4g} ± {np.sqrt(covariance[0, 0]):.2g}" in str(compared)


def test_black_box_finds_an_estimator_that_is_wrong():
    """The model kept as it was is no estimate of a plant whose gain grew by half: the black box says so."""
    grown = replace(WOOD_BERRY, elements=((WOOD_BERRY[0, 0] * 1.5, WOOD_BERRY[0, 1]), WOOD_BERRY.elements[1]))
    segment = segment_of(wood_berry(6, samples=2500, plant=grown))
    compared = compare_estimators([segment], ALL, BLT, WOOD_BERRY, ["direct"])
    assert np.all(compared.black_box["direct"] > 0.001)
    from trueplant.identify.varx import varx

    assert varx([segment]).test(WOOD_BERRY, segment.hold)[0][0, 0] < 1e-6


def test_a_dead_time_without_an_error_is_given_none():
    segment, structure = delayed_record(3), Structure.parse("pair+lead")
    compared = compare_estimators([segment], {(0, 0): structure}, methods=["equation-error", "srivc"])
    for method, known in (("equation-error", False), ("srivc", True)):
        values, covariance = compared.found[method][0, 0]
        assert values[-1] == pytest.approx(8.0, abs=0.3)
        assert np.isfinite(covariance[-1, -1]) == known
    assert str(compared).count("(error unknown)") == 1


def test_what_does_not_apply_says_why():
    segment = segment_of(wood_berry(7, samples=800))
    compared = compare_estimators([segment], ALL, None, WOOD_BERRY, ["clsrivc", "srivc"])
    assert "a plant this slow needs" in compared.not_applied["black box"]
    assert not compared.black_box
    assert "declare it, or use two-stage" in compared.not_applied["clsrivc"]
    assert list(compared.found) == ["srivc"]
    blind = replace(segment, r=np.full_like(segment.r, np.nan))
    with pytest.raises(Refused, match="no estimator applies: two-stage: .*recorded set-points"):
        compare_estimators([blind], ALL, None, WOOD_BERRY, ["two-stage"])
    with pytest.raises(FormulaError, match="unknown estimator 'n4sid'"):
        compare_estimators([segment], ALL, methods=["n4sid"])
