"""Where the lines are in the check of a declared controller: each held from just inside and from just outside of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from support.simulated import segment_of
from trueplant.loop import PID, Controller, Kind, Sum, law_parts
from trueplant.record import Segment
from trueplant.result import ControllerCheck
from trueplant.study import levels
from trueplant.study.data import controller_check, law_judged, op_law, scan
from trueplant.study.data.by_hand import hand_notes, without_hand
from trueplant.study.data.law_samples import wrong_samples
from trueplant.study.data.law_trend import law_trend
from trueplant.study.data.law_windows import (
    Cuts,
    Moments,
    Stretch,
    Windows,
    _whitening,
    cut,
    windows_of,
)

Array = NDArray[np.float64]
LAW = Controller.diagonal([PID(Kc=1.0)])
"""OP is the set-point less PV."""
BACKWARD = (Sum.BACKWARD, Sum.BACKWARD)


def noise(samples: int) -> Array:
    return np.random.default_rng(1).standard_normal(samples)


def record(u: Array, y: Array) -> Segment:
    """Of one loop whose set-point rests."""
    columns = {name: x[:, None] for name, x in (("r", np.zeros(u.size)), ("u", u), ("y", y))}
    return segment_of(Stub(h=1.0, t=np.arange(u.size, dtype=float), **columns))  # type: ignore[arg-type]


def records(u: Array, y: Array) -> Any:
    """What a study has of that record, no controller declared."""
    segment = record(u, y)
    project = Stub(input_names=("u",), inputs=[None], experiments=[Stub(closed=True, controllers=())])
    return Stub(declared=[None], screened=[Stub(segments=[segment])], segments=[segment], project=project)


def written(u: Array, y: Array) -> bool:
    """Can a law have written OP from the samples of the record?"""
    return op_law.written_from_samples(records(u, y), 0, 0)


def stretch(u: Array, y: Array) -> Stretch:
    good = np.ones(u.size, dtype=bool)
    return Stretch(np.arange(u.size, dtype=float), u, np.zeros((u.size, 1)), y[:, None], good, 1.0)


# -- OP from the samples that there are ------------------------------------------------------------------------------


@pytest.mark.holds("study.LAW_PAST")
@pytest.mark.parametrize(("late", "sees"), [(3, True), (6, False)])
def test_a_law_may_act_on_the_pv_of_four_samples_ago(late: int, sees: bool) -> None:
    y = noise(600)
    assert written(np.concatenate([np.zeros(late), -y[:-late]]), y) is sees


@pytest.mark.holds("study.FEWEST_PER_COEFFICIENT")
@pytest.mark.parametrize(("samples", "told"), [(109, False), (229, True)])
def test_an_op_that_no_law_wrote_is_told_from_ten_samples_for_each_of_fifteen_coefficients_on(
    samples: int, told: bool
) -> None:
    """Five of OP, set-point and PV each; four samples have no past."""
    own, y = noise(2 * samples).reshape(2, -1)
    assert written(own, y) is not told


@pytest.mark.holds("study.LAW_PARTS")
@pytest.mark.parametrize(("tenths", "one_law"), [((0, 2, 4, 6), True), ((0, 1, 2, 3, 4, 5, 6), False)])
def test_a_gain_may_change_in_four_tenths_of_a_record(tenths: tuple[int, ...], one_law: bool) -> None:
    y = noise(4004)
    gain = np.ones(4004)
    for tenth in tenths:
        gain[400 * tenth + 100 :] *= 1.5 if gain[-1] == 1 else 1 / 1.5
    assert written(-gain * y, y) is one_law


@pytest.mark.holds("study.EXACT_LAW")
@pytest.mark.parametrize(("left", "between"), [(3.5e-4, False), (8e-4, True)])
def test_a_law_that_acts_at_the_samples_alone_leaves_less_than_a_two_thousandth_of_op(
    left: float, between: bool
) -> None:
    own, y = noise(2000).reshape(2, -1)
    assert scan.written_between(records(left * own - y, y)) is between


# -- windows ---------------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.LAW_WINDOWS")
def test_a_long_record_is_cut_into_twenty_windows() -> None:
    y = noise(2000)
    (begin,) = cut([stretch(-y, y)], LAW, 0).begin
    assert 14 < begin.size < 28


@pytest.mark.holds("study.LAW_SAMPLES")
def test_fifty_thousand_samples_from_all_over_a_long_record_tell_its_law() -> None:
    u = np.zeros(200_000)
    parts = list(controller_check._enough([record(u, u)]))
    assert 35_000 < sum(map(len, parts)) < 70_000
    assert parts[-1].t[-1] > 180_000


@pytest.mark.holds("study.LAW_WINDOW")
@pytest.mark.parametrize(("samples", "judged"), [(14, False), (30, True)])
def test_a_law_is_judged_from_twenty_samples_on(samples: int, judged: bool) -> None:
    y = noise(samples)
    assert (law_judged.judged([stretch(-y, y)], LAW, 0, 1.0) is not None) is judged


@pytest.mark.holds("study.MOVED_QUANTA")
@pytest.mark.parametrize(("quanta", "counts"), [(2, False), (5, True)])
def test_a_window_counts_in_which_pv_moves_by_more_than_three_of_its_steps(quanta: int, counts: bool) -> None:
    y = np.abs(np.arange(400) % (2 * quanta) - quanta).astype(float)
    assert (cut([stretch(-y, y)], LAW, 0).samples > 0) is counts


@pytest.mark.holds("study.LAW_BEFORE")
@pytest.mark.parametrize(("windows", "told"), [(2, False), (4, True)])
def test_a_law_has_become_another_one_if_three_windows_show_it(windows: int, told: bool) -> None:
    """Twenty windows of twenty samples; the gain doubles after some of them."""
    y = noise(400)
    gain = np.where(np.arange(400) < 20 * windows, 1.0, 2.0)
    found = law_judged.judged([stretch(-gain * y, y)], LAW, 0, 1.0)
    assert found is not None
    assert (law_judged.parted(found) is not None) is told


@pytest.mark.parametrize(
    ("at", "gain", "ti", "seed"), [(1800, 0.6, 0.6, 0), (1800, 0.6, 0.6, 1), (1230, 0.6, 1.0, 2), (900, 1.0, 0.5, 0)]
)
def test_a_law_that_has_become_another_one_is_parted_by_its_own_sums(
    at: int, gain: float, ti: float, seed: int
) -> None:
    """Backward sums write OP; over both laws together forward ones may miss it least."""
    k = np.arange(2400)
    r = np.where(k // 120 % 2, 1.0, 0.0)
    y = lfilter([0.05], [1, -0.95], np.roll(r, 4)) + 0.05 * np.random.default_rng(seed).standard_normal(k.size)
    gains, times = np.where(k < at, 1.0, gain), np.where(k < at, 20.0, 20.0 * ti)
    e = r - y
    u = np.cumsum(gains * (np.diff(e, prepend=e[0]) + e / times))
    law = Controller.diagonal([PID(Kc=1.0, Ti=20.0, sample_time=1.0)])
    found = law_judged.judged([replace(stretch(u, y), r=r[:, None])], law, 0, float(np.std(u)))
    assert found is not None
    told = law_judged.parted(found)
    assert told is not None and told.declared_first and told.at == pytest.approx(at, abs=20)
    assert [one.value for one in told.ratios] == pytest.approx([gain, ti], rel=1e-3)


def test_a_law_without_any_control_error_is_parted_nowhere() -> None:
    """As where the set-point is a copy of PV."""
    found = law_judged.judged([stretch(noise(400), np.zeros(400))], LAW, 0, 1.0)
    assert found is None or law_judged.parted(found) is None


def rounded_pid(seed: int) -> tuple[Controller, Stretch]:
    """A PID that acts on what a historian rounds to three standard deviations of PV's noise, and its record."""
    rng = np.random.default_rng(seed)
    y = lfilter([0.3], [1, -0.98], rng.standard_normal(3000)) + 0.3 * rng.standard_normal(3000)
    law = Controller.diagonal([PID(Kc=2.0, Ti=30.0, Td=3.0, alpha=0.2, sample_time=1.0)])
    own = stretch(y, y)
    parts = law_parts(law, 0, own.r, own.y, 1.0, *BACKWARD, 1)
    u = np.sum([part.values for part in parts], axis=0)
    return law, replace(own, u=np.round(u / 0.01) * 0.01, y=np.round(own.y / 0.9) * 0.9)


def test_what_rounding_does_to_op_is_white_behind_the_filter() -> None:
    law, own = rounded_pid(0)
    cuts = cut([own], law, 0)
    rng = np.random.default_rng(5)
    y = cuts.pv_steps * (rng.random((20_000, 1)) - 0.5)
    parts = law_parts(law, 0, np.zeros_like(y), y, 1.0, *BACKWARD, 1)
    error = np.sum([part.values for part in parts], axis=0) + cuts.op_step * (rng.random(20_000) - 0.5)
    white = _whitening(cuts, law, 0, BACKWARD)(error[None, :, None])[0, 1000:, 0]
    for x, is_white in ((np.diff(error), False), (white, True)):
        lags = np.array([np.corrcoef(x[k:], x[:-k])[0, 1] for k in range(1, 30)])
        assert bool(np.abs(lags).max() < 4 / np.sqrt(x.size)) is is_white


def test_gains_behind_coarse_pvs_are_as_sure_as_they_say_and_surer_than_by_op_as_it_is() -> None:
    """Thirty records, seeds 0 on."""
    off, surer = [], []
    for seed in range(30):
        law, own = rounded_pid(seed)
        windows = windows_of(cut([own], law, 0), law, 0, BACKWARD)
        weighted, plain = windows.fit(), replace(windows, weighted=windows.plain).fit()
        off.append([(gain - 1) / weighted.std(d) for gain, d in zip(weighted.gains, np.eye(3), strict=True)])
        surer.append([weighted.std(d) / plain.std(d) for d in np.eye(3)])
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.25
    assert np.abs(off).max() < 4
    assert np.all(np.median(surer, axis=0) < 0.85)


def test_of_two_pvs_that_are_one_no_gain_is_known_and_nothing_is_left() -> None:
    law, own = rounded_pid(0)
    twice = Controller({(0, 0): law.entries[0, 0], (0, 1): law.entries[0, 0]}, 1, 2)
    both = replace(own, u=2 * own.u, r=np.hstack([own.r, own.r]), y=np.hstack([own.y, own.y]))
    found = law_judged.judged([both], twice, 0, float(np.std(both.u)))
    assert found is not None and not found.known and not found.off
    assert found.left <= found.allowed


@pytest.mark.parametrize("step", [1.0, 2.5, 5.0, 10.0])
def test_rounding_errors_of_a_slow_pv_follow_each_other(step: float) -> None:
    """PV moves by one standard deviation a sample: the errors correlate by what they do in 40,000 simulated ones."""
    y = np.cumsum(np.random.default_rng(3).standard_normal(40_000))
    rounded = np.round(y / step) * step
    error = rounded - y
    assert cut([stretch(rounded, rounded)], LAW, 0).slowness == pytest.approx(
        np.corrcoef(error[1:], error[:-1])[0, 1], abs=0.03
    )


def test_what_rounding_may_have_left_of_a_gain_grows_with_how_slow_its_errors_are() -> None:
    """Thirty windows that agree; errors that correlate by a half have three times the power at low frequencies."""
    one, part = np.ones(30), np.ones((30, 1, 1))
    sums = Moments(part, 0.9 * one[:, None], 0.9 * one, 0.1 * part, 0.0)
    windows = Windows(((0, Kind.GAIN),), one, np.full(30, 20), sums, sums, slowness=0.5)
    assert windows.fit().std(np.ones(1)) == pytest.approx(0.1 * (levels.ROUNDING_LEFT + 2.0), rel=0.01)


@pytest.mark.holds("study.ROUNDING_LEFT")
def test_a_tenth_of_the_bias_that_was_taken_off_for_rounding_counts_as_an_error() -> None:
    """Thirty windows that agree: PV's rounding adds a tenth to its power, without which the gain is 1 and not 0.9."""
    one, part = np.ones(30), np.ones((30, 1, 1))
    freedom = np.full(30, 20)
    sums = Moments(part, 0.9 * one[:, None], 0.9 * one, 0.1 * part, 0.0)
    windows = Windows(((0, Kind.GAIN),), one, freedom, sums, sums)
    fit = windows.fit()
    assert fit.gains == pytest.approx([1.0])
    assert 0.007 < fit.std(np.ones(1)) < 0.014


# -- samples ---------------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.STRUCK")
@pytest.mark.parametrize(("missed", "wrong"), [(3.3, False), (6.3, True)])
def test_a_sample_that_the_law_misses_by_four_and_a_half_standard_deviations_is_the_historians(
    missed: float, wrong: bool
) -> None:
    """OP goes to and fro by what is one standard deviation of normal errors."""
    y = np.cumsum(noise(1000))
    u = -y + 0.33725 * np.tile([1.0, -1.0], 500)
    u[500] += missed - 0.6745
    (found,) = wrong_samples(cut([stretch(u, y)], LAW, 0), LAW, 0, BACKWARD, [np.ones(1)])
    assert found[500] == wrong


@pytest.mark.holds("study.STRIKING_ROUNDS")
@pytest.mark.parametrize(("wrong", "left"), [(8, False), (18, True)])
def test_wrong_samples_are_looked_for_a_dozen_times(wrong: int, left: bool, monkeypatch: Any) -> None:
    """Each hides the next, so that one is seen at a time."""
    y = noise(400)
    u = -y
    u[10 : 10 + wrong] += 5.0

    def first(cuts: Cuts, *given: Any) -> list[NDArray[np.bool_]]:
        (own,) = cuts.stretches
        seen = own.good & (np.abs(own.u + own.y[:, 0]) > 1)
        return [seen & (np.cumsum(seen) == 1)]

    monkeypatch.setattr(law_judged, "wrong_samples", first)
    found = law_judged.judged([stretch(u, y)], LAW, 0, 1.0)
    assert found is not None
    assert (found.missed > 0.1) is left


@pytest.mark.holds("study.NEAR_LIMIT")
@pytest.mark.parametrize(("op", "free"), [(0.35, False), (0.7, True)])
def test_op_is_at_its_limit_within_half_a_percent_of_its_range(op: float, free: bool) -> None:
    u = 50 + noise(100)
    u[50] = op
    segment = record(u, np.zeros(100))
    plan = Stub(limits=[(0.0, 100.0)])
    study: Any = Stub(screened=[Stub(record=Stub(t=segment.t, u=segment.u))], project=Stub(experiments=[plan]))
    assert controller_check._stretch(study, 0, LAW, 0, segment).good[50] == free


# -- words and pictures ----------------------------------------------------------------------------------------------


@pytest.mark.holds("study.ROUNDING")
@pytest.mark.parametrize(("missed", "words"), [(0.7e-6, "to rounding"), (1.5e-6, "to 1.5e-06 % rms")])
def test_a_millionth_of_op_is_called_rounding(missed: float, words: str, monkeypatch: Any) -> None:
    found = Stub(confirmed=True, missed=missed, rounding=0.0, ratios=(), integral=None)
    monkeypatch.setattr(controller_check._Written, "of", lambda *given: Stub(stretches=(), scale=1.0, by_hand=()))
    monkeypatch.setattr(controller_check, "judged", lambda *given: found)
    study: Any = Stub(project=Stub(inputs=[Stub(name="u", unit="%")], output_names=("y",)))
    assert words in controller_check._entry(study, 0, "run", LAW, 0).message


@pytest.mark.holds("study.LAW_TREND_PIECES")
def test_the_integral_of_a_law_that_is_drawn_begins_anew_a_dozen_times() -> None:
    y = noise(600)
    law = Controller.diagonal([PID(Kc=1.0, Ti=10.0)])
    study: Any = Stub(records=Stub(declared=[law]), screened=[Stub(segments=[record(-y, y)])])
    assert 8 < np.isnan(law_trend(study, 0, 0).t).sum() < 18


@pytest.mark.holds("study.STOOD_STILL")
@pytest.mark.parametrize(("times", "manual"), [(6, False), (16, True)])
def test_op_is_in_manual_where_its_law_would_have_moved_it_by_ten_usual_moves(times: int, manual: bool) -> None:
    """OP moves by 1 from sample to sample, and stands still for 40 samples in the middle, in which PV steps."""
    y = np.arange(400) % 2 * 1.0
    u = -y
    u[200:240], y[200:220], y[220:240] = -y[199], y[199], y[199] + times
    (left,), found = without_hand([stretch(u, y)], LAW, 0)
    assert (found == ((200.0, 239.0),)) is manual
    assert left.good[200:240].any() == (not manual) and left.good[:200].all() and left.good[240:].all()


def test_an_op_that_never_moves_is_in_manual_throughout() -> None:
    (left,), found = without_hand([stretch(np.full(400, 5.0), noise(400))], LAW, 0)
    assert found == ((1.0, 399.0),) and not left.good[1:].any()


@pytest.mark.holds("study.SHOWN_BY_HAND")
@pytest.mark.parametrize(("stretches", "more"), [(2, False), (4, True)])
def test_three_stretches_in_manual_are_named(stretches: int, more: bool) -> None:
    said = tuple((10.0 * k, 10.0 * k + 5) for k in range(stretches))
    check = ControllerCheck("A", "u", "%", True, None, "", by_hand=said)
    calendar = Stub(span=lambda a, b: f"{a:g} to {b:g} s")
    study = Stub(project=Stub(experiments=[Stub(name="A")]), screened=[Stub(record=Stub(calendar=calendar))])
    (note,) = hand_notes(study, [check])
    assert ("times more" in note.message) is more and note.message.count("from ") == min(stretches, 3)
