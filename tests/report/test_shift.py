"""The sheet for the shift: one page, no script, and nothing said that the result does not say."""

from __future__ import annotations

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from support.report_sample import sample
from trueplant.report.levels import MOST_CELLS
from trueplant.report.shift import render_shift
from trueplant.result import (
    Code,
    DrawnStability,
    ElementVerdict,
    LoopMargins,
    LoopRobustness,
    Margins,
    Reason,
    Result,
    Status,
)

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SOUND = LoopMargins("reflux", True, Ms=1.4)


def with_loops(result: Result, *loops: LoopMargins, worse: tuple[str, ...] = (), drawn=None) -> Result:
    return dataclasses.replace(
        result, robustness=LoopRobustness("r", Margins((SOUND,) * len(loops), loops), worse, drawn=drawn)
    )


def tuning(result: Result) -> str:
    found = re.search(r'<span class="safe">(.*?)</span>', render_shift(result))
    assert found
    return found[1]


def test_sheet_has_headline_and_every_element_and_no_script():
    result = sample()
    page = render_shift(result)
    assert "<script" not in page
    assert result.headline.replace("->", "→") in page
    assert page.count("<td") == len(result.elements)
    assert page.count('class="changed"') == sum(e.verdict == ElementVerdict.CHANGED for e in result.elements) > 0
    assert render_shift(sample()) == page


def test_tuning_is_called_safe_only_where_it_is():
    result = sample()
    known = tuple(dataclasses.replace(e, verdict=ElementVerdict.UNCHANGED) for e in result.elements)
    result = dataclasses.replace(result, elements=known, robustness=None)
    assert tuning(result).startswith("Not known")
    assert tuning(with_loops(result, SOUND)).startswith("Safe, as far as")
    assert tuning(with_loops(result, SOUND, LoopMargins("steam", False))).startswith("NOT SAFE")
    assert tuning(with_loops(result, SOUND, worse=("reflux",))).startswith("CLOSE TO ITS LIMIT: reflux")
    assert tuning(with_loops(result, SOUND, drawn=DrawnStability(200, 0, 0.99, 2.0, ()))).startswith("NOT SURE")
    open_ = dataclasses.replace(known[0], verdict=ElementVerdict.NOT_IDENTIFIABLE)
    assert "leave open" in tuning(with_loops(dataclasses.replace(result, elements=(open_, *known[1:])), SOUND))


def test_refusal_says_why():
    why = Reason(Code.NO_EXCITATION, "the set-points never move")
    page = render_shift(dataclasses.replace(sample(), status=Status.REFUSED, reasons=(why,), elements=()))
    assert "The set-points never move." in page
    assert "still describes" not in page


def test_refusal_names_its_places_and_the_structure_that_might_end_it():
    reasons = (
        Reason(Code.NOT_IDENTIFIABLE, "no parameter can be told"),
        Reason(Code.NOT_IDENTIFIABLE, "it depends on the noise model", "gain of u_1 -> y"),
    )
    richer = Reason(Code.UNDERMODELLED, "ask for a richer structure", "u_1 -> y")
    refused = dataclasses.replace(sample(), status=Status.REFUSED, reasons=reasons, notes=(richer,), elements=())
    page = render_shift(refused)
    assert "It depends on the noise model (gain of u 1 → y)." in page
    assert "Ask for a richer structure (u 1 → y)." in page
    assert "No parameter can be told" not in page


def test_what_is_open_is_not_called_nothing_to_do():
    result = sample()
    open_ = dataclasses.replace(result.elements[0], verdict=ElementVerdict.NOT_IDENTIFIABLE, reason="OP stood still")
    known = tuple(dataclasses.replace(e, verdict=ElementVerdict.UNCHANGED) for e in result.elements[1:])
    bare = dataclasses.replace(result, elements=(open_, *known), more_data=(), notes=(), controllers=())
    page = render_shift(bare)
    assert "OP stood still." in page
    assert "still describes" not in page
    kept = dataclasses.replace(open_, verdict=ElementVerdict.UNCHANGED)
    assert "still describes" in render_shift(dataclasses.replace(bare, elements=(kept, *known)))


def test_large_matrices_are_listed():
    result = sample()
    many = tuple(dataclasses.replace(result.elements[0], input=f"u{k}") for k in range(MOST_CELLS + 1))
    page = render_shift(dataclasses.replace(result, elements=many))
    assert "<table" not in page
    assert "more in report.html" in page


def test_names_cannot_break_the_page():
    result = sample(outputs=("<script>alert(1)</script>", "b"))
    assert "<script" not in render_shift(result)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium to print with: name one in TRUEPLANT_CHROMIUM")
def test_print_is_one_page(tmp_path: Path):
    names = [f"controlled_variable_{k}" for k in range(5)]
    result = sample(outputs=names, inputs=[f"manipulated_variable_{k}" for k in range(8)])
    notes = tuple(Reason(Code.CAUSE_PLANT, "the plant itself has changed " * 8, "a; b") for _ in range(20))
    for one in (sample(), dataclasses.replace(result, notes=notes)):
        (tmp_path / "shift.html").write_text(render_shift(one), encoding="utf-8")
        command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer"]
        place = (tmp_path / "shift.html").as_uri()
        subprocess.run([*command, f"--print-to-pdf={tmp_path / 'a.pdf'}", place], check=True, capture_output=True)
        assert len(re.findall(rb"/Type\s*/Page[^s]", (tmp_path / "a.pdf").read_bytes())) == 1
