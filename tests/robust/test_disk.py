"""The disk margin of all loops at once, against single loops and against loops on the edge."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.errors import UnstableLoop, UsageError
from trueplant.loop import PID, Controller, Linear, unstable_poles
from trueplant.lti import TransferMatrix, tf
from trueplant.plants import mill, wood_berry
from trueplant.robust import margins, multiloop_disk_margin


def test_single_loop_is_its_own_disk_margin():
    plant, law = TransferMatrix.of([["2 exp(-3 s)/(8 s + 1)"]]), Controller.diagonal([PID(Kc=0.6, Ti=8.0)])
    own = margins(plant, law)
    for at in ("input", "output"):
        both = multiloop_disk_margin(plant, law, at)
        assert both.lower == pytest.approx(own.disk_margin, rel=1e-6)
        assert both.upper == pytest.approx(both.lower, rel=1e-9)


@pytest.mark.parametrize("case", [mill("eq37"), wood_berry()], ids=["mill", "wood-berry"])
@pytest.mark.parametrize("at", ["input", "output"])
def test_changes_inside_the_disk_keep_the_loop_stable(case, at):
    together = multiloop_disk_margin(case.model, case.controller, at)
    for loop in range(2):
        assert together.upper <= margins(case.model, case.controller, loop).disk_margin * (1 + 1e-6)
    strongest = (2 + together.lower) / (2 - together.lower)
    corners = [tf(f"{factor}") for factor in (0.995 * strongest, 1.005 / strongest)]
    for first in corners:
        for second in corners:
            moved = [
                [case.model[i, j] * (first, second)[j if at == "input" else i] for j in range(2)] for i in range(2)
            ]
            assert unstable_poles(TransferMatrix(tuple(map(tuple, moved))), case.controller) == 0


def test_rotating_plant_stands_less_than_each_loop_alone():
    """The spinning satellite: each loop alone looks perfect, both together stand next to nothing."""
    plant = TransferMatrix.of(
        [["(s - 100)/(s^2 + 100)", "10 (s + 1)/(s^2 + 100)"], ["-10 (s + 1)/(s^2 + 100)", "(s - 100)/(s^2 + 100)"]]
    )
    law = Controller.diagonal([Linear(tf("1")), Linear(tf("1"))])
    together = multiloop_disk_margin(plant, law)
    assert margins(plant, law).disk_margin == pytest.approx(2.0, rel=1e-4)  # L = 1/s
    # T = [[1, 10], [-10, 1]]/(s + 1), so S - I/2 has the eigenvalues 1/2 - (1 +- 10j)/(s + 1)
    w = np.linspace(0, 0.2, 20_001)
    assert together.lower == pytest.approx(1 / np.max(np.abs(0.5 - (1 - 10j) / (1j * w + 1))), rel=1e-6)
    k = (2 + 1.01 * together.upper) / (2 - 1.01 * together.upper)
    changed = TransferMatrix(
        tuple(tuple(cell * f for cell, f in zip(row, (k, 1 / k), strict=True)) for row in plant.elements)
    )
    assert unstable_poles(changed, law) > 0


def test_refusals():
    plant = TransferMatrix.of([["1/(s + 1)^3"]])
    with pytest.raises(UnstableLoop, match="no margins"):
        multiloop_disk_margin(plant, Controller.diagonal([PID(Kc=20.0, Ti=1.0)]))
    with pytest.raises(UsageError, match="at must be"):
        multiloop_disk_margin(plant, Controller.diagonal([PID(Kc=1.0, Ti=1.0)]), "both")
