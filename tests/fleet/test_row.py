"""A row says that something is wrong with a loop only where its result does."""

from __future__ import annotations

from dataclasses import replace

import pytest

from support.report_sample import sample
from trueplant.fleet.row import Finding, findings_of
from trueplant.result import Code, ControllerCheck, Reason


@pytest.mark.parametrize(("confirmed", "found"), [(True, False), (None, False), (False, True)])
def test_a_controller_that_could_not_be_checked_is_no_finding(confirmed: bool | None, found: bool) -> None:
    result = sample(("level",), ("valve",), experiments=1)
    check = ControllerCheck("run_1", "valve", "%", confirmed, 0.02, "what became of the check")
    notes = (Reason(Code.CONTROLLER, check.message, "run_1, valve"),)
    said = findings_of(replace(result, methods=replace(result.methods, controller_consistency=(check,)), notes=notes))
    assert (Finding.CONTROLLER in said) == found


def test_a_valve_that_sticks_is_one() -> None:
    result = sample(("level",), ("valve",), experiments=1)
    notes = (*result.notes, Reason(Code.CAUSE_VALVE_STICKING, "the valve sticks", "valve"))
    assert Finding.VALVE not in findings_of(result) and Finding.VALVE in findings_of(replace(result, notes=notes))
    ends = (*result.notes, Reason(Code.CAUSE_VALVE_END, "the valve is at its end", "valve"))
    assert Finding.END in findings_of(replace(result, notes=ends)) and Finding.END not in findings_of(result)
