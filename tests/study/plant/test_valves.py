"""Valves of several loops that do not follow their OPs."""

from __future__ import annotations

import numpy as np
import pytest

from support.simulated import BLT, WOOD_BERRY, coloured, random_switching
from support.two_loops import changed, project, written
from trueplant import run
from trueplant.loop import Valve, simulate
from trueplant.study.data.prepare import prepare
from trueplant.study.plant.identified import identify
from trueplant.study.study import quiet


@pytest.mark.parametrize("seed", [0, 4])
def test_a_valve_is_not_taken_for_its_neighbour_and_is_found_behind_it(tmp_path, seed):
    """Simulated, backlash of 6 and 1.5 % of OP's span: looked for at once the narrow one comes out four times as wide,
    as it makes up for the other."""
    rng = np.random.default_rng(seed)
    r, v = random_switching(rng, 1200, 2, 60.0), coloured(rng, 1200, 2, [1, -0.8], [1], 0.02)
    spans = np.ptp(simulate(WOOD_BERRY, BLT, r, 1.0, v=v).u, axis=0)
    bands = np.array([0.06, 0.015]) * spans
    valves = [Valve(backlash=float(band)) for band in bands]
    written(tmp_path, "record.csv", simulate(WOOD_BERRY, BLT, r, 1.0, v=v, valves=valves))
    found = identify(prepare(project(tmp_path), quiet, None), quiet).valves
    assert [found[j].valve.backlash for j in (0, 1)] == pytest.approx(bands, rel=0.2)


@pytest.mark.parametrize(("seed", "side"), [(1, "high"), (5, "low")])
def test_a_valve_that_ends_before_its_op_does_is_no_changed_plant(tmp_path, seed, side):
    """Simulated: reflux acts no more in a tenth of the samples, which nobody has declared."""
    rng = np.random.default_rng(seed)
    r, v = random_switching(rng, 1200, 2, 60.0), coloured(rng, 1200, 2, [1, -0.8], [1], 0.1)
    op = simulate(WOOD_BERRY, BLT, r, 1.0, v=v).u
    end = float(np.quantile(op[:, 0], 0.95 if side == "high" else 0.05))
    written(tmp_path, "record.csv", simulate(WOOD_BERRY, BLT, r, 1.0, v=v, valves=[Valve(**{side: end}), Valve()]))
    result = run(project(tmp_path))
    (note,) = [note for note in result.notes if note.code == "cause-valve-end"]
    assert note.where == "reflux" and f"acts {'up' if side == 'high' else 'down'} to " in note.message
    assert not changed(result)
    for element in result.elements:
        gain = element.parameters[0]
        assert gain.ci[0] < gain.model < gain.ci[1]
    assert "the valve of reflux does not follow OP" in result.shift.lower().replace("op", "OP")
    assert result.action == "check valve"
