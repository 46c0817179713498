"""Several loops at once: BLT as printed, sequential design with each loop's limits as it was closed."""

import numpy as np
import pytest

from trueplant.errors import LoopError
from trueplant.loop import Controller, unstable_poles
from trueplant.lti import TransferMatrix, tf
from trueplant.plants import shell_3x3, wood_berry
from trueplant.robust import margins
from trueplant.tune.integral import max_ki
from trueplant.tune.several import blt, sequential


def test_blt_gives_luybens_settings_of_the_wood_berry_column():
    found = blt(wood_berry().model)
    assert found.detuning == pytest.approx(2.545, abs=1e-3)
    assert found.log_modulus == pytest.approx(4.0, abs=1e-3)
    for entry, (kc, ti) in zip(found.controller.entries.values(), [(0.375, 8.29), (-0.0754, 23.6)], strict=True):
        assert entry.Kc == pytest.approx(kc, rel=1e-3)
        assert entry.Ti == pytest.approx(ti, rel=1e-3)


def test_blt_peaks_at_two_decibels_a_loop():
    plant = TransferMatrix.of(
        [["2 exp(-s)/(5 s + 1)", "0.6/(4 s + 1)"], ["-0.5/(3 s + 1)", "-1.5 exp(-0.5 s)/(4 s + 1)"]]
    )
    found = blt(plant)
    s = 1j * np.geomspace(1e-3, 1e2, 50_000)
    difference = np.linalg.det(np.eye(2) + plant(s) @ found.controller(s))
    assert np.max(20 * np.log10(np.abs(1 - 1 / difference))) == pytest.approx(4.0, abs=1e-3)
    assert unstable_poles(plant, found.controller) == 0


def test_blt_of_one_loop_has_its_complementary_sensitivity_at_two_decibels():
    g = tf("exp(-s)/(3 s + 1)")
    found = blt(TransferMatrix(((g,),)))
    assert margins(TransferMatrix(((g,),)), found.controller).Mt == pytest.approx(10**0.1, rel=1e-4)


@pytest.mark.parametrize("rule", [blt, sequential])
def test_loops_without_a_limit_are_named(rule):
    with pytest.raises(LoopError, match="loop 3"):
        rule(shell_3x3().model)
    with pytest.raises(LoopError, match="as many inputs as outputs"):
        rule(TransferMatrix.of([["exp(-s)/(s + 1)", "1/(s + 1)"]]))


def test_last_loop_of_a_sequence_keeps_its_limits_with_the_others_closed():
    plant = wood_berry().model
    for order in ([0, 1], [1, 0]):
        found = sequential(plant, 1.5, order=order)
        last = margins(plant, found, order[-1])
        assert max(last.Ms, last.Mt) == pytest.approx(1.5, rel=1e-3)
        first = margins(plant, found, order[0], others="open")
        assert max(first.Ms, first.Mt) == pytest.approx(1.5, rel=1e-3)
        assert unstable_poles(plant, found) == 0


def test_without_interaction_a_sequence_tunes_each_loop_alone():
    one, two = "exp(-s)/(3 s + 1)", "-2 exp(-2 s)/(5 s + 1)^2"
    found = sequential(TransferMatrix.of([[one, "0"], ["0.7/(s + 1)", two]]))
    alone = Controller.diagonal([max_ki(tf(one)), max_ki(tf(two))])
    for ours, own in zip(found.entries.values(), alone.entries.values(), strict=True):
        assert ours.parallel == pytest.approx(own.parallel, rel=3e-3)


def test_wrong_pairing_is_refused():
    # relative gain of the diagonal below 0
    plant = TransferMatrix.of([["exp(-s)/(3 s + 1)", "2/(4 s + 1)"], ["2/(4 s + 1)", "exp(-s)/(3 s + 1)"]])
    with pytest.raises(LoopError, match="sign"):
        sequential(plant)
    with pytest.raises(LoopError, match="pairing"):
        blt(plant)


def test_order_must_name_every_loop():
    with pytest.raises(LoopError, match="order"):
        sequential(wood_berry().model, order=[0, 0])
