"""Screening of the public example records: what is known of each is found, and no more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueplant.record import Channel, Layout, Screened, excitation, read_record, screen

pytestmark = pytest.mark.real


def rig(limits: tuple[float, float] | None = (0.0, 100.0), sp: bool = True) -> Layout:
    outputs = tuple(Channel(f"T{k}", f"pv{k}", sp=f"sp{k}" if sp else None, unit="degC") for k in (1, 2))
    return Layout(
        outputs, tuple(Channel(f"heater {k}", f"op{k}", limits=limits) for k in (1, 2)), project_time_unit="s"
    )


ONE = Layout((Channel("PV", "pv", sp="sp"),), (Channel("OP", "op"),), project_time_unit="s")


def screened(file: Path, layout: Layout, closed: bool = True) -> Screened:
    return screen(read_record(file, layout, closed=closed), layout)


def records(folder: Path) -> list[Path]:
    files = sorted(folder.glob("*.csv"))
    assert files, f"{folder} holds no records"
    return files


def found(result: Screened, kind: str) -> dict[str, float]:
    return {f.signal: f.value or 0.0 for f in result.findings if f.kind == kind}


@pytest.mark.parametrize("run", ["pid_short_01", "pid_short_02"])
@pytest.mark.parametrize("limits", [(0.0, 100.0), None])
def test_arduino_rig_under_pid(real_data: Path, run: str, limits: tuple[float, float] | None) -> None:
    result = screened(real_data / f"tclab_pid/{run}.csv", rig(limits))
    assert result.refusal is None
    saturated = found(result, "saturated")
    assert 0.15 < saturated["heater 1"] < 0.27
    assert 0.14 < saturated["heater 2"] < 0.22
    for quantum in found(result, "quantised").values():
        assert quantum == pytest.approx(0.4888, abs=1e-3)
    # the PV changes at every second sample of 0.25 s only
    np.testing.assert_allclose(result.update_interval, 0.5)
    spikes = {f.signal: f for f in result.findings if f.kind == "spike"}
    assert 15 <= len(spikes["T1"].spans) <= 40
    assert 40 <= len(spikes["T2"].spans) <= 90
    assert 0.985 < result.usable_y.mean() < 1.0
    assert len(result.segments) == 1
    e = excitation(result.segments, names=("T1", "T2"))
    assert e.changes.tolist() == [28, 28]
    assert e.sufficient


def test_spikes_that_were_left_out_exceed_three_degrees(real_data: Path) -> None:
    result = screened(real_data / "tclab_pid/pid_short_01.csv", rig())
    y, usable = result.record.y, result.usable_y
    for i in range(2):
        out = np.flatnonzero(~usable[:, i])
        local = np.array([np.median(y[max(0, k - 12) : k + 13, i]) for k in out])
        assert np.median(np.abs(y[out, i] - local)) > 3.0
        assert np.min(np.abs(y[out, i] - local)) > 2.4


def test_failed_and_working_lqg(real_data: Path) -> None:
    failed = screened(real_data / "tclab_lqg/sp_Regularized_ML_1.csv", rig())
    assert failed.refusal is None
    assert found(failed, "saturated")["heater 2"] == pytest.approx(0.501, abs=1e-3)
    good = screened(real_data / "tclab_lqg/sp_Augmented_ARX.csv", rig())
    assert good.refusal is None
    assert found(good, "quantised") == pytest.approx({"T1": 0.0322, "T2": 0.0322}, abs=2e-4)
    assert max(found(good, "saturated").values()) < 0.05
    assert good.usable_y.mean() > 0.999
    e = excitation(good.segments)
    assert e.changes.tolist() == [16, 16]
    assert e.sufficient


def test_open_loop_switching_is_not_saturated(real_data: Path) -> None:
    result = screened(real_data / "tclab_lqg/openloop_prbs.csv", rig(None, sp=False), closed=False)
    assert result.refusal is None
    assert found(result, "saturated") == {}
    assert excitation(result.segments, "u").sufficient
    assert excitation(result.segments, "r").rank == 0


def test_oven_runs(real_data: Path) -> None:
    for file in records(real_data / "pid_oven"):
        result = screened(file, ONE)
        assert result.refusal is None, file.name
        assert result.usable_y.all(), file.name
        assert len(result.segments) == 1
        assert result.segments[0].h == pytest.approx(0.25 if "250ms" in file.name else 1.0)


@pytest.mark.parametrize("time", ["t", "time", None])
def test_refinery_history(real_data: Path, time: str | None) -> None:
    for file in records(real_data / "refinery"):
        layout = Layout(ONE.outputs, (Channel("OP", "op", mode="mode"),), time=time, project_time_unit="min")
        result = screened(file, layout)
        record = result.record
        assert record.t.size == 751
        np.testing.assert_allclose(record.t, np.arange(751) / 6, atol=1e-9)
        assert (record.start is not None) == (time == "time")
        assert record.automatic.all()
        assert result.refusal is None
        assert result.usable_y.all()
