"""What the report says of today's loops, as text: margins, robust performance, pairing, plants drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trueplant.report.numbers import MISSING, number

MEASURES = {
    "gain_margin": ("Gain margin", "above 2", 2.0),
    "phase_margin": ("Phase margin", "above 30°", 30.0),
    "delay_margin": ("Delay margin", "", None),
    "Ms": ("Ms, peak of the sensitivity", "below 2", -2.0),
    "Mt": ("Mt, peak of T", "", None),
}
"""Label, what is usual (Skogestad and Postlethwaite 2005, section 2.4), and that as a number, negative for at most."""
TESTS = {"NP": "Nominal performance (NP)", "RS": "Robust stability (RS)", "RP": "Robust performance (RP)"}
SYSTEMS = {
    "model": "Model, declared uncertainty",
    "plant": "Plant, declared uncertainty",
    "estimate": "Plant, what the data leave open",
}


@dataclass(frozen=True)
class Cell:
    """A number as text, and whether it is on the wrong side of what is usual or asked for."""

    text: str
    bad: bool = False


@dataclass(frozen=True)
class Loop:
    """One loop of the margins table: its input, and (measure, usual, model, plant) of each row."""

    input: str
    rows: tuple[tuple[str, str, Cell, Cell], ...]
    message: str
    """Why there are no margins; empty if there are."""

    @property
    def unusual(self) -> bool:
        """Is there a margin outside of what is usual?"""
        return any(cell.bad for _, _, *cells in self.rows for cell in cells)


def margin_loops(robustness: Mapping[str, Any], time_unit: str) -> list[Loop]:
    """The margins table, a loop at a time."""
    found = robustness.get("margins", {})
    loops = []
    for on_model, on_plant in zip(found.get("model", ()), found.get("plant", ()), strict=True):
        rows = tuple(
            (label, usual, _margin(on_model, key, limit, time_unit), _margin(on_plant, key, limit, time_unit))
            for key, (label, usual, limit) in MEASURES.items()
        )
        message = "; ".join(
            f"{name}: {one['message']}" for name, one in (("model", on_model), ("plant", on_plant)) if not one["stable"]
        )
        loops.append(Loop(on_model["input"], rows, message))
    return loops


def _margin(loop: Mapping[str, Any], key: str, limit: float | None, time_unit: str) -> Cell:
    if not loop["stable"]:
        return Cell("unstable", True)
    value = loop.get(key)
    if value is None:
        return Cell("no limit")
    unit = {"phase_margin": "°", "delay_margin": f" {time_unit}"}.get(key, "")
    bad = limit is not None and (value < limit if limit > 0 else value > -limit)
    return Cell(f"{number(value, 3)}{unit}".rstrip(), bad)


def peak_rows(robustness: Mapping[str, Any], time_unit: str) -> tuple[list[str], list[tuple[str, list[Cell]]]]:
    """Names of the systems that were looked at, and the peak of each test in each of them."""
    found = robustness.get("peaks", {})
    systems = [name for name in SYSTEMS if name in found]
    rows = []
    for test, label in TESTS.items():
        if any(test in found[name] for name in systems):
            rows.append((label, [_peak(found[name], test, time_unit) for name in systems]))
    return [SYSTEMS[name] for name in systems], rows


def _peak(system: Mapping[str, Any], test: str, time_unit: str) -> Cell:
    if not system["stable"]:
        return Cell("unstable", True)
    if test not in system:
        return Cell(MISSING)
    peak = system[test]
    if peak["upper"] is None:
        return Cell("no limit: the weight integrates and the loop does not", True)
    low, high = peak["lower"], peak["upper"]
    value = number(high, 3) if high - low <= 1e-3 * high else f"{number(low, 3)} to {number(high, 3)}"
    return Cell(f"{value} {place(peak['frequency'], time_unit)}", high >= 1)


def place(frequency: float | None, time_unit: str) -> str:
    """Where a peak is."""
    if frequency is None:
        return ""
    return f"at {number(frequency, 3)} rad/{time_unit}" if frequency else "towards frequency 0"


def drawn_sentences(robustness: Mapping[str, Any]) -> list[str]:
    """What today's controller does on the plants drawn from the estimate."""
    drawn = robustness.get("drawn")
    if not drawn:
        return []
    text = f"Of {drawn['count']} plants drawn from the estimate {_share(drawn['share_stable'])} stable with it"
    if "share_performance" in drawn:
        share = drawn["share_performance"]
        verb = "meets" if share == 0 else "meet"
        text += f"; {_part(share).lower()} {verb} the performance asked for"
    said = [f"{text}."]
    for loop in drawn["loops"]:
        peak = ""
        if loop["Ms_q95"] is not None:
            peak = f" (median {number(loop['Ms_q50'], 3)}, 95 % below {number(loop['Ms_q95'], 3)})"
        said.append(f"{loop['input']}: {_part(loop['share']).lower()} with Ms below {number(drawn['Ms_limit'])}{peak}.")
    return said


def _part(share: float) -> str:
    return "All" if share == 1 else "None" if share == 0 else f"{number(100 * share, 3)} %"


def _share(share: float) -> str:
    return "all are" if share == 1 else "none is" if share == 0 else f"{number(100 * share, 3)} % are"


def pairing_rows(
    robustness: Mapping[str, Any], outputs: Sequence[str], inputs: Sequence[str]
) -> tuple[list[tuple[str, list[str]]], str]:
    """Relative gains, model and plant, by output and input; and what the Niederlinski index says."""
    found = robustness.get("pairing")
    if not found:
        return [], ""
    model, plant = found["model"], found["plant"]
    rows = [
        (
            output,
            [
                f"{number(a, 3)} → {number(b, 3)}"
                for a, b in zip(model["rga"][i][: len(inputs)], plant["rga"][i][: len(inputs)], strict=True)
            ],
        )
        for i, output in enumerate(outputs)
    ]
    both = (number(found[name]["niederlinski"], 3) for name in ("model", "plant"))
    index = "Niederlinski index {} on the model, {} on the plant".format(*both)
    if plant["niederlinski"] < 0:
        return rows, f"{index}: below 0, so that these loops are unstable together as soon as all integrate."
    return rows, f"{index}: above 0, so that it does not speak against these pairs."
