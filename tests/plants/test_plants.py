"""Published plants have the properties that were published of them."""

from __future__ import annotations

import doctest
import importlib

import numpy as np
import pytest

from trueplant.errors import UsageError
from trueplant.loop import check_loop, complementary, sensitivity, simulate
from trueplant.plants import (
    mill,
    quadruple_tank,
    rao_garnier,
    shell_3x3,
    skogestad_distillation,
    spinning_satellite,
    splitter,
    wardle_wood,
    wood_berry,
)
from trueplant.robust import gain_and_dead_time_weight, margins, performance_weight
from trueplant.tune import blt


@pytest.mark.parametrize("module", ["mill", "columns", "rao_garnier", "tanks", "satellite"])
def test_examples_in_the_documentation_hold(module):
    outcome = doctest.testmod(importlib.import_module(f"trueplant.plants.{module}"))
    assert outcome.attempted > 0
    assert outcome.failed == 0


SOUND = [mill(), mill("eq37"), splitter(), wood_berry(), shell_3x3(), wardle_wood(), skogestad_distillation()]
SOUND += [quadruple_tank(), spinning_satellite()]


@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
def test_every_published_loop_is_a_sound_one(case):
    assert len(case.outputs) == case.model.shape[0]
    assert len(case.inputs) == case.model.shape[1]
    check_loop(case.model, case.controller)
    if case.plant is not None:
        check_loop(case.plant, case.controller)


def test_mill_mismatch_is_equation_37():
    case = mill("eq37")
    s = 1j * np.geomspace(0.01, 10, 50)
    mismatch = (case.plant - case.model)(s)
    second = np.exp(-0.67 * s) / (s**2 + 0.66667 * s + 0.083333)
    assert np.allclose(mismatch[:, 0, 0], 0.0232 * np.exp(-0.68 * s) / (s**2 + 0.9 * s + 0.2), rtol=2e-3)
    assert np.allclose(mismatch[:, 0, 1], -0.0066 * second, rtol=1e-2)
    assert np.allclose(mismatch[:, 1, 0], -0.03333 * s * np.exp(-0.6 * s) / (s**2 + 0.3182 * s + 0.02525), rtol=2e-3)
    assert np.allclose(mismatch[:, 1, 1], -0.0809 * np.exp(-0.13 * s) / (s + 0.2857), rtol=1e-3)
    printed = (mill().plant - mill().model)(s)[:, 0, 1]
    assert np.allclose(printed, -0.03587 * second, rtol=1e-3)


def test_mill_with_the_printed_factor_does_not_settle_in_an_hour():
    case = mill()
    r = np.zeros((20001, 2))
    r[:, 0] = 1.0
    y = simulate(case.plant, case.controller, r, 0.01).y[:, 0]
    assert y[6000] == pytest.approx(0.92, abs=0.005)
    assert y[20000] == pytest.approx(0.986, abs=0.001)


def test_vaporisation_loop_of_the_splitter_has_its_margins():
    case = splitter()
    w = np.geomspace(1e-3, 50, 200_000)
    loop = (case.model(1j * w) @ case.controller(1j * w))[:, 1, 1]
    phase = np.unwrap(np.angle(loop))
    gain_margin = 1 / np.abs(loop[np.argmin(np.abs(phase + np.pi))])
    phase_margin = 180 + np.degrees(phase[np.argmin(np.abs(np.abs(loop) - 1))])
    assert gain_margin == pytest.approx(4.47, abs=0.01)
    assert phase_margin == pytest.approx(60.6, abs=0.1)
    assert np.max(np.abs(1 / (1 + loop))) == pytest.approx(1.398, abs=0.001)


def test_wood_berry_under_blt_peaks_at_four_decibels():
    # Luyben's BLT criterion: 20 log10 |W/(1 + W)| = 2 n with W = det(I + G Q) - 1
    case = wood_berry()
    s = 1j * np.geomspace(1e-3, 10, 20_000)
    w = np.linalg.det(np.eye(2) + case.model(s) @ case.controller(s)) - 1
    assert 20 * np.log10(np.max(np.abs(w / (1 + w)))) == pytest.approx(4.0, abs=0.05)


def test_shell_controllers_have_moderate_peaks():
    case = shell_3x3()
    s = 1j * np.geomspace(1e-5, 1, 4000)
    assert np.linalg.norm(sensitivity(case.model, case.controller, s), 2, (1, 2)).max() < 2.05
    assert np.linalg.norm(complementary(case.model, case.controller, s), 2, (1, 2)).max() < 1.6


def test_rao_garnier_starts_the_wrong_way():
    case = rao_garnier()
    y = simulate(case.model, None, np.zeros((500, 1)), 0.01, u=np.ones((500, 1))).y[:, 0]
    assert y[:20].min() < -0.5
    assert case.model.dc_gain == pytest.approx(1.0)


def test_mill_carries_table_1_and_its_weights():
    for case in (mill(), mill("eq37")):
        assert case.input_nominal == (65, 45) and case.input_limits == ((60, 70), (40, 50))
        assert case.output_nominal == (70, 150) and case.output_limits == ((68, 72), (140, 170))
        s = 1j * np.geomspace(1e-3, 1e2, 30)
        # (31) is the weight of 10 % gain and 0.2 min dead-time error, (32) asks for a bandwidth of 0.05 rad/min
        assert np.allclose(case.uncertainty(s), gain_and_dead_time_weight(0.1, 0.2)(s), rtol=1e-12)
        assert np.allclose(case.performance(s), performance_weight(0.05, 1 / 0.45)(s), rtol=1e-12)


def test_wardle_wood_settings_are_those_of_the_blt_rule():
    case = wardle_wood()
    found = blt(case.model)
    for own, computed in zip(case.controller.entries.values(), found.controller.entries.values(), strict=True):
        assert computed.Kc == pytest.approx(own.Kc, rel=0.01)
        assert computed.Ti == pytest.approx(own.Ti, rel=0.01)


def test_one_loop_of_the_satellite_tells_nothing_of_both():
    case = spinning_satellite()
    alone = margins(case.model, case.controller, loop=0, others="closed")
    assert alone.gain_margin == np.inf and alone.phase_margin == pytest.approx(90, abs=1e-6)


def test_unknown_variant_of_the_mill_is_named():
    with pytest.raises(UsageError, match="eq37"):
        mill("other")
