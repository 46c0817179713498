"""What counts as a move: constants however they are written and sampled do not, the smallest real moves do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, assume, example, given, settings
from hypothesis import strategies as st

from trueplant.record import Channel, Layout, Screened, excitation, read_record, screen
from trueplant.record.moves import setpoint_moves
from trueplant.record.resolution import resolution, settled

LAYOUT = Layout((Channel("T", "pv", sp="sp"),), (Channel("Q", "op"),), project_time_unit="s")
N = 400
Array = np.ndarray

WRITTEN: dict[str, Callable[[Array, int], Array]] = {
    "doubles": lambda x, _: x,
    "float32": lambda x, _: x.astype(np.float32).astype(float),
    "decimals": lambda x, digits: np.round(x, digits),
    "digits": lambda x, digits: np.array([float(f"{v:.{digits}g}") for v in x]),
    "float32 in text": lambda x, _: np.array([float(f"{v:.9g}") for v in x.astype(np.float32)]),
}


def stamps(rng: np.random.Generator, irregular: bool) -> Array:
    return np.cumsum(rng.uniform(0.3, 1.7, N)) if irregular else np.arange(N) * 1.0


def screened(
    t: Array, sp: Array, write: Callable[[Array], Array], rng: np.random.Generator, spread: float = 3.0
) -> Screened:
    """Of one loop whose PV and OP are noise about a level; all signals but time go through `write`."""
    noise = rng.standard_normal((2, N))
    signals = {"sp": sp, "pv": sp.mean() + spread * noise[0], "op": 40.0 + noise[1]}
    data: dict[str, Any] = {"t": t} | {name: write(x) for name, x in signals.items()}
    return screen(read_record(data, LAYOUT), LAYOUT)


def moves(result: Screened) -> int:
    """How often the set-point moves, by the excitation table; the one definition says the same of every segment."""
    assert result.refusal is None
    count = int(excitation(result.segments).changes[0])
    assert count == sum(int(np.sum(np.diff(s.setpoints[:, 0]) != 0)) for s in result.segments)
    return count


@settings(max_examples=60, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate))
@given(
    seed=st.integers(0, 2**32 - 1),
    level=st.one_of(st.just(0.0), st.floats(1e-3, 200.0), st.floats(-200.0, -1e-3)),
    offset=st.sampled_from([0.0, 1e6]),
    way=st.sampled_from(sorted(WRITTEN)),
    digits=st.integers(2, 6),
    irregular=st.booleans(),
)
def test_a_constant_setpoint_never_moves(
    seed: int, level: float, offset: float, way: str, digits: int, irregular: bool
) -> None:
    """Not even where arithmetic on it left some last places, which printing may carry over to the next digit."""
    assume(way != "digits" or offset == 0)  # else nothing is left of PV
    rng = np.random.default_rng(seed)
    value = level + offset
    single = way.startswith("float32")
    size = max(abs(value), 1e-3)
    ulp = float(np.spacing(np.float32(size))) if single else float(np.spacing(size))
    dust = (0.49 if single else 1.0) * ulp * rng.integers(-1, 2, N)
    result = screened(stamps(rng, irregular), value + dust, lambda x: WRITTEN[way](x, digits), rng)
    assert moves(result) == 0
    assert all(np.ptp(s.r) == 0 for s in result.segments)


@settings(max_examples=60, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate))
@given(
    seed=st.integers(0, 2**32 - 1),
    level=st.integers(-200, 200),
    offset=st.sampled_from([0, 1_000_000]),
    digits=st.integers(2, 6),
    irregular=st.booleans(),
)
@example(seed=179207, level=-82, offset=1_000_000, digits=6, irregular=True)
def test_the_smallest_printed_moves_count(seed: int, level: int, offset: int, digits: int, irregular: bool) -> None:
    """Two of the last digit that are printed, once in the record and wherever it lies; the finding says nothing."""
    rng = np.random.default_rng(seed)
    step = 2 * 10.0**-digits
    at = int(rng.integers(50, N - 50))
    sp = level + offset + step * (np.arange(N) >= at)
    result = screened(stamps(rng, irregular), sp, lambda x: np.round(x, digits), rng)
    assert 1 <= moves(result) <= 2  # an irregular one falls between two instants of the grid
    assert max(np.ptp(s.r) for s in result.segments) == pytest.approx(step, rel=1e-3)
    assert not any(f.kind == "constant" for f in result.findings)


def test_a_setpoint_may_go_to_a_number_that_others_write_for_no_value() -> None:
    """999 after a constant 995; beside values about 50 it is no measurement."""
    rng = np.random.default_rng(5)
    late = np.arange(N) >= 200
    asked = screened(stamps(rng, False), np.where(late, 999.0, 995.0), lambda x: np.round(x, 2), rng)
    assert moves(asked) == 1
    assert not asked.findings
    lost = screened(stamps(rng, False), np.where(late, 999.0, 50.0), lambda x: np.round(x, 2), rng)
    assert {f.kind for f in lost.findings} >= {"code", "constant"}


@pytest.mark.parametrize("level", [0.0, 37.5, 1e6])
def test_the_smallest_moves_of_floating_point_numbers_count(level: float) -> None:
    rng = np.random.default_rng(1)
    late = np.arange(N) >= 200
    places = 3 * np.spacing(np.float32(level + 16.0))
    single = WRITTEN["float32"]
    assert moves(screened(stamps(rng, False), level + 1.0 + places * late, lambda x: single(x, 0), rng)) == 1
    tiny = 20 * np.spacing(level + 16.0)
    assert moves(screened(stamps(rng, False), level + np.pi + tiny * late, lambda x: x, rng)) == 1


def test_a_round_setpoint_is_as_fine_as_its_pv_is_written() -> None:
    """From 21 to 22 is a move where PV is written to the hundredth, and within the resolution where PV is whole too."""
    rng = np.random.default_rng(2)
    sp = np.where(np.arange(N) < 200, 21.0, 22.0)
    assert moves(screened(stamps(rng, False), sp, lambda x: np.round(x, 2), rng)) == 1
    whole = screened(stamps(rng, False), sp, lambda x: np.round(x, 0), rng)
    assert moves(whole) == 0
    (said,) = [f for f in whole.findings if f.kind == "constant"]
    assert said.message == "set-point of T moves by 1, no more than the record resolves; taken as constant."
    assert moves(screened(stamps(rng, False), 21.0 + 2 * (sp > 21), lambda x: np.round(x, 0), rng)) == 1


def test_a_setpoint_is_no_finer_than_the_quantum_of_its_pv() -> None:
    """A set-point that went through the same converter flickers by one step of it."""
    rng = np.random.default_rng(3)
    flicker = 50.0 + 0.25 * rng.integers(0, 2, N)

    def converted(x: Array) -> Array:
        return 0.25 * np.round(x / 0.25)

    assert moves(screened(stamps(rng, False), flicker, converted, rng, 0.5)) == 0
    assert moves(screened(stamps(rng, False), flicker, lambda x: x, rng, 0.5)) > 100
    assert moves(screened(stamps(rng, False), 3 * flicker, converted, rng, 0.5)) > 100


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("written", ["digits", "quantum", "printed quantum"])
def test_flicker_beside_a_real_move_counts_no_more_than_flicker_alone(written: str, irregular: bool) -> None:
    """One move of 5 among toggling digits, or steps of a converter: one move everywhere; the record stays as it is."""
    rng = np.random.default_rng(8)
    step = {"digits": 0.1, "quantum": 0.25, "printed quantum": 0.3226}[written]

    def write(x: Array) -> Array:
        return np.round(step * np.round(x / step), 1 if written == "digits" else 2)

    sp = 50.0 + step * rng.integers(0, 2, N) + 5.0 * (np.arange(N) >= 200)
    record = read_record({"t": stamps(rng, irregular), "sp": write(sp)} | noisy(rng, write), LAYOUT)
    result = screen(record, LAYOUT)
    (of_record,) = setpoint_moves(record)
    assert of_record is not None
    assert of_record.sizes.size == 1
    assert of_record.sizes[0] == pytest.approx(5.0, abs=2 * step)
    assert 1 <= moves(result) <= 2  # an irregular one falls between two instants of the grid
    assert sum(int(np.sum(np.diff(s.r[:, 0]) != 0)) for s in result.segments) > 100
    assert not any(f.kind == "constant" for f in result.findings)
    if not irregular:
        (segment,) = result.segments
        np.testing.assert_array_equal(segment.r[:, 0], record.r[:, 0])
        part = segment.part(100, 300)
        np.testing.assert_array_equal(part.setpoints, segment.setpoints[100:300])


def noisy(rng: np.random.Generator, write: Callable[[Array], Array]) -> dict[str, Array]:
    """PV and OP about a level."""
    return {name: write(level + rng.standard_normal(N)) for name, level in (("pv", 50.0), ("op", 40.0))}


def test_a_ramp_that_is_printed_digit_by_digit_moves_as_a_whole() -> None:
    rng = np.random.default_rng(9)
    ramp = 50.0 + np.clip(np.arange(N) - 100.0, 0.0, 200.0) / 40
    printed = screened(stamps(rng, False), ramp, lambda x: np.round(x, 1), rng)
    (segment,) = printed.segments
    assert 20 <= moves(printed) <= 30  # of 50 digits, two at a time
    assert float(np.ptp(segment.setpoints)) == pytest.approx(5.0, abs=0.11)
    assert np.max(np.abs(segment.setpoints - segment.r)) <= 0.1 + 1e-9


def test_steps_of_a_digit_count_one_by_one_where_pv_is_written_more_finely() -> None:
    rng = np.random.default_rng(10)
    sp = 21.0 + np.arange(N) // 100
    assert moves(screened(stamps(rng, False), sp, lambda x: np.round(x, 2), rng)) == 3
    assert moves(screened(stamps(rng, False), sp, lambda x: np.round(x, 0), rng)) == 1
    assert moves(screened(stamps(rng, False), sp, lambda x: x, rng)) == 3


def test_a_setpoint_that_flickers_over_a_gap_is_known_throughout() -> None:
    """Missing for long between two values that are the same but for a digit: it rested, as between equal ones."""
    rng = np.random.default_rng(11)
    sp = 50.0 + 0.1 * (np.arange(N) % 2) + 5.0 * (np.arange(N) >= 300)
    data = {"t": np.arange(N) * 1.0, "sp": np.where((np.arange(N) >= 100) & (np.arange(N) < 201), np.nan, sp)}
    result = screen(read_record(data | noisy(rng, lambda x: np.round(x, 1)), LAYOUT), LAYOUT)
    (segment,) = result.segments
    assert np.isfinite(segment.r).all() and moves(result) == 1


def test_an_op_that_is_on_or_off_moves() -> None:
    """Whole numbers throughout: what an OP was is what was sent."""
    rng = np.random.default_rng(4)
    data = {
        "t": np.arange(N) * 1.0,
        "sp": np.full(N, 21.0),
        "pv": np.round(21 + 2 * rng.standard_normal(N)),
        "op": (np.arange(N) // 40 % 2).astype(float),
    }
    (segment,) = screen(read_record(data, LAYOUT), LAYOUT).segments
    assert np.sum(np.diff(segment.u[:, 0]) != 0) == 9


def test_gridding_leaves_the_levels_of_a_signal_as_they_are() -> None:
    """Irregular stamps: between its moves a set-point is the number that was recorded, to the last place."""
    rng = np.random.default_rng(5)
    t = stamps(rng, True)
    sp = 60.1 + 0.7 * (np.arange(N) // 50)
    result = screened(t, sp, lambda x: x, rng)
    r = np.concatenate([s.r[:, 0] for s in result.segments])
    assert np.isin(r, sp).mean() > 0.9
    assert moves(result) <= 2 * 7


def test_settled_signals_keep_what_moves_and_stay_settled() -> None:
    rng = np.random.default_rng(6)
    x = np.repeat([50.1, 50.2, 50.1, 61.0], 50) + np.spacing(61.0) * rng.integers(-1, 2, 200)
    x[[30, 120]] = np.nan
    y = settled(x)
    assert np.sum(np.diff(y[np.isfinite(y)]) != 0) == 3
    np.testing.assert_allclose(y, x, rtol=1e-15)
    np.testing.assert_array_equal(settled(y), y)
    np.testing.assert_array_equal(settled(np.full(5, np.nan)), np.full(5, np.nan))


@pytest.mark.parametrize(("unit", "numbers"), [(100.0, [100, 700]), (1.0, [3, 4]), (0.01, [2.31, 5.0]), (1e-5, [1e-5])])
def test_the_last_place_of_printed_numbers(unit: float, numbers: list[float]) -> None:
    assert resolution(np.array(numbers, dtype=float)) == pytest.approx(unit)


def test_the_last_place_of_floating_point_numbers() -> None:
    x = 40 + np.random.default_rng(7).standard_normal(500)
    assert resolution(x) < 1e-12
    assert resolution(x.astype(np.float32).astype(float)) == np.spacing(np.float32(np.max(x)))
    assert resolution(WRITTEN["float32 in text"](x, 0)) == pytest.approx(np.spacing(np.float32(np.max(x))) + 1e-7)
    assert resolution(np.round(x, 7)) == pytest.approx(1e-7)  # finer than float32, and not made of them
