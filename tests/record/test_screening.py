"""What screening finds in records with one known fault, and that it finds nothing in records without."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from support.historian import swinging_door
from trueplant.errors import DataError
from trueplant.record import Channel, Layout, Screened, read_record, screen

N = 2000
LAYOUT = Layout(
    (Channel("T", "pv", sp="sp", limits=(0, 100)),),
    (Channel("Q", "op", limits=(0, 100), mode="mode"),),
    project_time_unit="s",
)


def loop(seed: int = 0, n: int = N, noise: float = 0.1) -> dict[str, Any]:
    """A first-order lag (50 samples, dead time 5) answering OP steps, with white noise, all well within the limits."""
    rng = np.random.default_rng(seed)
    sp = 50 + 5 * np.repeat(rng.choice([-1.0, 0.0, 1.0], n // 100 + 1), 100)[:n]
    op = 40 + 2 * (sp - 50) + lfilter([0.1], [1, -0.99], rng.standard_normal(n))
    a = np.exp(-1 / 50)
    answer = lfilter([0, 0, 0, 0, 0, 0, 1 - a], [1, -a], op - op[0])
    pv = 50 + 0.8 * answer + noise * rng.standard_normal(n)
    return {"t": np.arange(n) * 1.0, "sp": sp, "pv": pv, "op": op, "mode": np.ones(n)}


def screened(data: dict[str, Any], layout: Layout = LAYOUT, closed: bool = True, **options: Any) -> Screened:
    return screen(read_record(data, layout, closed=closed), layout, **options)


def kinds(result: Screened) -> list[str]:
    return [f.kind for f in result.findings if f.kind not in ("constant", "mode")]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.5])
def test_a_clean_record_has_no_findings(seed: int, noise: float) -> None:
    result = screened(loop(seed, noise=noise))
    assert kinds(result) == []
    assert result.refusal is None
    assert result.usable_y.all()
    assert [len(s) for s in result.segments] == [N]
    assert result.segments[0].free.all()
    np.testing.assert_allclose(result.update_interval, 1.0)


def test_noise_free_dead_time_at_rest_is_not_frozen() -> None:
    data = loop(noise=0.0)
    op = np.where(np.arange(N) < 400, 40.0, 45.0) + np.where(np.arange(N) > 1200, np.sin(np.arange(N) / 30), 0)
    data["op"] = op
    data["pv"] = np.round(50 + lfilter(np.r_[np.zeros(60), 0.1], [1, -0.9], op - 40), 3)
    assert "frozen" not in kinds(screened(data))
    assert "spike" not in kinds(screened(data))


@pytest.mark.parametrize("lag", [2.0, 10.0])
def test_a_noise_free_loop_at_rest_before_its_first_step_is_not_frozen(lag: float) -> None:
    data = loop()
    a = np.exp(-1 / lag)
    data["op"] = 40 + np.repeat([0.0, 3.0, -2.0, 4.0, 0.0], N // 5)
    data["pv"] = 50 + lfilter([0, 1 - a], [1, -a], data["op"] - 40)
    assert kinds(screened(data)) == []


@pytest.mark.parametrize("size", [3.0, -3.0, 30.0])
@pytest.mark.parametrize("width", [1, 2, 3])
def test_spikes_are_found_and_only_they(size: float, width: int) -> None:
    data = loop()
    at = np.arange(57, N - 10, 187)
    for k in range(width):
        data["pv"][at + k] += size * (1 + 0.1 * k)
    result = screened(data)
    assert kinds(result) == ["spike"]
    (spike,) = [f for f in result.findings if f.kind == "spike"]
    expected = {int(a) + k for a in at for k in range(width)}
    assert set(np.flatnonzero(~result.usable_y[:, 0])) == expected
    assert spike.samples == len(expected)
    assert len(spike.spans) == at.size
    assert spike.excludes
    assert np.isnan(result.segments[0].y[:, 0]).sum() == len(expected)
    # what the controller really did is kept
    np.testing.assert_array_equal(result.segments[0].u[:, 0], data["op"])


def test_steps_and_quantisation_steps_are_no_spikes() -> None:
    data = loop(noise=0.02)
    data["pv"] = np.where(np.arange(N) % 400 < 200, -10.0, 20.0) + np.round(data["pv"] / 0.1) * 0.1
    assert kinds(screened(data)) == ["quantised"]


def test_sharp_answers_without_noise_are_no_spikes() -> None:
    data = loop()
    pulse = np.zeros(N)
    pulse[100::400] = 20.0
    data["pv"] = 30 + lfilter([1.0], [1, -0.8], pulse)
    smooth = 50 + 10 * np.exp(-(((np.arange(N) - 1000) / 4.0) ** 2))
    for pv in (data["pv"], smooth):
        data["pv"] = pv
        assert "spike" not in kinds(screened(data))


@pytest.mark.parametrize("late", [1, 8])
@pytest.mark.parametrize("width", [1, 3])
def test_a_pv_that_follows_a_short_move_of_its_setpoint_does_not_spike(width: int, late: int) -> None:
    """A loop that answers within a sample: the same excursions are spikes where the set-point rests, or moves less."""
    data = loop(noise=0.05)
    at = np.arange(57, N - 20, 187)
    places = np.concatenate([at + k for k in range(width)])
    data["pv"] = 50 + np.random.default_rng(1).normal(0, 0.05, N)
    data["pv"][places + late] += 4.0
    rest, pulses = np.full(N, 50.0), np.zeros(N)
    pulses[places] = 4.0
    for sp, found in ((rest + pulses, []), (rest, ["spike"]), (rest + 0.4 * pulses, ["spike"])):
        assert [one for one in kinds(screened(data | {"sp": sp})) if one != "frozen"] == found


@pytest.mark.parametrize("seed", range(3))
def test_white_noise_has_no_spikes(seed: int) -> None:
    data = loop(n=20000)
    data["pv"] = 50 + np.random.default_rng(seed).standard_normal(20000)
    assert "spike" not in kinds(screened(data))


def test_saturation_is_counted_and_kept_as_input() -> None:
    data = loop()
    data["op"][300:700] = 100.0
    result = screened(data)
    (finding,) = [found for found in result.findings if found.kind != "mode"]
    assert (finding.kind, finding.signal, finding.samples, finding.excludes) == ("saturated", "Q", 400, False)
    assert finding.spans == ((300.0, 699.0),)
    assert finding.value == pytest.approx(0.2)
    assert result.usable_y.all()
    np.testing.assert_array_equal(result.saturated[:, 0], (np.arange(N) >= 300) & (np.arange(N) < 700))
    np.testing.assert_array_equal(result.segments[0].free[:, 0], ~result.saturated[:, 0])


def test_undeclared_limits_are_guessed_with_care() -> None:
    layout = Layout(LAYOUT.outputs, (Channel("Q", "op"),), project_time_unit="s")
    data = loop()
    data["op"][300:700] = 72.3
    data["op"] = np.minimum(data["op"], 72.3)
    (finding,) = [f for f in screened(data, layout).findings if f.kind == "saturated"]
    assert finding.samples == 400
    assert "seems" in finding.message
    # an OP moved by hand between two values sits at its extremes without being saturated
    data["op"] = np.where(np.arange(N) % 200 < 100, 20.0, 40.0)
    assert kinds(screened(data, layout, closed=False)) == []
    # a record that starts at rest at its lowest OP is not saturated there
    quiet = loop(noise=0.0)
    quiet["op"][:300] = np.min(quiet["op"]) - 1
    quiet["pv"][:300] = quiet["sp"][:300] = 50.0
    assert kinds(screened(quiet, layout)) == []


def test_limits_of_one_experiment_override() -> None:
    data = loop()
    data["op"] = np.minimum(data["op"], 45.0)
    assert "saturated" not in kinds(screened(data))
    assert "saturated" in kinds(screened(data, limits={"Q": (0.0, 45.0)}))


def test_manual_mode() -> None:
    data = loop()
    data["mode"][500:900] = 0
    result = screened(data)
    assert kinds(result) == ["manual"]
    assert result.findings[-1].value == pytest.approx(0.2)
    assert not result.segments[0].free[500:900].any()
    assert result.usable_y.all()


@pytest.mark.parametrize("begin", [0, 600, 1800])
def test_a_frozen_pv_is_left_out(begin: int) -> None:
    data = loop()
    data["pv"][begin : begin + 200] = data["pv"][begin] + (1.0 if begin == 0 else 0.0)
    result = screened(data)
    assert kinds(result) == ["frozen"]
    assert np.flatnonzero(~result.usable_y[:, 0]).tolist() == list(range(begin, begin + 200))


def test_what_a_channel_keeps_is_reported_and_used() -> None:
    data = loop()
    data["pv"][600:800] = data["pv"][600]
    data["pv"][1200] += 30.0
    kept = {"frozen": slice(600, 800), "spike": slice(1200, 1201)}
    for keep in ((), ("frozen",), ("spike",), ("frozen", "spike")):
        layout = replace(LAYOUT, outputs=(replace(LAYOUT.outputs[0], keep=keep),))
        result = screened(data, layout)
        assert kinds(result) == ["frozen", "spike"]
        for finding in result.findings:
            if finding.kind in kept:
                own = finding.kind in keep
                assert result.usable_y[kept[finding.kind], 0].all() == own and finding.excludes is not own
                assert finding.message.endswith("used, as the project says." if own else "left out.")
        assert np.sum(~result.usable_y) == 201 - sum(kept[one].stop - kept[one].start for one in keep)


def test_a_held_pv_is_not_frozen() -> None:
    data = loop()
    data["pv"] = np.repeat(data["pv"][::8], 8)[:N]
    result = screened(data)
    assert kinds(result) == ["held"]
    assert result.update_interval[0] == pytest.approx(8.0)
    assert result.usable_y.all()


def test_held_with_jitter_and_spiking() -> None:
    rng = np.random.default_rng(4)
    data = loop()
    at = np.concatenate([[0], np.cumsum(rng.choice([3, 4, 5], 1000))])
    last = np.searchsorted(at, np.arange(N), side="right") - 1
    values = data["pv"][np.minimum(at, N - 1)].copy()
    values[50:450:40] += 5.0
    data["pv"] = values[last]
    result = screened(data)
    assert kinds(result) == ["held", "spike"]
    assert result.update_interval[0] == pytest.approx(4.0, rel=0.1)
    np.testing.assert_array_equal(~result.usable_y[:, 0], np.isin(last, np.arange(50, 450, 40)))


@pytest.mark.parametrize("quantum", [0.1, 0.4888, 1.0])
def test_quantum(quantum: float) -> None:
    data = loop(noise=0.3)
    data["pv"] = np.round(np.round(data["pv"] / quantum) * quantum, 4)
    finding = next(f for f in screened(data).findings if f.kind == "quantised")
    assert finding.value == pytest.approx(quantum, rel=2e-3)
    assert not finding.excludes


def test_lines_between_every_tenth_sample_leave_nothing_usable() -> None:
    data = loop()
    t = data["t"]
    kept = np.arange(0, N, 10)
    data["pv"] = np.interp(t, t[kept], data["pv"][kept])
    result = screened(data)
    (finding,) = [f for f in result.findings if f.kind == "compressed"]
    assert finding.value == pytest.approx(0.1, abs=0.02)
    assert finding.excludes
    assert "T was compressed by its historian until little" in (result.refusal or "")


@pytest.mark.parametrize("digits", [None, 5, 3])
@pytest.mark.parametrize("deviation", [0.25, 0.5, 1.0])
def test_swinging_door_leaves_its_mark_at_any_printing(deviation: float, digits: int | None) -> None:
    """Deviations in standard deviations of the noise; the share stored is known here, since we stored it."""
    data = loop()
    whole = data["pv"]
    data["pv"] = swinging_door(whole, 0.1 * deviation)
    stored = float(np.mean(data["pv"] == whole))
    if digits is not None:
        data["pv"] = np.round(data["pv"], digits)
    (finding,) = [f for f in screened(data).findings if f.kind == "compressed"]
    assert finding.signal == "T"
    assert finding.value == pytest.approx(stored, abs=0.05)


def test_a_compressed_op_is_told_and_refused_where_little_is_left() -> None:
    data = loop()
    jitter = 0.3 * np.random.default_rng(7).standard_normal(N)
    for deviation, refused in ((0.1, False), (0.3, True)):
        data["op"] = swinging_door(loop()["op"] + jitter, deviation)
        result = screened(data)
        (finding,) = [f for f in result.findings if f.kind == "compressed"]
        assert finding.signal == "Q"
        assert ("OP of Q was compressed" in (result.refusal or "")) == refused


@pytest.mark.parametrize("every", [2, 5])
def test_the_ramps_of_integral_action_while_pv_is_held_are_no_compression(every: int) -> None:
    data = loop()
    data["pv"] = np.repeat(data["pv"][::every], every)[:N]
    for late in (0, 1):
        error = np.roll(data["sp"] - data["pv"], late)
        data["op"] = 40 + np.cumsum(error - np.mean(error)) / 40
        assert "compressed" not in kinds(screened(data))


def test_a_compressed_op_is_told_beside_a_pv_that_is_held() -> None:
    data = loop()
    data["op"] = swinging_door(data["op"] + 0.3 * np.random.default_rng(7).standard_normal(N), 0.3)
    data["pv"] = np.repeat(data["pv"][::3], 3)[:N]
    assert "compressed" in kinds(screened(data))


def test_ramps_and_rate_limits_are_no_compression() -> None:
    data = loop()
    rate = 0.05 * np.sign(np.sin(np.arange(N) / 30))
    data["op"] = 40 + np.cumsum(rate)
    data["pv"] = 50 + 0.2 * np.cumsum(rate)
    assert "compressed" not in kinds(screened(data))


def test_range_of_the_instrument() -> None:
    data = loop()
    data["pv"][100:150] = 100.0
    data["pv"][400] = -3.0
    result = screened(data)
    (finding,) = [f for f in result.findings if f.kind == "out-of-range"]
    assert finding.samples == 51
    assert np.flatnonzero(~result.usable_y[:, 0]).tolist() == [*range(100, 150), 400]


def test_outliers_are_told_but_kept() -> None:
    layout = Layout((Channel("T", "pv"),), LAYOUT.inputs, project_time_unit="s")
    data = loop()
    data["pv"][100:120] = -9999.0 + np.arange(20)
    result = screened(data, layout)
    assert kinds(result) == ["outlier"]
    assert result.findings[-1].samples == 20
    assert result.usable_y.all()


def test_user_exclusion() -> None:
    result = screened(loop(), exclude=[(0.0, 99.0), (500.0, 549.0)])
    assert int((~result.usable_y).sum()) == 150
    (segment,) = result.segments
    assert segment.t[0] == 100.0
    assert np.isnan(segment.y[400:450, 0]).all()
    assert np.isfinite(segment.u).all()
    with pytest.raises(DataError, match="swap"):
        screened(loop(), exclude=[(5.0, 1.0)])


def test_reader_notes_are_findings_too() -> None:
    data = loop()
    data["pv"] = [*map(str, data["pv"][:-1]), "Bad"]
    result = screened(data)
    assert kinds(result) == ["text", "missing"]
    assert not result.usable_y[-1, 0]
    assert len(result.segments[0]) == N - 1


def test_samples_at_a_limit_or_in_manual_stay() -> None:
    """However many there are: they are true inputs, and whether the rest tells is for the excitation to say."""
    data = loop()
    data["op"][:1300] = 100.0
    (segment,) = screened(data).segments
    assert len(segment) == N and np.isfinite(segment.y).all() and not segment.free[:1300].any()
    data = loop()
    data["mode"][:1300] = 0
    (segment,) = screened(data).segments
    assert len(segment) == N and np.isfinite(segment.y).all() and not segment.free[:1300].any()


def test_refusals() -> None:
    data = loop()
    data["pv"][:] = 50.0
    assert "T is frozen all the time" in (screened(data).refusal or "")
    data = loop()
    data["op"][:] = 40.0
    assert "OP never moves" in (screened(data).refusal or "")
    assert "all of the record is excluded" in (screened(loop(), exclude=[(0.0, 1e9)]).refusal or "")
    assert "fewer than 20 usable" in (screened(loop(), exclude=[(15.0, 1e9)]).refusal or "")


def test_a_million_samples_are_one_segment() -> None:
    result = screen(read_record(loop(n=1_000_000), LAYOUT), LAYOUT)
    assert [len(segment) for segment in result.segments] == [1_000_000]


def test_a_pv_where_it_was_asked_to_be_is_no_outlier() -> None:
    """A long record at one set-point, and one move far from it."""
    n = 20_000
    rng = np.random.default_rng(3)
    sp = np.where((np.arange(n) > 9000) & (np.arange(n) < 9060), 62.0, 50.0)
    pv = np.convolve(sp - 50, np.ones(10) / 10)[:n] + 50 + 0.1 * rng.standard_normal(n)
    data = {"t": np.arange(n) * 1.0, "sp": sp, "pv": pv, "op": 40 + 0.5 * (sp - 50), "mode": np.ones(n)}
    assert "outlier" not in kinds(screened(data))
    assert "outlier" in kinds(screened(data | {"sp": np.full(n, 50.0)}))
