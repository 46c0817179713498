"""(17) where OPs are at limits: from what is linear, loop by loop, and refused only where too little of that is left.

All records are simulated: Wood-Berry, or a plant in which the first loop acts on the second only, under BLT PI.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant import Loop, run
from trueplant.errors import Refused
from trueplant.loop import Controller, Simulation, simulate
from trueplant.lti import Structure, TransferMatrix, structure_of, to_formula
from trueplant.mismatch import fit_locally
from trueplant.record import Segment
from trueplant.study.methods.closed_form import closed_form, loops_needed

ONE_WAY = TransferMatrix.of(
    [["12.8 exp(-1.4 s)/(16.7 s + 1)", "0"], ["6.6 exp(-7.4 s)/(10.9 s + 1)", "-19.4 exp(-3.4 s)/(14.4 s + 1)"]], "min"
)
STUDY: Any = Stub(project=Stub(input_names=("reflux", "steam"), output_names=("top", "bottom")))
SAMPLES = 3000
FREE = np.tile([-np.inf, np.inf], (2, 1))


def simulated(plant: TransferMatrix, limits: NDArray[np.float64], seed: int = 1) -> Simulation:
    rng = np.random.default_rng(seed)
    r, v = random_switching(rng, SAMPLES, 2, 30.0), coloured(rng, SAMPLES, 2, [1, -0.8], [1], 0.05)
    return simulate(plant, BLT, r, 1.0, v=v, limits=limits)


def limited(plant: TransferMatrix, j: int, share: float, seed: int = 1) -> Segment:
    """OP j cannot follow where it would be lowest, for about this share of the samples."""
    limits = FREE.copy()
    limits[j, 0] = np.quantile(simulated(plant, FREE, seed).u[:, j], share)
    run = simulated(plant, limits, seed)
    return replace(segment_of(run), free=run.u > limits[:, 0] + 1e-9)


def structures(plant: TransferMatrix) -> dict[tuple[int, int], Structure]:
    return {(i, j): structure_of(plant[i, j])[0] for i in (0, 1) for j in (0, 1) if not plant[i, j].is_zero}


def answer(plant: TransferMatrix, segment: Segment) -> Any:
    return closed_form(STUDY, [segment], plant, structures(plant), BLT)


def off(plant: TransferMatrix, found: Any) -> float:
    """Largest distance of a parameter from the truth, in standard errors."""
    return max(
        float(np.max(np.abs(p - structure_of(plant[place])[1]) / np.sqrt(np.diag(found.covariance[place]))))
        for place, p in found.parameters.items()
    )


def test_rows_need_the_loops_that_act_on_what_their_controllers_read() -> None:
    def needed(elements: set[tuple[int, int]], entries: set[tuple[int, int]], size: int = 2) -> list[Any]:
        law = Controller(dict.fromkeys(entries, next(iter(BLT.entries.values()))), size, size)
        return [(one.rows, one.outputs, one.inputs) for one in loops_needed(elements, law)]

    own = {(0, 0), (1, 1)}
    assert needed(own | {(0, 1), (1, 0)}, own) == [((0, 1), (0, 1), (0, 1))]
    assert needed(own, own) == [((0,), (0,), (0,)), ((1,), (1,), (1,))]
    assert needed(own | {(1, 0)}, own) == [((0,), (0,), (0,)), ((1,), (0, 1), (0, 1))]
    # a controller that reads another output ties the loops, as a plant does
    assert needed(own, own | {(0, 1)}) == [((0,), (0, 1), (0, 1)), ((1,), (1,), (1,))]
    three = {(k, k) for k in range(3)}
    assert needed(three | {(2, 1)}, three, 3) == [
        ((0,), (0,), (0,)),
        ((1,), (1,), (1,)),
        ((2,), (1, 2), (1, 2)),
    ]


def test_loops_that_act_on_each_other_are_taken_where_all_are_free() -> None:
    """From them, with what the samples at the limit would move counted as error; OP of the loop is named."""
    segment = limited(WOOD_BERRY, 0, 0.03)
    assert 0 < np.mean(~segment.free[:, 0]) < 0.05 and segment.free[:, 1].all()
    found = answer(WOOD_BERRY, segment)
    assert found.parameters.keys() == structures(WOOD_BERRY).keys()
    assert off(WOOD_BERRY, found) < 4
    alone = fit_locally([segment], structures(WOOD_BERRY), WOOD_BERRY, "closed-form", BLT)
    whole = replace(segment, free=np.ones_like(segment.free))
    kept = fit_locally([whole], structures(WOOD_BERRY), WOOD_BERRY, "closed-form", BLT)
    for place, p in found.parameters.items():
        np.testing.assert_allclose(p, alone.parameters[place])
        apart = p - kept.parameters[place]
        np.testing.assert_allclose(found.covariance[place], alone.covariance[place] + np.outer(apart, apart))
    assert found.response is not None
    (note,) = found.notes
    assert (
        note.startswith("OP of reflux was at a limit or in manual for")
        and f"{len(segment.free_parts())} stretches" in note
    )


def test_what_lies_at_a_limit_is_struck_from_17() -> None:
    """PV that was garbage while OP was at its limit leaves no trace; a step that OP took there acts on what follows."""
    segment = replace(segment_of(simulated(WOOD_BERRY, FREE)))
    free = segment.free.copy()
    free[1000:1020, 0] = False
    wrong = segment.y.copy()
    wrong[1001:1019] += 50.0
    asked = structures(WOOD_BERRY), WOOD_BERRY, "closed-form", BLT
    right, struck, kept = (
        fit_locally([one], *asked).parameters
        for one in (replace(segment, free=free), replace(segment, free=free, y=wrong), replace(segment, y=wrong))
    )
    for place, p in right.items():
        np.testing.assert_allclose(struck[place], p, rtol=1e-6)
    assert max(float(np.max(np.abs(kept[place] / p - 1))) for place, p in right.items()) > 0.05


@pytest.mark.slow
def test_intervals_of_17_cover_where_a_loop_was_at_its_limit() -> None:
    """6 records, 2 and 27 % at the limit, from a model whose gains are 20 % too small: none 2.87 standard errors off,
    which counts as disagreement; by the free stretches alone 3 and 7 of 12 such records each were."""
    model = TransferMatrix(tuple(tuple(0.8 * element for element in row) for row in WOOD_BERRY.elements), "min")
    for share in (0.02, 0.15):
        for seed in range(3):
            segment = limited(WOOD_BERRY, 0, share, seed)
            assert off(WOOD_BERRY, closed_form(STUDY, [segment], model, structures(model), BLT)) < 2.87


def test_a_loop_that_the_other_does_not_reach_keeps_its_whole_record() -> None:
    """The second loop at its limit for a third of the time: the row of the first is the one of a record without."""
    segment = limited(ONE_WAY, 1, 0.3)
    share = float(np.mean(~segment.free[:, 1]))
    assert share > 0.1
    found = answer(ONE_WAY, segment)
    assert off(ONE_WAY, found) < 4
    one = replace(segment, free=np.ones_like(segment.free))
    first = TransferMatrix.of([[to_formula(ONE_WAY[0, 0], digits=12)]], "min")
    columns = {name: getattr(one, name)[:, :1] for name in ("r", "u", "y", "free")}
    law = Controller.diagonal([BLT.entries[0, 0]])
    alone = fit_locally([replace(one, **columns, hold=("zoh",))], structures_of_one(ONE_WAY), first, "closed-form", law)
    np.testing.assert_allclose(found.parameters[0, 0], alone.parameters[0, 0], rtol=1e-6)
    (note,) = found.notes
    assert note.startswith("OP of steam was at a limit")


def structures_of_one(plant: TransferMatrix) -> dict[tuple[int, int], Structure]:
    return {(0, 0): structure_of(plant[0, 0])[0]}


def test_only_the_row_is_refused_whose_loops_are_never_free_for_long() -> None:
    segment = limited(ONE_WAY, 1, 0.03)
    free = segment.free.copy()
    free[::20, 1] = False
    found = answer(ONE_WAY, replace(segment, free=free))
    assert set(found.parameters) == {(0, 0)}
    (said,) = found.notes
    assert said.startswith("of bottom (17) does not tell: OP of steam was at a limit or in manual for")
    both = replace(segment, free=np.column_stack([free[:, 1], free[:, 1]]))
    with pytest.raises(Refused, match=r"of top .*: OP of reflux was at a limit .* of bottom .*OP of steam"):
        answer(ONE_WAY, both)
    with pytest.raises(Refused, match=r"OP of steam was at a limit or in manual for 1e\+02 % .*no sample is left"):
        answer(WOOD_BERRY, replace(segment, free=np.column_stack([free[:, 0], np.zeros(SAMPLES, dtype=bool)])))


def test_the_analysis_answers_by_17_where_a_loop_was_at_its_limit() -> None:
    """In 2 % of the samples of one loop; the paper's route takes what comes before, from rest."""
    low = float(np.quantile(simulated(WOOD_BERRY, FREE).u[:, 0], 0.02))
    s = simulated(WOOD_BERRY, np.array([[low, np.inf], [-np.inf, np.inf]]))
    columns = {"t": s.t} | {f"{name}{k}": x[:, k] for name, x in (("r", s.r), ("u", s.u), ("y", s.y)) for k in (0, 1)}
    bounds: list[tuple[float, float]] = [(low, 100.0), (-100.0, 100.0)]
    loops = [
        Loop(
            name,
            pv=f"y{k}",
            sp=f"r{k}",
            op=f"u{k}",
            op_limits=bounds[k],
            controller={"Kc": BLT.entries[k, k].Kc, "Ti": BLT.entries[k, k].Ti, "sample_time": 1.0},  # type: ignore[union-attr]
        )
        for k, name in enumerate(("top", "bottom"))
    ]
    names = ("top", "bottom")
    model = {(y, u): to_formula(WOOD_BERRY[i, j], digits=12) for i, y in enumerate(names) for j, u in enumerate(names)}
    methods = run(columns, loops=loops, model=model, time_unit="min").result.methods
    assert "closed-form" not in methods.not_applied
    (remark,) = methods.remarks["closed-form"]
    assert "was at a limit or in manual" in remark
    assert len(methods.answers["closed-form"]) == 4
