"""The command ``convert``: a model from one form to another."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from trueplant.claims import claim
from trueplant.cli.layout import say_lines
from trueplant.errors import OutputError
from trueplant.lti.measured import Kind
from trueplant.output import write_files
from trueplant.project.conversion import Coefficients, Cost, Model, as_coefficients, as_formulas, read_model
from trueplant.project.levels import CLOSE_CONVERSION, WORST_CONVERSION
from trueplant.project.simulation import as_file, checked_format
from trueplant.result.numbers import counted

ENDINGS = {"tf": ".toml", "step": ".csv", "fir": ".csv"}


def convert(path: Path, to: str, out: Path | None, force: bool, said: Coefficients, structure: str | None) -> int:
    """Write the model in ``path`` as ``to`` ("tf", "step" or "fir"), and say what that cost."""
    place = out or Path(f"{path.stem}-{to}{ENDINGS[to]}")
    if to == "tf" and place.suffix.lower() != ".toml":
        raise OutputError(f"{place}: transfer functions are written as TOML, so the name must end in .toml")
    if to != "tf":
        checked_format(place)
    claim([place], [path], force=True)
    model = read_model(path, said)
    content, costs = _converted(model, to, place, said.sample_time, structure)
    claim([place], model.files, force, known=[hashlib.sha256(content).hexdigest()])
    write_files(place.parent, {place.name: content})
    done = f"{place}: {counted(len(costs), 'element')}"
    if to != "tf" and max(cost.error for cost in costs) > CLOSE_CONVERSION:
        done += "; more coefficients come closer to the model: say a shorter --sample-time"
    say_lines(*(_line(cost, model.time_unit) for cost in costs), done)
    return 0


def _converted(
    model: Model, to: str, place: Path, sample_time: float | None, structure: str | None
) -> tuple[bytes, Sequence[Cost]]:
    if to == "tf":
        text, costs = as_formulas(model, structure)
        return text.encode("utf-8"), costs
    kind: Kind = "fir" if to == "fir" else "step"
    frame, costs = as_coefficients(model, kind, sample_time)
    return as_file(frame, place), costs


def _line(cost: Cost, unit: str) -> str:
    said = "no difference"
    if cost.error:
        most = f"{100 * cost.error:.2g} % of the gain"
        said = f"step responses differ by at most {most}, at t = {cost.at:g} {unit}".rstrip()
    if cost.error > WORST_CONVERSION:
        said += ": too much to stand for the model"
    return f"{cost.input} -> {cost.output}: {said}{'; it integrates (ramp)' if cost.integrating else ''}"
