"""A PV that a historian mostly filled in: its lines are no change of the plant, and a change shows through them."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from trueplant.connect import ensure
from trueplant.fleet.demo import END
from trueplant.fleet.demo.simulate import kept
from trueplant.fleet.demo.site import events_of
from trueplant.fleet.demo.templates import template_of
from trueplant.fleet.demo.truth import KINDS, Fault, Truth
from trueplant.project import Project
from trueplant.project.exclusions import all_but_usable
from trueplant.record import Segment
from trueplant.result import ElementVerdict, Result
from trueplant.result.budget import Source
from trueplant.study.pipeline import analyse
from trueplant.study.plant.drawn import held_between
from trueplant.tracking.find import find

START = END - timedelta(days=3)
FLOW, LEVEL = KINDS[0], KINDS[2]


def analysed(folder: Path, truth: Truth, band: float = 2.0) -> Result:
    """A loop of the demo site, PV stored where it left a band (standard deviations of the noise), as audits do it."""
    kind, events = truth.kind, events_of(truth, START)
    pv = pl.col("tag").str.ends_with(f"{truth.name}.PV")
    own = events.filter(pv)
    keep = kept(own["value"].to_numpy(), band * kind.noise * kind.move[0])
    (folder / "lake" / "all").mkdir(parents=True)
    pl.concat([events.filter(~pv), own.filter(pl.Series(keep))]).write_parquet(
        folder / "lake" / "all" / "events.parquet"
    )
    window = f"[data]\nfrom = {START.isoformat()}\nto = {END.isoformat()}\n"
    text = template_of(kind).replace("{{name}}", truth.name).replace("[data]\n", window)
    (folder / "loop.toml").write_text(text, encoding="utf-8")
    project = Project.load(folder / "loop.toml")
    ensure(project)
    return analyse(project.with_exclusions(all_but_usable(project, find(project))))


@pytest.mark.parametrize(("kind", "seed"), [(FLOW, 70002), (FLOW, 70003), (LEVEL, 70202)])
def test_what_a_historian_drew_is_no_change(tmp_path: Path, kind, seed: int) -> None:
    """Each of these was called changed while nothing counted what PV did between the stored samples."""
    (element,) = analysed(tmp_path, Truth(f"{kind.prefix}1", kind, Fault.NONE, seed)).elements
    assert element.verdict != ElementVerdict.CHANGED and element.rejected_structure is None
    sources = {part.source for budget in element.budget for part in budget.parts if part.share > 0}
    assert Source.HISTORIAN in sources


def test_a_change_shows_through_it(tmp_path: Path) -> None:
    (element,) = analysed(tmp_path, Truth("FC1", FLOW, Fault.STEP, 70002)).elements
    gain = element.parameters[0]
    assert element.verdict == ElementVerdict.CHANGED and gain.changed
    assert gain.ci is not None and gain.ci[0] <= 1.4 * 1.5 <= gain.ci[1]


def test_nothing_is_added_where_every_sample_was_stored(tmp_path: Path) -> None:
    (element,) = analysed(tmp_path, Truth("FC1", FLOW, Fault.NONE, 70002), band=0.0).elements
    assert Source.HISTORIAN not in {part.source for budget in element.budget for part in budget.parts}


def test_held_from_one_stored_sample_to_the_next() -> None:
    stored = np.array([0, 4, 6, 11, 13, 20, 30, 33, 40])
    values = np.array([1.0, 2.0, 1.5, 3.0, 2.0, 4.0, 0.0, 2.5, 1.0])
    t = np.arange(41.0)
    line = np.interp(t, stored, values)
    line[36] = np.nan
    none, one = np.zeros((t.size, 0)), np.zeros((t.size, 1))
    whole = Segment(0, 1.0, t, one, one, line[:, None], none, np.ones((t.size, 1), dtype=bool), ("zoh",))
    (segment,) = held_between([whole], [0])
    held = values[np.searchsorted(stored, t, side="right") - 1]
    known = t < 35
    np.testing.assert_allclose(segment.y[known, 0], held[known])
    assert np.isnan(segment.y[36, 0])
    (same,) = held_between([whole], [])
    np.testing.assert_array_equal(same.y, whole.y)
