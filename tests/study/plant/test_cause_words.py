"""Who may have changed dynamics, in words: the plant, the sensor of its row, the actuator of its column."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from trueplant.result import Code, Reason
from trueplant.study.assemble import _causes
from trueplant.study.plant.causes import _answers_otherwise

SENSOR, ACTUATOR = "the sensor of PV (its damping, or fouling)", "the actuator (its positioner)"


@pytest.mark.parametrize(
    ("unchanged", "suspects"),
    [
        ([], f"it is the plant itself, {SENSOR} or {ACTUATOR}"),
        ([(0, 1)], f"it is the plant itself or {ACTUATOR}"),
        ([(1, 0)], f"it is the plant itself or {SENSOR}"),
        ([(1, 1)], f"it is the plant itself, {SENSOR} or {ACTUATOR}"),
    ],
)
def test_what_the_other_elements_of_row_and_column_do_not_clear_stays_under_suspicion(
    unchanged: list[tuple[int, int]], suspects: str
) -> None:
    assert _answers_otherwise((0, 0), unchanged, measured=False).endswith(suspects)


def test_where_both_stayed_as_they_were_it_is_the_plant() -> None:
    said = _answers_otherwise((0, 0), [(0, 1), (1, 0)], measured=False)
    assert said.startswith("the plant itself has changed: ")


def test_a_measured_disturbance_has_a_sensor_and_no_actuator() -> None:
    said = _answers_otherwise((0, 2), [(0, 0)], measured=True)
    assert said.endswith("it is the plant itself or the sensor of the disturbance")


def test_a_change_that_a_declared_disturbance_explains_as_well_has_no_cause() -> None:
    where = ("u -> y", "u -> z")
    told = Reason(Code.MISMATCH_OR_DISTURBANCE, "mismatch and disturbance cannot be told apart here", where[0])
    causes = [Reason(Code.CAUSE_PLANT, "it has", one) for one in where] + [
        Reason(Code.CAUSE_VALVE_STICKING, "it sticks", where[0])
    ]
    found: Any = SimpleNamespace(compared=SimpleNamespace(notes=[told]), judged=SimpleNamespace(causes=causes))
    assert _causes(found) == causes[1:]
