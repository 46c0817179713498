"""Which elements of a result become the model, and what is said of them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace as Stub
from typing import Any

from trueplant import Project
from trueplant.lti import TransferMatrix
from trueplant.notebook.accepting import told_accepted
from trueplant.project.accepted import accepted
from trueplant.result import Code, ElementVerdict, Reason

TEXT = """time_unit = "s"
[data]
files = ["a.csv"]
[[output]]
name = "y"
pv = "pv"
[[input]]
name = "u1"
op = "op1"
[[input]]
name = "u2"
op = "op2"
[[input]]
name = "u3"
op = "op3"
[[model]]
output = "y"
input = "u1"
tf = "1/(10 s + 1)"  # from commissioning
[[model]]
output = "y"
input = "u2"
tf = "2/(10 s + 1)"  # from commissioning
[[model]]
output = "y"
input = "u3"
tf = "3/(10 s + 1)"
"""


def result(*notes: Reason) -> Any:
    """Of three elements, of which one has changed, and another estimate of each."""
    verdicts = (ElementVerdict.CHANGED, ElementVerdict.UNCHANGED, ElementVerdict.NOT_IDENTIFIABLE)
    names = ("u1", "u2", "u3")
    return Stub(
        elements=[
            Stub(output="y", input=name, verdict=verdict, structure="fopdt", rejected_structure=None)
            for name, verdict in zip(names, verdicts, strict=True)
        ],
        plant=Stub(nominal=TransferMatrix.of([["1.5/(10 s + 1)", "2.1/(12 s + 1)", "9/(10 s + 1)"]])),
        uncertainty=Stub(outputs=("y",), inputs=names),
        notes=notes,
    )


def test_only_what_has_changed_becomes_the_model() -> None:
    found = accepted(Project.from_toml(TEXT, Path()), result(), "today")
    new = [line for line in found.text.splitlines() if line not in TEXT.splitlines()]
    # the comment was on the old formula, and stays with it
    assert new == ['# until today: tf = "1/(10 s + 1)"  # from commissioning', 'tf = "1.5/(10 s + 1)"']
    assert 'tf = "2/(10 s + 1)"  # from commissioning' in found.text
    said = [*told_accepted(found, "p.toml", "p.toml.bak")]
    assert "for 1 element (u1 -> y)" in said[0]
    assert said[1] == "kept as they are: u2 -> y (unchanged), u3 -> y (not identifiable)"
    assert len(said) == 3


def test_a_plant_that_changed_on_the_way_is_not_accepted_without_a_word() -> None:
    moved = Reason(Code.CAUSE_MOVED_MEANWHILE, "the plant was not the same throughout the record", "y, a.csv")
    found = accepted(Project.from_toml(TEXT, Path()), result(moved), "today")
    assert any("y, a.csv: the plant was not the same" in line for line in told_accepted(found, "p.toml", "p.toml.bak"))
