"""What elements are known to as a whole, and what their standard errors are made of, in the report."""

from __future__ import annotations

import dataclasses
import re

import pytest

from support.pages import Page, without_plotly
from support.report_sample import sample
from trueplant.report import render
from trueplant.report.known import MEANING, budget_table, known_table
from trueplant.result import Derived, ParameterBudget, Result, Source, VariancePart

SHARES = {Source.NOISE: 0.624, Source.SLOW_NOISE: 0.004, Source.MINIMA: 0.372}


@pytest.fixture(scope="module")
def result() -> Result:
    """The first element with a budget of its gain, and two quantities of which one is not told."""
    plain = sample()
    parts = tuple(VariancePart(source, share) for source, share in SHARES.items())
    derived = (
        Derived("net_gain", "degC/%", "rest", 0.0, 1.8, 2.3412, 0.012, (2.3177, 2.3647)),
        Derived("phase", "deg", "crossover", 0.21345, -60.0, None, None, None, "nothing moves <it>"),
    )
    first = dataclasses.replace(plain.elements[0], derived=derived, budget=(ParameterBudget("gain", parts),))
    return dataclasses.replace(plain, elements=(first, *plain.elements[1:]))


def test_every_source_has_a_meaning():
    assert set(MEANING) == set(Source)


def test_shares_below_half_a_per_cent_have_no_column(result):
    table = budget_table(result.elements)
    assert [name for name, _ in table.sources] == ["noise", "other plants that fit as well"]
    ((name, (row,)),) = table.elements
    gain = result.elements[0].parameters[0]
    assert name == f"{result.elements[0].input} → {result.elements[0].output}"
    assert (row.name, row.unit, row.percents) == ("gain", gain.unit, (62, 37))
    assert float(row.error) == pytest.approx(gain.std_error, rel=0.05)


def test_quantities_have_the_digits_that_they_deserve(result):
    ((_, (net, phase)),) = known_table(result.elements)
    assert (net.name, net.where, net.plant, net.interval) == ("net gain", "at rest", "2.341", "2.318 to 2.365")
    assert (phase.where, phase.plant) == ("at 0.213 (crossover)", "–")


def test_a_reason_that_the_element_gives_is_not_repeated(result):
    first = dataclasses.replace(result.elements[0], reason="phase: nothing moves <it>")
    ((_, (_, phase)),) = known_table((first, *result.elements[1:]))
    assert phase.reason == "as above"


def test_the_page_has_both(result):
    page = Page(without_plotly(render(result)))
    rows = [text for _, text in page.all("tr")]
    assert "net gain at rest degC/% 1.800 2.341 2.318 to 2.365" in rows
    assert any("not answered: nothing moves <it>" in row for row in rows)
    assert any(re.fullmatch(r"gain \S+ degC/% 62 37", row) for row in rows)
    assert any(text.startswith("noise: chance") for _, text in page.all("li"))


def test_without_them_nothing_is_said():
    page = render(sample())
    assert "Known as a whole" not in page and "What the standard errors are made of" not in page
