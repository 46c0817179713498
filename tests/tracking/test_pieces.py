"""One simulated loop whose record is cut: by files, by bad samples, by OP at its limits (seeds stated)."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.chance import most
from support.changing import changing_loop
from support.simulated import coloured, random_switching
from trueplant import Loop
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.notebook.loops import project_of
from trueplant.report.track import render
from trueplant.result import Track
from trueplant.tracking.track import track

THETA = (2.0, 8.0, 2.3)
TF = "2 exp(-2.3 s)/(8 s + 1)"
PLANT = TransferMatrix.of([[TF]], "min")
LAW = Controller.diagonal([PID(Kc=0.8, Ti=8.0, sample_time=1.0)])
BETWEEN = 500
"""Minutes between two files."""
LEAST = {"limits": 0.7, "bursts": 0.55, "rows": 0.55}
"""Share of the time that windows cover at least; set-points rest for some of it (0.73, 0.60 and 0.60 measured)."""
Frame = dict[str, Any]


def file(rng: np.random.Generator, gain: NDArray[np.float64], std: float = 0.1) -> Frame:
    """One record, from rest; gain (N,) over the plant's."""
    r = random_switching(rng, gain.size, 1, 60.0) / 2
    v = coloured(rng, gain.size, 1, [1, -0.8], [1], std)
    s = changing_loop(PLANT, LAW, r, v, (0, 0), THETA[0] * gain, THETA[1], THETA[2])
    return {"time": s.t, "sp": s.r[:, 0] + 50, "op": s.u[:, 0] + 40, "pv": s.y[:, 0] + 50}


def files(seed: int, sizes: list[int], at: int, factor: float = 1.3, stamped: bool = False) -> list[Frame]:
    """Several records of a plant whose gain rises at sample `at` of all of them together."""
    rng = np.random.default_rng([18, seed])
    found, first = [], 0
    for k, n in enumerate(sizes):
        own = file(rng, np.where(np.arange(first, first + n) >= at, factor, 1.0))
        if stamped:
            begin = datetime(2024, 3, 1) + timedelta(minutes=first + BETWEEN * k)
            own["time"] = [(begin + timedelta(minutes=i)).isoformat() for i in range(n)]
        found.append(own)
        first += n
    return found


def tracked(frames: list[Frame], tf: str = TF, **loop: Any) -> Track:
    loops = [Loop("L", pv="pv", sp="sp", op="op", **loop)]
    names = [f"file{k}" for k in range(len(frames))]
    project = project_of(names, loops, {("L", "L"): {"tf": tf, "structure": "fopdt"}}, None, "min", {})
    return track(project, frames=frames)


def true_instants(at: int, stamped: bool) -> tuple[int, int]:
    """Between which instants PV begins to follow the new gain: between two files, anywhere from one to the other."""
    late = at + (BETWEEN if stamped else 0)
    return (at if at == 1500 else late) + 1, late - 1


def test_a_change_in_the_second_file_is_found_and_dated() -> None:
    (change,) = tracked(files(0, [1500, 1500], 2300, stamped=True)).changes
    first, last = true_instants(2300, stamped=True)
    assert change.kind == "step" and change.interval[0] <= first and change.interval[1] >= last
    gain = change.parameters[0]
    assert gain.changed and gain.ci[0] < 0.3 * THETA[0] < gain.ci[1]


@pytest.mark.slow
@pytest.mark.parametrize("stamped", [False, True], ids=["laid in order", "calendar"])
@pytest.mark.parametrize(("at", "least"), [(1500, 2), (2300, 5)], ids=["between two files", "in the second"])
def test_changes_are_found_across_files(at: int, least: int, stamped: bool) -> None:
    """Seeds 0 to 5: found in five at least; dated in `least`, where of the intervals one may miss.

    In the middle of seven windows a step looks most like a drift: there the two are often left undecided (docs).
    """
    tracks = [tracked(files(seed, [1500, 1500], at, stamped=stamped)) for seed in range(6)]
    alone = [found.changes[0] for found in tracks if len(found.changes) == 1]
    steps = [change for change in alone if change.kind == "step"]
    assert len(alone) >= 5 and len(steps) >= least
    first, last = true_instants(at, stamped)
    assert sum(not (c.interval[0] <= first and c.interval[1] >= last) for c in steps) <= 1
    widths = [c.interval[1] - c.interval[0] for c in steps]
    assert np.median(widths) < 200 + (BETWEEN if stamped and at == 1500 else 0)
    gains = [c.parameters[0] for c in steps]
    assert all(gain.changed for gain in gains)
    assert sum(not gain.ci[0] < 0.3 * THETA[0] < gain.ci[1] for gain in gains) <= 1


@pytest.mark.slow
def test_files_too_short_for_a_window_are_estimated_together() -> None:
    """Twelve files of 150 min: none of them has the 200 samples that a window needs."""
    found = tracked(files(2, [150] * 12, 900))
    fitted = [w for w in found.windows if w.status == "ok"]
    assert len(fitted) >= 4 and all(", " in w.experiment for w in fitted)
    assert len(found.changes) == 1
    low, high = found.changes[0].interval
    assert low <= 901 and high >= 899


@pytest.mark.slow
def test_a_record_that_cannot_be_known_as_well_as_asked_is_followed_all_the_same() -> None:
    """Noise of 0.5 where the set-point moves by 1: 10 % would take more than a quarter of the record."""
    rng = np.random.default_rng([19, 3])
    found = tracked([file(rng, np.where(np.arange(3000) >= 1500, 1.8, 1.0), std=0.5)])
    fitted = [w for w in found.windows if w.status == "ok"]
    errors = [p.std_error / abs(p.plant) for w in fitted for e in w.elements for p in e.parameters[:2] if p.plant]
    assert len(fitted) >= 3 and max(errors) > 0.1
    assert len(found.changes) == 1


def cut_record(cut: str, seed: int, samples: int = 4000) -> Track:
    """Nothing changes; OP is at its limits in half of the samples, or two fifths are lost in bursts of some 30."""
    rng = np.random.default_rng([20, seed])
    r = random_switching(rng, samples, 1, 60.0) / 2
    v = coloured(rng, samples, 1, [1, -0.8], [1], 0.1)
    lengths = np.column_stack([rng.geometric(1 / 45, 400), rng.geometric(1 / 30, 400)]).ravel()
    good = np.repeat(np.tile([True, False], 400), lengths)[:samples]
    s = simulate(PLANT, LAW, r, 1.0, v=v)
    if cut == "limits":
        low, high = np.quantile(s.u, [0.15, 0.85]).tolist()
        s = simulate(PLANT, LAW, r, 1.0, v=v, limits=[(low, high)])
        assert 0.4 < np.mean((s.u <= low) | (s.u >= high)) < 0.6
    frame = {"time": s.t, "sp": s.r[:, 0] + 50, "op": s.u[:, 0] + 40, "pv": s.y[:, 0] + 50}
    if cut == "limits":
        return tracked([frame], op_limits=(low + 40, high + 40))
    if cut == "bursts":
        return tracked([frame | {"pv": np.where(good, frame["pv"], np.nan)}])
    return tracked([{name: x[good] for name, x in frame.items()}])


@pytest.mark.slow
@pytest.mark.parametrize("cut", ["limits", "bursts", "rows"])
def test_pieces_of_a_window_are_estimated_jointly(cut: str) -> None:
    """Seeds 0 to 5: each record is followed, its windows cover, and no change is called but by chance.

    At 5 % two changes or more in six records come with 0.03, at 30 % with 0.58. Set-points rest for the rest of the
    time: five settling times after a move nothing is left to estimate from.
    """
    tracks = [cut_record(cut, seed) for seed in range(6)]
    fitted = [[w for w in found.windows if w.status == "ok"] for found in tracks]
    assert min(sum(w.end - w.start for w in own) for own in fitted) > LEAST[cut] * 4000
    assert sum(bool(found.changes) for found in tracks) <= 1
    missed = [
        not p.ci[0] <= true <= p.ci[1]
        for own in fitted
        for w in own
        for e in w.elements
        for p, true in zip(e.parameters, THETA, strict=True)
        if p.ci
    ]
    assert len(missed) >= 72 and sum(missed) <= most(len(missed), 0.05)


def test_constant_but_off_the_model_is_said_with_its_interval() -> None:
    """The model's gain is 1.55: the plant's is 29 % larger all the time."""
    found = tracked(files(4, [2000], 9999), tf="1.55 exp(-2.3 s)/(8 s + 1)")
    assert found.changes == () and "L OP -> L is constant, but " in found.headline
    (element,) = found.elements
    assert element.standing is not None and element.standing.verdict == "changed"
    page = render(found)
    assert 'class="verdict mismatch"' in page and "constant, off the model" in page
    gain = element.standing.parameters[0]
    assert gain.changed and gain.plant is not None and gain.ci is not None and gain.ci[0] < 2.0 < gain.ci[1]
    assert gain.change_percent == pytest.approx(29, abs=5)
    assert f"{gain.change_percent:.0f} % off the model: gain {gain.plant:.2f} (" in found.headline


@pytest.mark.slow
def test_after_a_step_the_standing_is_that_of_the_longest_stretch() -> None:
    found = tracked(files(6, [2600], 800, 1.4))
    (element,) = found.elements
    assert element.history == "step" and element.standing is not None
    gain = element.standing.parameters[0]
    assert gain.ci is not None and gain.ci[0] < 1.4 * THETA[0] < gain.ci[1]


@pytest.mark.slow
def test_nothing_is_off_the_model_that_is_as_the_model_has_it() -> None:
    """80 records at 5 %: `most` passes at that level with 0.99, at 20 % with less than 0.05; intervals likewise.

    Where a change is called by chance, at 5 % as well, nothing is said of how the element stands to the model.
    """
    found = [tracked(files(seed, [1200], 9999)).elements[0].standing for seed in range(100, 180)]
    told = [one for one in found if one is not None]
    assert len(told) >= 80 - most(80, 0.05)
    assert sum(one.verdict == "changed" for one in told) <= most(80, 0.05)
    missed = [
        not p.ci[0] <= true <= p.ci[1] for one in told for p, true in zip(one.parameters, THETA, strict=True) if p.ci
    ]
    assert sum(missed) <= most(240, 0.05)
