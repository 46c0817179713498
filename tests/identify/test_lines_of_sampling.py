"""How many samples, orders and loads an estimate takes: lines of judgement, each held from both of its sides."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest

from support.simulated import segment_of
from trueplant.identify import Row, Spec, estimate, initial_state, loads, pieces_of, strides
from trueplant.identify.blocks import block_length, most_moved
from trueplant.identify.descent import _limited
from trueplant.identify.estimate import free_of_noise, largest_order
from trueplant.identify.pieces import Piece
from trueplant.identify.strides import choose_stride, within_dead_times
from trueplant.lti import Structure
from trueplant.record.types import Segment

FOPDT = Structure.parse("fopdt")


def record(samples: int, seed: int = 1, first: float = 0.0, std: float = 1.0) -> Segment:
    """Noise in, noise out, a sample each unit of time."""
    rng = np.random.default_rng(seed)
    columns = {"t": first + np.arange(samples), "r": np.zeros((samples, 1))}
    columns |= {"u": std * rng.standard_normal((samples, 1)), "y": rng.standard_normal((samples, 1))}
    return segment_of(Stub(h=1.0, **columns))  # type: ignore[arg-type]


def row_of(*segments: Segment) -> Row:
    return Row((Spec(0, FOPDT, (2.0, 10.0, 1.0)),), pieces_of(segments, 0))


def stride(samples: int, lag: float) -> int:
    return choose_stride([record(samples)], [Spec(0, FOPDT, (1.0, lag, 0.0))], np.inf)


@pytest.mark.holds("identify.SAMPLES_PER_LAG")
def test_a_lag_keeps_eighty_samples() -> None:
    assert 60 < 1600 / stride(60_000, 1600.0) < 110


@pytest.mark.holds("identify.ENOUGH_SAMPLES")
def test_a_short_record_keeps_a_thousand_samples() -> None:
    assert 700 < 6000 / stride(6000, 1e5) < 1400


@pytest.mark.holds("identify.STRIDES_PER_DEAD_TIME")
@pytest.mark.parametrize(
    ("closed", "update", "tried"), [(True, 1, [25, 11, 10]), (True, 4, [25, 8]), (False, 1, []), (True, 25, [])]
)
def test_the_shortest_dead_time_that_is_found_keeps_four_samples(
    closed: bool, update: int, tried: list[int], monkeypatch: Any
) -> None:
    """40 of the record; in open loop OP knows nothing of PV. Rows are looked at again until nothing is shorter."""
    monkeypatch.setattr(strides, "_shortest_dead_time", lambda row: row)
    segments, asked = [replace(record(100), closed=closed)], []

    def rows(stride: int) -> Any:
        asked.append(stride)
        return [40.0 if stride < 25 else 47.0, 60.0]

    assert within_dead_times(25, segments, update, rows) == (tried or [25])[-1]
    assert asked == tried


@pytest.mark.holds("identify.SHORTEST_BLOCK", "identify.LAGS_PER_BLOCK")
def test_blocks_are_65536_samples_or_three_hundred_lags() -> None:
    assert 50_000 < block_length(0.0, 1.0) < 90_000
    assert 200 < block_length(1000.0, 1.0) / 1000 < 450


@pytest.mark.holds("identify.SEARCHED_ERRORS")
def test_a_long_record_is_searched_on_twenty_thousand_errors() -> None:
    taken = sum(piece.y.size for piece in most_moved(row_of(record(100_000))).pieces)
    assert 14_000 < taken < 28_000


@pytest.mark.holds("identify.SAMPLES_PER_ORDER")
def test_each_coefficient_of_the_noise_model_has_forty_samples() -> None:
    assert 30 < 1200 / largest_order(row_of(record(1200)), 1000) < 55


@pytest.mark.holds("identify.FASTEST_LAG")
def test_lags_end_at_a_twentieth_of_a_sample() -> None:
    low, _ = row_of(record(100)).bounds()
    assert 0.03 < low[1] < 0.08


@pytest.mark.holds("identify.MOST_JOINED")
def test_sixty_segments_at_most_share_an_operating_point() -> None:
    """A hundred of them, one sample apart: two pieces."""
    segments = [record(20, seed, first=21.0 * seed) for seed in range(100)]
    pieces: tuple[Piece, ...] = pieces_of(segments, 0)
    assert len(pieces) == 2


@pytest.mark.holds("identify.OFF_GRID")
@pytest.mark.parametrize(("off", "pieces"), [(0.035, 1), (0.08, 2)])
def test_what_a_gap_of_whole_samples_separates_is_one_piece(off: float, pieces: int) -> None:
    assert len(pieces_of([record(20), record(20, 2, first=22 + off)], 0)) == pieces


@pytest.mark.holds("identify.LARGEST_RATIO")
def test_a_time_constant_grows_or_shrinks_threefold_in_a_step() -> None:
    low = np.array([0.05])
    assert 2 < _limited(np.array([1.0]), np.array([100.0]), low)[0] < 4.5
    assert 0.25 < _limited(np.array([1.0]), np.array([-100.0]), low)[0] < 0.5


@pytest.mark.holds("identify.NOISE_FREE")
@pytest.mark.parametrize(
    ("left", "predicted", "free"),
    [(0.7e-18, 1.0, True), (1.4e-18, 1.0, False), (1.0, 0.7e-24, True), (1.0, 1.4e-24, False)],
)
def test_errors_of_a_billionth_of_the_output_are_rounding(
    left: float, predicted: float, free: bool, monkeypatch: Any
) -> None:
    """Or prediction errors of a thousandth of that."""
    y = np.array([1.0, -1.0, 1.0, -1.0])
    monkeypatch.setattr(estimate, "noise_signals", lambda fit: ([y * np.sqrt(left)], None))
    fit: Any = Stub(row=Stub(energy=4.0), cost=4 * predicted)
    assert free_of_noise(fit) is free


@pytest.mark.holds("identify.LARGEST_FREE_RESPONSE")
def test_a_free_response_is_no_larger_than_three_standard_deviations_of_a_forced_one() -> None:
    """Of an element with gain 2 and an input of standard deviation 5: the record begins in motion."""
    row, theta = row_of(record(4000, std=5.0)), np.array([2.0, 10.0, 1.0])
    past = row._pasts[0]
    (lag,) = initial_state._largest.py_func(theta, row._modes, past, past.span)
    assert 2 < lag / 10.0 < 4.5
    assert list(row.unknown(theta, 0).largest[1:]) == pytest.approx([lag])


@pytest.mark.holds("identify.SAMPLES_PER_LOAD")
def test_each_load_has_a_hundred_prediction_errors(monkeypatch: Any) -> None:
    """A thousand errors in which any load would gain."""
    found: list[int] = []
    monkeypatch.setattr(loads, "_places", lambda fits: found)
    monkeypatch.setattr(loads, "_likeliest", lambda fits: len(found))
    monkeypatch.setattr(loads, "_with", lambda fits, place: found.append(place) or fits)
    monkeypatch.setattr(loads, "_rise", lambda other, fits: np.inf)
    monkeypatch.setattr(loads, "_cost", lambda fits, place: 0.0)
    fits: Any = {0: Stub(count=1000)}
    loads._more(fits)
    assert 7 <= len(found) <= 14
