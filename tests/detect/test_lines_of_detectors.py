"""What the search for an instant and the published detectors look at: lines of judgement, each held from both sides."""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from support.simulated import segment_of
from trueplant.detect import change_point, since
from trueplant.detect.signals import NotApplicable, signals_of
from trueplant.lti import TransferMatrix
from trueplant.record.types import Segment

Array = np.ndarray
one_class: Any = import_module("trueplant.detect.one_class")
stepwise: Any = import_module("trueplant.detect.stepwise")


def white(n: int, columns: int = 1, seed: int = 1) -> Array:
    return np.random.default_rng(seed).standard_normal((n, columns))


def echo(n: int, lag: int, seed: int = 1) -> Array:
    """(n, 1) white noise and 0.8 of what it was so many samples before."""
    return np.asarray(lfilter([1.0], np.r_[1.0, np.zeros(lag - 1), -0.8], white(n, 1, seed), axis=0))


def record(n: int, h: float = 1.0) -> Segment:
    """Noise in, noise out (simulated)."""
    columns = {"t": h * np.arange(n), "r": white(n), "u": white(n, seed=2), "y": white(n, seed=3)}
    return segment_of(Stub(h=h, **columns))  # type: ignore[arg-type]


# -- the instant of a change -----------------------------------------------------------------------------------------


@pytest.mark.holds("detect.BESIDE")
@pytest.mark.parametrize(("place", "looked_at"), [(6, False), (15, True), (85, True), (94, False)])
def test_a_change_has_ten_errors_on_either_side(place: int, looked_at: bool) -> None:
    filtered: Any = Stub(use=np.ones(100, dtype=bool), parts=Stub(t=np.arange(100.0)))
    assert (place in change_point._Filtered.places(filtered, (0.0, 100.0))) is looked_at


@pytest.mark.holds("detect.CHANGE_LARGEST_ORDER")
@pytest.mark.parametrize(("lag", "seen"), [(12, True), (22, False)])
def test_the_noise_about_a_change_comes_again_within_fifteen_samples(lag: int, seen: bool) -> None:
    parts: Any = Stub(piece=np.zeros(4000), valid=np.ones(4000, dtype=bool))
    row: Any = Stub(pieces=[None])
    assert (change_point._noise(echo(4000, lag)[:, 0], parts, row).size == lag) is seen


@pytest.mark.holds("detect.PARTS")
def test_a_step_is_looked_for_at_three_instants_of_a_window_and_between_windows() -> None:
    at = np.arange(3.0)
    series = since.Series(at, at + 1, np.zeros((3, 1)), np.ones((3, 1, 1)))
    assert since._instants(series) == pytest.approx([1.0, 1.25, 1.5, 1.75, 2.0])


# -- the published detectors -----------------------------------------------------------------------------------------


@pytest.mark.holds("detect.MOST_LAGS")
@pytest.mark.parametrize(("lag", "interval"), [(20.0, 1.0), (50.0, 2.0), (100.0, 3.0)])
def test_a_finely_sampled_record_is_thinned_out_to_a_hundred_lags(lag: float, interval: float) -> None:
    """Of a plant that takes three lags to settle."""
    signals = signals_of([record(4000)], TransferMatrix.of([[f"1/({lag} s + 1)"]], "min"))
    assert signals.h == interval
    assert signals.lags == pytest.approx(3 * lag / interval, abs=1)


@pytest.mark.holds("detect.MOST_STEPS")
def test_twenty_lags_at_most_enter_a_stepwise_regression(monkeypatch: Any) -> None:
    """Of forty that act, each found before the next."""
    entered: list[int] = []
    found = np.argmax
    monkeypatch.setattr(stepwise.np, "argmax", lambda t: entered.append(1) or found(t))
    u = white(4000)[:, 0]
    past = np.column_stack([np.roll(u, k) for k in range(60)])
    stepwise._forward(past, past[:, :40].sum(axis=1) / 2 + white(4000, seed=2)[:, 0], 4.0, 1)
    assert 15 <= len(entered) <= 30


@pytest.mark.holds("detect.STEPWISE_LARGEST_ORDER")
@pytest.mark.parametrize(("lag", "seen"), [(8, True), (14, False)])
def test_an_error_that_comes_again_within_ten_samples_is_whitened(lag: int, seen: bool, monkeypatch: Any) -> None:
    order: list[int] = []
    monkeypatch.setattr(stepwise, "_forward", lambda columns, e, *_: order.append(4000 - len(e)) or np.zeros(1))
    driven, e = white(4000, seed=5), echo(4000, lag)
    signals: Any = Stub(e=e, driven=driven, lags=5)
    stepwise.stepwise(signals)
    assert (order == [lag]) is seen


def windows_of(segment: Segment, lag: float) -> tuple[int, int]:
    """How many there are in the first half, and the samples of each."""
    found: list[tuple[int, int]] = []

    def features(parts: Any, size: int, *_: Any) -> Any:
        found.append((len(parts[0][0]) // size, size))
        raise NotApplicable("enough")

    with pytest.MonkeyPatch.context() as patch, suppress(NotApplicable):
        patch.setattr(one_class, "_features", features)
        one_class.one_class([segment], TransferMatrix.of([[f"1/({lag} s + 1)"]], "min"))
    return found[0] if found else (0, 0)


@pytest.mark.holds("detect.WINDOWS")
def test_twelve_windows_stand_for_the_loop_as_it_was() -> None:
    number, _ = windows_of(record(6000), 8.0)
    assert 9 < number < 17


@pytest.mark.holds("detect.WINDOW_ORDER")
@pytest.mark.parametrize(("samples", "enough"), [(700, False), (1100, True), (5000, True)])
def test_a_window_has_36_samples_at_least(samples: int, enough: bool) -> None:
    """Six for each of three past PVs and three past OPs."""
    assert (windows_of(record(samples), 8.0)[1] > 0) is enough


@pytest.mark.holds("detect.SAMPLES_PER_LAG")
def test_windows_have_eight_samples_a_lag() -> None:
    """48 samples a lag, of which each sixth is taken: 6,000 make twelve windows of 41 in the first half."""
    assert 30 < windows_of(record(6000), 48.0)[1] < 60


@pytest.mark.holds("detect.HORIZONS")
def test_windows_are_compared_early_and_late_in_a_step_response() -> None:
    """At half a lag, one and two: 39, 63 and 86 % of a first order."""
    pole = np.exp(-1 / 20)
    points = one_class._step_points(np.array([pole]), np.array([[1 - pole]]), 1.0, np.array([20.0]))
    assert points[0] == pytest.approx(1 - np.exp([-0.5, -1.0, -2.0]), rel=0.02)
