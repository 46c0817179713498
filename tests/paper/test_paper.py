"""The paper computed: each value against the digits that were worked out by hand or by another program."""

from __future__ import annotations

import contextlib
import html
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from trueplant.cli import main
from trueplant.paper import equations, mill_section, splitter_section
from trueplant.paper.entry import Entry, last_digit, rounded, rounds_to
from trueplant.paper.page import noted
from trueplant.report.style import DARK, LIGHT


@pytest.fixture(scope="module")
def mill():
    return mill_section()


@pytest.fixture(scope="module")
def entries(mill):
    return {e.id: e for e in [*equations(), *mill.entries, *splitter_section()]}


def test_numbers_are_compared_at_their_last_printed_digit():
    assert last_digit("-0.0809") == (-0.0809, pytest.approx(5e-5))
    assert last_digit("16.7 %") == (16.7, pytest.approx(0.05))
    assert rounds_to("0.0253", 0.02525)  # a half may go either way
    assert not rounds_to("0.0253", 0.02524)
    assert rounds_to("20 %", 19.6) and not rounds_to("20 %", 20.6)
    assert rounded("a", "b", "4.0 %", 4.1).agrees is False


def test_all_twenty_equations_hold(entries):
    """Signals from the loop's two equations; a wrong sign or order of factors would leave a residual of order 1."""
    for k in range(1, 21):
        assert entries[f"eq{k}"].computed < 1e-10, k
        assert entries[f"eq{k}"].agrees is True
    assert entries["eqA7"].agrees and entries["appendixA.rank"].computed is True


def test_mismatch_37_element_by_element(entries):
    """By hand: common denominators of (22)-(25) and (33)-(36)."""
    expected = {
        "eq37.delta11": ([0.116 / 5], [1, 0.9, 0.2], 0.68, True),
        "eq37.delta12": ([4 * (0.9938 - 1.1014) / 12], [1, 8 / 12, 1 / 12], 0.67, False),
        "eq37.delta12.eq37": ([4 * (0.9938 - 1.0137) / 12], [1, 8 / 12, 1 / 12], 0.67, True),
        "eq37.delta21": ([-1.32 / 39.6, 0], [1, 12.6 / 39.6, 1 / 39.6], 0.6, False),
        "eq37.delta22": ([-0.283 / 3.5], [1, 1 / 3.5], 0.13, True),
    }
    for id, (num, den, dead, agrees) in expected.items():
        found = entries[id].computed
        np.testing.assert_allclose(found["numerator"], num, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found["denominator"], den, rtol=1e-9)
        assert found["dead_time"] == dead
        assert entries[id].agrees is agrees
    assert "lacks a factor s" in entries["eq37.delta21"].note
    assert entries["eq34.factor"].computed == pytest.approx(1.0137, abs=2e-4)
    assert entries["eq37.reference"].computed == "(33) - (36)"


def test_18_recovers_the_mismatch_from_simulated_records(entries):
    for variant in ("printed", "eq37"):
        assert 0 < entries[f"eq37.data.{variant}"].computed < 1e-3


def test_robust_performance_of_figure_4(entries):
    assert entries["fig4.nominal.peak"].computed == pytest.approx(0.9728, abs=5e-5)
    assert entries["fig4.nominal.frequency"].computed == pytest.approx(0.889, abs=5e-4)
    assert entries["fig4.nominal.rs"].computed == pytest.approx(0.155, abs=5e-4)
    assert entries["fig4.nominal.np"].computed == pytest.approx(0.841, abs=5e-4)
    assert entries["fig4.full.peak"].computed == pytest.approx(1.0207, abs=5e-5)
    assert entries["fig4.printed.sup"].computed == pytest.approx(4.964, abs=5e-4)
    assert entries["fig4.eq37.sup"].computed == pytest.approx(1.426, abs=5e-4)
    assert entries["fig4.printed.above"].computed < 0.09


def test_weights_are_31_and_32(entries):
    assert all(entries[id].agrees for id in ("eq31", "eq32"))
    for part, values in entries["eq31"].computed.items():
        assert entries["eq27"].computed[part] == pytest.approx(values)
    assert entries["eq31"].computed == {"numerator": pytest.approx([2.1, 1]), "denominator": pytest.approx([1, 10])}


def test_step_responses_of_the_mill(entries, mill):
    """With 1.1014 the loop is far from settled after the 60 min of the figure."""
    assert entries["fig5.printed.end"].computed == pytest.approx(0.92, abs=0.005)
    assert entries["fig5.nominal.end"].computed > 0.999
    for k in range(2):
        step = entries[f"table1.step{k + 1}"].computed
        runs = [pair[k] for pair in (mill.steps.nominal, *mill.steps.perturbed.values())]
        room = np.min([np.min([5, 5] / (np.abs(run.u).max(axis=0) * step)) for run in runs])
        assert room == pytest.approx(1) or room > 1


def test_the_splitters_sign_margins_and_error_model(entries):
    assert entries["splitter.loop1.stable_as_printed"].computed is False
    assert "+0.067" in entries["splitter.loop1.stable_as_printed"].note
    assert entries["splitter.loop1.pole"].computed == pytest.approx(0.0674, abs=1e-4)
    assert entries["splitter.stable_direct"].computed is True
    for key, value, half in (("gm", 4.47, 0.005), ("pm", 60.6, 0.05), ("ms", 1.398, 5e-4)):
        assert entries[f"splitter.loop2.{key}"].computed == pytest.approx(value, abs=half)
    model = entries["splitter.error_model.loop1"].computed
    np.testing.assert_allclose(model["zeros"], [-1.696, -0.134, -0.05], atol=6e-4)
    np.testing.assert_allclose(model["poles_real"], [-20.58, -0.0833, -0.0768, -0.0768], rtol=1e-3)
    np.testing.assert_allclose(np.abs(model["poles_imaginary"]), [0, 0, 0.0339, 0.0339], atol=5e-5)
    assert model["gain"] == pytest.approx(0.2)
    assert entries["eq43.loop1"].computed < 1e-3


def test_table_4_and_what_20_percent_refers_to(entries):
    percent = {"gain11": 100 * 0.097 / 0.58, "gain12": 16.25, "gain22": 100 * 0.01 / 3.8}
    percent |= {"tau11": 4.0, "tau12": 5.8, "tau22": 100 * 0.16 / 2.8, "delay12": 0.0, "delay22": 0.0}
    for name, value in percent.items():
        assert entries[f"table4.{name}"].computed == pytest.approx(value, abs=1e-9)
        assert entries[f"table4.{name}"].agrees is True
    for name, value in (("gain.of_model", 25), ("gain.of_plant", 20), ("tau.of_model", 100 / 6), ("tau.of_plant", 20)):
        assert entries[f"splitter.change.{name}"].computed == pytest.approx(value)
        assert entries[f"splitter.change.{name}"].agrees is (value == 20)


# -- the command ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper") / "deep"
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        status = main(["paper", "--out", str(folder), "--seeds", "2", "--json"])
    return status, folder, said.getvalue()


@pytest.mark.slow
def test_the_command_writes_both_files(written, entries):
    status, folder, said = written
    assert status == 0
    assert said == (folder / "paper.json").read_text("utf-8")
    assert sorted(p.name for p in folder.iterdir()) == ["paper.html", "paper.json"]
    rows = json.loads((folder / "paper.json").read_text("utf-8"))
    assert all(list(row) == ["id", "what", "printed", "computed", "agrees", "note"] for row in rows)
    by_id = {row["id"]: row for row in rows}
    assert len(by_id) == len(rows)
    assert set(entries) <= set(by_id)
    assert {f"table5.{name}{e}" for name in ("model", "fit", "true") for e in ("11", "12", "22")} <= set(by_id)
    for row in rows:
        assert row["agrees"] is None or row["printed"] is not None
        assert row["agrees"] in (True, False, None)
        assert row["note"]
    assert {id for id, row in by_id.items() if row["agrees"] is False} == {
        "eq37.delta12",
        "eq37.delta21",
        "eq34.factor",
        "eq37.reference",
        "splitter.loop1.stable_as_printed",
        "splitter.change.gain.of_model",
        "splitter.change.tau.of_model",
    }


@pytest.mark.slow
def test_the_page_shows_every_value_and_needs_no_network(written):
    page = (written[1] / "paper.html").read_text("utf-8")
    text = page[: page.index('<script type="application/gzip"')]
    rows = json.loads((written[1] / "paper.json").read_text("utf-8"))
    assert all(f">{row['id']}</code>" in text for row in rows)
    compared = [row for row in rows if row["agrees"] is not None]
    agreeing = sum(row["agrees"] for row in compared)
    assert f"{agreeing} of {len(compared)} printed values" in text
    for number in range(4, 16):
        if number != 9:  # a flow sheet
            assert f"Figure {number}:" in text, number
    assert not re.search(r"(?:src|href)=\"(?!#)", text)
    assert "default-src 'none'" in text
    assert LIGHT["paper"] in text and DARK["paper"] in text
    differing = text[text.index('id="differences"') : text.index('id="equations"')]
    assert differing.count("▲") == sum(row["agrees"] is False for row in rows)
    assert "simulated" in text


@pytest.mark.slow
def test_the_page_explains_everything_once(written):
    """Notes that many rows of a table share stand above it; a difference is explained where the differences stand."""
    page = (written[1] / "paper.html").read_text("utf-8")
    text = html.unescape(page[: page.index('<script type="application/gzip"')])
    rows = json.loads((written[1] / "paper.json").read_text("utf-8"))
    shared = "largest difference of the two sides relative to the larger"
    assert sum(shared in row["note"] for row in rows) > 10 and text.count(shared) == 1
    for row in rows:
        if row["agrees"] is False:
            assert text.count(row["note"]) == 1, row["id"]
    for chapter in text.split('<section id="')[2:]:
        keys = re.findall(r'class="key (\w+)"', chapter)
        assert len(keys) == len(set(keys))


def test_notes_lose_nothing_but_repetition():
    """Each note can be put together again from what the row and the letters say."""
    entries = [
        Entry(str(k), "", None, 1.0, None, f"the same long remark for all; tolerance {k}. Here something else")
        for k in range(3)
    ]
    entries.append(Entry("3", "", None, 1.0, None, "a note of its own; and more. Then this"))
    remarks, told = noted([*entries, replace(entries[0], id="4", agrees=False)], False)
    assert remarks == [("a", "the same long remark for all; Here something else")]
    assert [note for _, note in told] == [*(f"tolerance {k} [a]" for k in range(3)), entries[3].note, None]


def test_a_folder_that_cannot_be_written_is_refused_before_anything_is_computed(tmp_path, capsys):
    (tmp_path / "taken").write_text("")
    assert main(["paper", "--out", str(tmp_path / "taken")]) == 2
    assert "is a file" in capsys.readouterr().err
