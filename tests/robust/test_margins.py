"""Margins against published values, closed forms, python-control and the loop's own stability."""

from __future__ import annotations

import control
import numpy as np
import pytest

from trueplant.errors import LoopError, UnstableLoop
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.lti import TransferMatrix
from trueplant.plants import mill, splitter
from trueplant.robust import margins, niederlinski, rga


def siso(formula: str, **settings) -> tuple[TransferMatrix, Controller]:
    return TransferMatrix.of([[formula]]), Controller.diagonal([PID(**settings)])


def test_simc_margins_are_the_published_ones():
    theta, tau, gain = 3.0, 8.0, 2.0
    lag = margins(*siso(f"{gain} exp(-{theta} s)/({tau} s + 1)", Kc=tau / (gain * 2 * theta), Ti=tau))
    assert [lag.gain_margin, lag.phase_margin, lag.Ms, lag.delay_margin / theta] == pytest.approx(
        [3.14, 61.4, 1.59, 2.14], rel=2e-3
    )
    # in closed form: L = e^(-theta s)/(2 theta s)
    assert lag.gain_margin == pytest.approx(np.pi, rel=1e-9)
    assert lag.phase_margin == pytest.approx(np.degrees(np.pi / 2 - 0.5), rel=1e-9)
    assert lag.delay_margin == pytest.approx((np.pi - 1) * theta, rel=1e-9)
    ramp = margins(*siso(f"{gain} exp(-{theta} s)/s", Kc=1 / (gain * 2 * theta), Ti=8 * theta))
    assert [ramp.gain_margin, ramp.phase_margin, ramp.Ms, ramp.delay_margin / theta] == pytest.approx(
        [2.96, 46.9, 1.70, 1.59], rel=3e-3
    )


@pytest.mark.parametrize(
    ("formula", "settings", "ms"),
    [
        ("1/((s + 1)(0.2 s + 1))", {"Kc": 5.5, "Ti": 0.8}, 1.56),
        ("1/(s + 1)^4", {"Kc": 0.3, "Ti": 1.5}, 1.46),
        ("1/(s + 1)^4", {"form": "series", "Kc": 0.5, "Ti": 1.5, "Td": 1.0, "alpha": 1e-3}, 1.43),
        ("exp(-s)/(s + 1)^2", {"Kc": 0.5, "Ti": 1.5}, 1.61),
        ("3 (1 - 2 s)/((5 s + 1)(10 s + 1))", {"Kc": 2.5 / 2.2, "Ti": 15.24 / 1.2}, 3.914),
    ],
)
def test_sensitivity_peaks_are_the_published_ones(formula, settings, ms):
    assert margins(*siso(formula, **settings)).Ms == pytest.approx(ms, abs=6e-3)


def test_splitter_loops():
    case = splitter()
    m = margins(case.plant, case.controller, loop=1)
    assert [m.gain_margin, m.phase_margin, m.Ms] == pytest.approx([4.47, 60.6, 1.398], rel=1.5e-3)
    top = margins(case.plant, case.controller, loop=0)
    assert np.isinf(top.gain_margin) and top.Ms == pytest.approx(1, abs=1e-6) and np.isinf(top.Ms_frequency)


def test_agrees_with_python_control_without_dead_time():
    law = {"form": "parallel", "Kp": 3.0, "Ki": 2.0}
    m = margins(*siso("(s + 2)/((s - 1)(0.1 s + 1)(0.05 s + 1)^2)", **law))
    s = control.tf("s")
    loop = (3 + 2 / s) * (s + 2) / ((s - 1) * (0.1 * s + 1) * (0.05 * s + 1) ** 2)
    gm, pm, sm, w_gm, _, w_sm = control.stability_margins(loop, returnall=True)
    below = gm < 1
    assert m.gain_reduction == pytest.approx(np.max(gm[below]), rel=1e-7)
    assert m.gain_margin == pytest.approx(np.min(gm[~below]), rel=1e-7)
    assert m.gain_margin_frequency == pytest.approx(w_gm[~below][np.argmin(gm[~below])], rel=1e-6)
    assert m.phase_margin == pytest.approx(np.min(np.abs(pm)), rel=1e-7)
    assert m.Ms == pytest.approx(1 / np.min(sm), rel=1e-6)
    assert m.Ms_frequency == pytest.approx(w_sm[np.argmin(sm)], rel=1e-4)
    disk = control.disk_margins(loop, np.geomspace(0.01, 1e3, 20_000))[0]
    assert m.disk_margin == pytest.approx(disk, rel=1e-5)


def test_loop_changes_stability_at_its_margins():
    formula, settings = "2 exp(-1.3 s)/(s^2 + 0.4 s + 1)", {"form": "parallel", "Kp": 0.05, "Ki": 0.12}
    m = margins(*siso(formula, **settings))
    for factor, poles in ((0.999, 0), (1.001, 2)):
        k = m.gain_margin * factor
        assert unstable_poles(*siso(f"{2 * k} exp(-1.3 s)/(s^2 + 0.4 s + 1)", **settings)) == poles
        longer = f"2 exp(-{1.3 + m.delay_margin * factor} s)/(s^2 + 0.4 s + 1)"
        assert unstable_poles(*siso(longer, **settings)) == poles


def test_margin_of_one_loop_knows_whether_the_others_are_closed():
    case = mill("eq37")
    closed = margins(case.model, case.controller, loop=0)
    assert margins(case.model, case.controller, loop=0, others="open").phase_margin != pytest.approx(
        closed.phase_margin, rel=0.05
    )
    gain = PID(Kc=-2.0 * closed.gain_margin, Ti=3.3)
    for factor, stable in ((0.999, True), (1.001, False)):
        first = PID(Kc=gain.Kc * factor, Ti=3.3)
        law = Controller({(0, 0): first, (1, 1): case.controller.entries[1, 1]}, 2, 2)
        assert (unstable_poles(case.model, law) == 0) is stable


def test_peaks_of_a_loop_that_echoes_for_long_are_all_looked_at():
    """|1 + L| is least at the first of thousands of nearly equal ripples, at pi/100."""
    m = margins(*siso("exp(-100 s)/(0.01 s + 1)", Kc=0.99))
    s = 1j * np.linspace(0.0310, 0.0318, 200_001)
    assert m.Ms == pytest.approx(np.max(1 / np.abs(1 + 0.99 * np.exp(-100 * s) / (0.01 * s + 1))), rel=1e-6)
    assert m.gain_margin == pytest.approx(1 / 0.99, rel=1e-5) and np.isinf(m.phase_margin) and np.isinf(m.delay_margin)


def test_undamped_plant_under_damping_control():
    m = margins(*siso("1/(s^2 + 1)", form="parallel", Kp=0.0, Kd=1.0, Tf=0.01))
    s = 1j * np.geomspace(1.1e-3, 1e4, 100_003)
    loop = s / (0.01 * s + 1) / (s**2 + 1)
    assert m.Ms == pytest.approx(np.max(1 / np.abs(1 + loop)), rel=1e-5)
    assert np.isinf(m.gain_margin) and m.Mt == pytest.approx(np.max(np.abs(loop / (1 + loop))), rel=1e-5)


@pytest.mark.parametrize("scale", [1e-9, 1e7])
def test_units_of_time_and_gain_do_not_matter(scale):
    plain = margins(*siso("2 exp(-3 s)/(8 s + 1)", Kc=0.6, Ti=8.0))
    other = margins(*siso(f"{2 * scale} exp(-{3 * scale} s)/({8 * scale} s + 1)", Kc=0.6 / scale, Ti=8.0 * scale))
    assert other.gain_margin == pytest.approx(plain.gain_margin, rel=1e-8)
    assert other.Ms == pytest.approx(plain.Ms, rel=1e-8) and other.Mt == pytest.approx(plain.Mt, rel=1e-8)
    assert other.delay_margin == pytest.approx(plain.delay_margin * scale, rel=1e-8)


def test_sampled_loop_changes_stability_at_its_gain_margin():
    """The count of poles is exact for the sampled loop, the margin neglects aliasing (0.6 % here)."""
    m = margins(*siso("2 exp(-3 s)/(8 s + 1)", Kc=0.6, Ti=8.0, sample_time=0.5))
    for factor, stable in ((0.99, True), (1.01, False)):
        gain = 0.6 * m.gain_margin * factor
        loop = siso("2 exp(-3 s)/(8 s + 1)", Kc=gain, Ti=8.0, sample_time=0.5)
        assert (unstable_poles(*loop) == 0) is stable


def test_unstable_loop_and_wrong_arguments_are_refused():
    with pytest.raises(UnstableLoop, match="no margins"):
        margins(*siso("1/(s + 1)^3", Kc=20.0, Ti=1.0))
    case = mill("eq37")
    with pytest.raises(LoopError, match="inputs 0 to 1"):
        margins(case.model, case.controller, loop=2)
    with pytest.raises(LoopError, match="others must be"):
        margins(case.model, case.controller, others="half")
    with pytest.raises(LoopError, match="no controller writes input 2"):
        margins(case.model, Controller({(0, 0): PID(Kc=-2.0, Ti=3.3)}, 2, 2), loop=1)


def test_relative_gains_of_wood_berry():
    gains = [[12.8, -18.9], [6.6, -19.4]]
    assert rga(gains)[0, 0] == pytest.approx(2.0094, abs=1e-4)
    assert rga(gains).sum(axis=0) == pytest.approx([1, 1]) and rga(gains).sum(axis=1) == pytest.approx([1, 1])
    assert niederlinski(gains) == pytest.approx(1 / 2.0094, rel=1e-4)
    with pytest.raises(LoopError, match="singular"):
        rga([[1.0, 2.0], [2.0, 4.0]])
    with pytest.raises(LoopError, match="pair that output"):
        niederlinski([[0.0, 2.0], [2.0, 4.0]])
