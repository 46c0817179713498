"""An analysis as a notebook shows and uses it: the result, its tables as frames, its figures, its files."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex, overload

from trueplant.errors import UsageError
from trueplant.lti import UncertainPlant
from trueplant.output import PLANT, claim_results, prepare_output, read_results, write_files, write_results
from trueplant.project import Project
from trueplant.result import Element, LoopRetuning, Reason, Result, Status
from trueplant.result.summary import html_summary, text_summary

if TYPE_CHECKING:
    import plotly.graph_objects as go
    import polars as pl


class Elements(tuple[Element, ...]):
    """The elements of a result, by their place or by (output, input); a loop's name stands for its OP too."""

    @overload
    def __getitem__(self, place: SupportsIndex) -> Element: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[Element, ...]: ...
    @overload
    def __getitem__(self, place: tuple[str, str]) -> Element: ...
    def __getitem__(self, place: Any) -> Any:
        if not isinstance(place, tuple):
            return super().__getitem__(place)
        output, source = place
        for element in self:
            if element.output == output and element.input in (source, f"{source} OP"):
                return element
        known = ", ".join(f"({e.output!r}, {e.input!r})" for e in self)
        raise KeyError(f"no element {place}: there are {known}")


@dataclass(frozen=True, eq=False)
class Analysis:
    """What `run` returns and `load` reads: everything in the result, and what can be done with it."""

    result: Result
    project: Project | None = None
    """None where the result was read from a folder that has no plant.toml."""

    # -- what was found -------------------------------------------------------------------------------------------

    @property
    def status(self) -> Status:
        """Refused where nothing is answered."""
        return self.result.status

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        return self.result.headline

    @property
    def shift(self) -> str:
        """The verdict in a sentence for the shift."""
        return self.result.shift

    @property
    def action(self) -> str:
        """ "none", "retune", "check valve" or "get data"."""
        return str(self.result.action)

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why nothing, or not everything, could be answered."""
        return self.result.reasons

    @property
    def notes(self) -> tuple[Reason, ...]:
        """What to know although there is an answer."""
        return self.result.notes

    @property
    def mismatch(self) -> bool:
        """Has any element changed?"""
        return self.result.mismatch

    @property
    def elements(self) -> Elements:
        """Verdicts and parameters: ``analysis.elements["TIC101", "TIC102"]``, output first."""
        return Elements(self.result.elements)

    @property
    def plant(self) -> UncertainPlant | None:
        """The plant (n_y, n_u + n_d) as estimated, with what is uncertain about it; None where nothing is answered."""
        return self.result.plant

    @property
    def controllers(self) -> tuple[LoopRetuning, ...]:
        """Today's settings and the proposals, loop by loop, where the project asks for tuning."""
        return self.result.controllers

    @property
    def parameters(self) -> pl.DataFrame:
        """One row a parameter: the model's value, the plant's with its interval, and whether it changed."""
        import polars as pl

        rows = [
            {
                "output": e.output,
                "input": e.input,
                "verdict": str(e.verdict),
                "parameter": p.name,
                "unit": p.unit,
                "model": p.model,
                "plant": p.plant,
                "std_error": p.std_error,
                "low": None if p.ci is None else p.ci[0],
                "high": None if p.ci is None else p.ci[1],
                "change_percent": p.change_percent,
                "p_adjusted": p.p_adjusted,
                "changed": p.changed,
                "reason": p.reason,
            }
            for e in self.result.elements
            for p in e.parameters
        ]
        numbers = ("model", "plant", "std_error", "low", "high", "change_percent", "p_adjusted")
        texts = ("output", "input", "verdict", "parameter", "unit")
        schema = dict.fromkeys(texts, pl.String) | dict.fromkeys(numbers, pl.Float64)
        return pl.DataFrame(rows, schema=schema | {"changed": pl.Boolean, "reason": pl.String})

    @property
    def settings(self) -> pl.DataFrame:
        """One row a key of each loop's recommended settings, beside today's; empty where none are recommended."""
        import polars as pl

        rows = []
        for loop in self.result.controllers:
            if loop.chosen is None or loop.chosen.settings is None:
                continue
            now = {} if loop.current.settings is None else loop.current.settings.values
            for key, value in loop.chosen.settings.values.items():
                if not isinstance(value, str):
                    rows.append((loop.input, loop.output, loop.chosen.method, key, now.get(key), value))
        texts = ("input", "output", "method", "key")
        schema = dict.fromkeys(texts, pl.String) | {"now": pl.Float64, "new": pl.Float64}
        return pl.DataFrame(rows, schema=schema, orient="row")

    def to_dict(self) -> dict[str, Any]:
        """result.json as plain Python."""
        return self.result.to_dict()

    # -- figures --------------------------------------------------------------------------------------------------

    def plot_steps(self) -> go.Figure:
        """Unit step responses of model and plant with their band, a panel an element."""
        from trueplant.report import matrices

        return matrices.steps(self._curves(answered=True))

    def plot_bode(self) -> go.Figure:
        """Magnitude and phase of model and plant with their bands, and the estimate without a model as points."""
        from trueplant.report import matrices

        return matrices.bodes(self._curves(answered=True), self.result.provenance.settings.confidence)

    def plot_trends(self, experiment: int = 0) -> go.Figure:
        """The record with what model and plant make of OP."""
        from trueplant.report import matrices

        return matrices.trends(self._curves(), experiment)

    def plot_retuning(self) -> go.Figure:
        """PV and OP after a step of the set-point and of the load, before and after retuning, a column a loop.

        Raises UsageError where nothing was retuned.
        """
        from trueplant.report import matrices

        curves = self._curves()
        if not curves.retuning:
            raise UsageError("nothing was retuned: add a [tuning] table (tuning={}) and the controllers")
        return matrices.retuning(curves)

    def _curves(self, answered: bool = False) -> Any:
        if self.result.curves is None:
            raise UsageError("there is nothing to draw: curves.json is not there")
        if answered and not self.result.curves.w.size:
            raise UsageError("there is nothing to draw but trends: the analysis was refused")
        return self.result.curves

    # -- files ----------------------------------------------------------------------------------------------------

    def report(self, path: str | PathLike[str] | None = None) -> str:
        """The report as HTML text; written to `path` too, where one is given."""
        from trueplant.report import render

        text = render(self.result)
        if path is not None:
            write_files(Path(path).parent, {Path(path).name: text})
        return text

    def save(self, folder: str | PathLike[str], *, force: bool = False) -> dict[str, Path]:
        """Write result.json, curves.json, report.html and plant.toml; `load` reads them. Returns the paths by name.

        Raises OutputError where the folder cannot be written to, or a file of one of these names there is none that
        was saved before; with `force` such files are replaced, but never what the project reads.
        """
        if self.project is None:
            raise UsageError("a result that was loaded without its project cannot be saved again: copy its folder")
        claim_results(prepare_output(folder), self.project, force)
        return write_results(self.result, self.project, folder, self.report())

    def __repr__(self) -> str:
        return f"Analysis({self.status}: {self.headline})"

    def __str__(self) -> str:
        return text_summary(self.result)

    def _repr_html_(self) -> str:
        return html_summary(self.result)


def load(folder: str | PathLike[str]) -> Analysis:
    """A saved analysis, without its data: the folder that `Analysis.save` or ``trueplant run`` has written.

    Raises UsageError where there is none, or its files are not of one analysis.
    """
    result = read_results(folder)
    plant = Path(folder) / PLANT
    return Analysis(result, Project.load(plant) if plant.is_file() else None)
