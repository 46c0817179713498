"""What the report says of today's loops, as text: margins, robust performance, pairing, plants drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from trueplant.report.numbers import MISSING, finite, number
from trueplant.result import (
    DrawnStability,
    LoopMargins,
    Margins,
    Pairing,
    Peak,
    Result,
    SystemPeaks,
    WorstElement,
)

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


@dataclass(frozen=True)
class Today:
    """The section on today's loops; empty parts are left out of it."""

    controller_of: str
    margins: tuple[Loop, ...]
    systems: tuple[str, ...]
    peaks: tuple[tuple[str, tuple[Cell, ...]], ...]
    """(test, cells) in the order of the systems."""
    worst: tuple[WorstElement, ...]
    """The plant that makes the peak of robust performance."""
    drawn: tuple[str, ...]
    inputs: tuple[str, ...]
    pairs: tuple[tuple[str, tuple[str, ...]], ...]
    """(output, relative gains) in the order of the inputs."""
    pairing: str
    """What the Niederlinski index says of them."""


def today(result: Result) -> Today | None:
    """Today's loops as tables; None where nothing is known of them."""
    found, curves = result.robustness, result.curves
    if found is None:
        return None
    unit = curves.time_unit if curves else result.provenance.time_unit
    outputs, inputs = (curves.outputs, curves.inputs) if curves else ((), ())
    systems, peaks = peak_rows(found.peaks, unit)
    pairs, index = pairing_rows(found.pairing, outputs, inputs)
    return Today(
        controller_of=found.controller_of,
        margins=margin_loops(found.margins, unit),
        systems=systems,
        peaks=peaks,
        worst=found.peaks["plant"].worst_plant if "plant" in found.peaks else (),
        drawn=drawn_sentences(found.drawn),
        inputs=tuple(inputs),
        pairs=pairs,
        pairing=index,
    )


Line = tuple[str, str, float | None, str, Callable[[LoopMargins], float | None]]
"""A row of the margins: label, what is usual, that as a number (negative for at most), unit, and where it stands."""


def _lines(time_unit: str) -> tuple[Line, ...]:
    """What is usual is that of Skogestad and Postlethwaite 2005, section 2.4."""
    return (
        ("Gain margin", "above 2", 2.0, "", lambda loop: loop.gain_margin),
        ("Phase margin", "above 30°", 30.0, "°", lambda loop: loop.phase_margin),
        ("Delay margin", "", None, f" {time_unit}", lambda loop: loop.delay_margin),
        ("Ms, peak of the sensitivity", "below 2", -2.0, "", lambda loop: loop.Ms),
        ("Mt, peak of T", "", None, "", lambda loop: loop.Mt),
    )


def margin_loops(margins: Margins, time_unit: str) -> tuple[Loop, ...]:
    """The margins table, a loop at a time."""
    loops = []
    for on_model, on_plant in zip(margins.model, margins.plant, strict=True):
        rows = tuple(
            (label, usual, _margin(on_model, read, limit, unit), _margin(on_plant, read, limit, unit))
            for label, usual, limit, unit, read in _lines(time_unit)
        )
        message = "; ".join(
            f"{name}: {one.message}" for name, one in (("model", on_model), ("plant", on_plant)) if not one.stable
        )
        loops.append(Loop(on_model.input, rows, message))
    return tuple(loops)


def _margin(loop: LoopMargins, read: Callable[[LoopMargins], float | None], limit: float | None, unit: str) -> Cell:
    if not loop.stable:
        return Cell("unstable", True)
    value = finite(read(loop))
    if value is None:
        return Cell("no limit")
    return Cell(f"{number(value, 3)}{unit}".rstrip(), is_beyond(value, limit))


def is_beyond(value: float, limit: float | None) -> bool:
    """Is a number on the wrong side of a limit from below, or of one from above, which is given as negative?"""
    return limit is not None and (value < limit if limit > 0 else value > -limit)


def peak_rows(
    peaks: Mapping[str, SystemPeaks], time_unit: str
) -> tuple[tuple[str, ...], tuple[tuple[str, tuple[Cell, ...]], ...]]:
    """Names of the systems that were looked at, and the peak of each test in each of them."""
    systems = [peaks[name] for name in SYSTEMS if name in peaks]
    rows = tuple(
        (label, tuple(_peak(system, test, time_unit) for system in systems))
        for test, label in TESTS.items()
        if any(_tested(system, test) for system in systems)
    )
    return tuple(label for name, label in SYSTEMS.items() if name in peaks), rows


def _tested(system: SystemPeaks, test: str) -> Peak | None:
    return {"NP": system.NP, "RS": system.RS, "RP": system.RP}[test]


def _peak(system: SystemPeaks, test: str, time_unit: str) -> Cell:
    if not system.stable:
        return Cell("unstable", True)
    peak = _tested(system, test)
    if peak is None:
        return Cell(MISSING)
    low, high = peak.lower, finite(peak.upper)
    if high is None:
        return Cell("no limit: the weight integrates and the loop does not", True)
    value = number(high, 3) if high - low <= 1e-3 * high else f"{number(low, 3)} to {number(high, 3)}"
    return Cell(f"{value} {place(finite(peak.frequency), time_unit)}", high >= 1)


def place(frequency: float | None, time_unit: str) -> str:
    """Where a peak is."""
    if frequency is None:
        return ""
    return f"at {number(frequency, 3)} rad/{time_unit}" if frequency else "towards frequency 0"


def drawn_sentences(drawn: DrawnStability | None) -> tuple[str, ...]:
    """What today's controller does on the plants drawn from the estimate."""
    if drawn is None:
        return ()
    text = f"Of {drawn.count} plants drawn from the estimate {_share(drawn.share_stable)} stable with it"
    if drawn.share_performance is not None:
        verb = "meets" if drawn.share_performance == 0 else "meet"
        text += f"; {_part(drawn.share_performance).lower()} {verb} the performance asked for"
    said = [f"{text}."]
    for loop in drawn.loops:
        peak, high = "", finite(loop.Ms_q95)
        if high is not None:
            peak = f" (median {number(finite(loop.Ms_q50), 3)}, 95 % below {number(high, 3)})"
        said.append(f"{loop.input}: {_part(loop.share).lower()} with Ms below {number(drawn.Ms_limit)}{peak}.")
    return tuple(said)


def _part(share: float) -> str:
    return "All" if share == 1 else "None" if share == 0 else f"{number(100 * share, 3)} %"


def _share(share: float) -> str:
    return "all are" if share == 1 else "none is" if share == 0 else f"{number(100 * share, 3)} % are"


def pairing_rows(
    pairing: Mapping[str, Pairing], outputs: Sequence[str], inputs: Sequence[str]
) -> tuple[tuple[tuple[str, tuple[str, ...]], ...], str]:
    """Relative gains, model and plant, by output and input; and what the Niederlinski index says."""
    if not pairing:
        return (), ""
    model, plant = pairing["model"], pairing["plant"]
    rows = tuple(
        (
            output,
            tuple(
                f"{number(finite(a), 3)} → {number(finite(b), 3)}"
                for a, b in zip(model.rga[i][: len(inputs)], plant.rga[i][: len(inputs)], strict=True)
            ),
        )
        for i, output in enumerate(outputs)
    )
    both = number(model.niederlinski, 3), number(plant.niederlinski, 3)
    index = "Niederlinski index {} on the model, {} on the plant".format(*both)
    if plant.niederlinski < 0:
        return rows, f"{index}: below 0, so that these loops are unstable together as soon as all integrate."
    return rows, f"{index}: above 0, so that it does not speak against these pairs."
