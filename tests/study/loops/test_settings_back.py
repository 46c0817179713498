"""Settings as they are shown make the same law again, whatever the form, units and action."""

from __future__ import annotations

from dataclasses import replace

import pytest

from trueplant.errors import LoopError
from trueplant.loop import PID
from trueplant.result import ControllerSettings
from trueplant.study.loops.settings import Shown, law_of_settings, law_settings, slope_of

LAWS = {
    "ideal": PID(Kc=-1.2, Ti=8.0, Td=0.5, alpha=0.1, sample_time=0.1, setpoint_weight=0.5),
    "series": PID(form="series", Kc=1.2, Ti=8.0, Td=0.5, alpha=0.2),
    "parallel": PID(form="parallel", Kp=1.0, Ki=0.2, Kd=0.4, Tf=0.05),
    "P": PID(Kc=2.0),
}


@pytest.mark.parametrize("gain_unit", ["engineering", "percent of span"])
@pytest.mark.parametrize("with_action", [True, False])
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("slope", [1.0, 2.5])
def test_there_and_back(name: str, with_action: bool, gain_unit: str, slope: float) -> None:
    law = LAWS[name]
    shown = Shown(law.form, gain_unit, (50.0, 20.0), with_action, "min", {})
    back = law_of_settings(law_settings(law, shown, slope), law, shown, slope)
    assert back.parallel == pytest.approx(law.parallel, rel=1e-12)
    assert (back.sample_time, back.setpoint_weight) == (law.sample_time, law.setpoint_weight)


def test_a_derivative_that_is_new_has_a_filter() -> None:
    shown = Shown("ideal", "engineering", (None, None), False, "min", {})
    law = law_of_settings(ControllerSettings(form="ideal", Kc=1.0, Ti=5.0, Td=2.0), LAWS["P"], shown, 1.0)
    assert law.parallel == pytest.approx((1.0, 0.2, 2.0, 0.2))
    with pytest.raises(LoopError, match="must not be 0"):
        law_of_settings(ControllerSettings(form="ideal", Kc=0.0), LAWS["P"], shown, 1.0)


def test_the_slope_of_a_transform() -> None:
    law = replace(LAWS["ideal"], pv_transform=lambda pv: 3.0 * pv)
    assert slope_of(law, law.linearised(10.0)) == pytest.approx(3.0)
    assert slope_of(LAWS["ideal"], LAWS["ideal"]) == 1.0
