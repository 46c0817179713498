"""Structures: parameters in, transfer function out, and back; gradients against central differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueplant.errors import FormulaError
from trueplant.lti import tf
from trueplant.lti.sampled import sampled_response
from trueplant.lti.structure import Structure, structure_of

NAMES = [
    "gain",
    "fopdt",
    "sopdt",
    "sopdt+lead",
    "integrator",
    "integrator+lag",
    "pair+lead",
    "sopdt+delayed",
    "pair+lag",
]
S = 1j * np.logspace(-2, 1, 7)


def parameters(structure: Structure, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    p = rng.uniform(0.3, 3.0, len(structure.names))
    p[[name == "zeta" for name in structure.names]] = rng.uniform(0.2, 0.9)
    return p[structure.sorted(p)]


@pytest.mark.parametrize("name", NAMES)
def test_name_round_trip(name):
    assert Structure.parse(str(Structure.parse(name))) == Structure.parse(name)


@pytest.mark.parametrize("name", NAMES)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_parameters_survive_the_transfer_function(name, seed):
    structure = Structure.parse(name)
    p = parameters(structure, seed)
    own, q = structure_of(structure.transfer(p))
    assert own == structure
    assert np.allclose(own.transfer(q)(S), structure.transfer(p)(S), rtol=1e-6)


@pytest.mark.parametrize("name", [*NAMES, "sopdt+lag+lead+lead", "pair+pair+lead+lead", "sopdt+delayed+delayed"])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_plants_that_are_the_same_have_the_same_parameters_in_one_order(name, seed):
    structure, rng = Structure.parse(name), np.random.default_rng(seed)
    p = parameters(structure, seed)

    def shuffled(kind, beside=None):
        places = np.flatnonzero(kind)
        order = rng.permutation(len(places))
        q[places] = q[places[order]]
        if beside is not None:
            other = np.flatnonzero(beside)
            q[other] = q[other[order]]

    q = p.copy()
    shuffled(structure.is_lag)
    shuffled(structure.is_lead)
    shuffled(structure.is_frequency, structure.is_damping)
    if structure.has_dead_time:
        shuffled(structure.is_dead_time, structure.is_gain)
    assert np.allclose(structure.transfer(q)(S), structure.transfer(p)(S), rtol=1e-9)
    assert np.array_equal(q[structure.interchanged(q)], p[structure.interchanged(p)])


@pytest.mark.parametrize("name", NAMES)
def test_gradient_against_central_differences(name):
    structure = Structure.parse(name)
    p = parameters(structure, 5)
    gradient = structure.gradient(p, S)
    for k in range(len(p)):
        step = 1e-6 * np.eye(len(p))[k]
        difference = (structure.transfer(p + step)(S) - structure.transfer(p - step)(S)) / 2e-6
        assert np.allclose(gradient[:, k], difference, rtol=1e-6, atol=1e-7)


def test_the_mill_element_shares_its_denominator():
    structure, p = structure_of(tf("4 (1 - 0.9938 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))"))
    assert structure == Structure.parse("sopdt+delayed")
    assert np.allclose(p, [4, -4 * 0.9938, 6, 2, 0.2, 0.67], rtol=1e-12)


def test_multiple_poles_stay_real():
    structure, p = structure_of(tf("1/(s + 1)^4"))
    assert structure.lags == 4
    assert np.allclose(p, [1, 1, 1, 1, 1, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("formula", "name", "p"),
    [
        ("2 exp(-1.5 s)", "fopdt", [2, 0, 1.5]),
        ("2 (3 s + 1) exp(-4 s)/(5 s + 1)", "sopdt+lead", [2, 5, 0, 3, 4]),
        ("2 exp(-s) - 1.5 exp(-4 s)", "fopdt+delayed", [2, -1.5, 0, 1, 4]),
        ("2", "gain", [2]),
    ],
)
def test_what_answers_at_once_but_late_has_a_lag_of_0(formula, name, p):
    structure, found = structure_of(tf(formula))
    assert structure == Structure.parse(name) and np.allclose(found, p)
    assert np.allclose(structure.transfer(found)(S), tf(formula)(S), rtol=1e-7)
    u = np.random.default_rng(0).standard_normal(200)
    response = structure.response(found, u, 0.7, "written")
    np.testing.assert_allclose(response, sampled_response(tf(formula), u, 0.7, "written"), atol=1e-6)


def test_complex_pair_by_frequency_and_damping():
    structure, p = structure_of(tf("(-4 s + 0.5) exp(-8 s)/(s^2 + s + 4)"))
    assert structure.names == ("gain", "omega0", "zeta", "lead1", "dead_time")
    assert np.allclose(p, [0.125, 2, 0.25, -8, 8])


@pytest.mark.parametrize(
    "formula",
    ["0", "1/(1 - 5 s)", "exp(-s)/(s + 1) + exp(-2 s)/(3 s + 1)", "(s^2 + 0.1 s + 1)/(s + 1)^3", "s/(s + 1)^2"],
)
def test_elements_that_cannot_be_estimated_say_so(formula):
    with pytest.raises(FormulaError):
        structure_of(tf(formula))


@pytest.mark.parametrize("name", ["fopd", "gain+lead", "fopdt+tail"])
def test_unknown_structures_are_refused(name):
    with pytest.raises(FormulaError):
        Structure.parse(name)


@pytest.mark.parametrize(
    ("units", "gain", "slope"),
    [
        (("degC", "%"), "degC/%", "(degC/%)/min"),
        (("%", "lb/min"), "%/(lb/min)", "(%/(lb/min))/min"),
        (("t/h", "m3/h"), "(t/h)/(m3/h)", "((t/h)/(m3/h))/min"),
        (("%", "(lb/min)"), "%/(lb/min)", "(%/(lb/min))/min"),
        (("kg s", ""), "kg s", "(kg s)/min"),
        (("", "%"), "1/%", "(1/%)/min"),
        (("", ""), "", "1/min"),
    ],
)
def test_units_of_gains_cannot_be_misread(units, gain, slope):
    assert Structure.parse("fopdt").units(*units, "min") == (gain, "min", "min")
    assert Structure.parse("integrator").units(*units, "min") == (slope, "min")


@pytest.mark.parametrize("name", NAMES)
def test_every_parameter_is_of_one_kind(name):
    structure = Structure.parse(name)
    kinds = {
        "slope" if structure.integrators else "gain": structure.is_gain,
        "tau": structure.is_lag,
        "omega0": structure.is_frequency,
        "zeta": structure.is_damping,
        "lead": structure.is_lead,
        "dead_time": structure.is_dead_time,
    }
    for k, parameter in enumerate(structure.names):
        (kind,) = [kind for kind, mask in kinds.items() if mask[k]]
        assert parameter.startswith(kind)


def test_lag_and_dead_time_of_an_element():
    structure = Structure.parse("sopdt+pair+delayed")
    p = structure.parameters(1.0, [5.0, 2.0], 0.5, 0.7, 0.0, [1.0, 4.0])
    assert structure.lag(p) == pytest.approx(9.0) and structure.longest_dead_time(p) == 4.0
    assert p[structure.is_gain].tolist() == [1.0, 1.0] and p[structure.is_damping].tolist() == [0.7]
    assert Structure.parse("gain").longest_dead_time(np.ones(1)) == 0.0
