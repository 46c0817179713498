"""Modes and statuses beside the values."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from trueplant.errors import DataError
from trueplant.record import Record, read_record
from trueplant.record.layout import Channel, Layout
from trueplant.record.modes import AUTOMATIC, MANUAL

N = 60
VALUES = {"t": np.arange(N) * 1.0, "pv": np.sin(np.arange(N)), "op": np.cos(np.arange(N)), "sp": np.arange(N) % 7.0}


def read(automatic_values: tuple[object, ...] | None = None, **columns: object) -> Record:
    outputs = (Channel("T", "pv", sp="sp", status="pv_q" if "pv_q" in columns else None),)
    mode = "mode" if "mode" in columns else None
    status = "op_q" if "op_q" in columns else None
    inputs = (Channel("Q", "op", mode=mode, status=status, automatic_values=automatic_values),)
    return read_record(pl.DataFrame(VALUES | columns), Layout(outputs, inputs, time="t", project_time_unit="s"))


def said(record: Record, kind: str) -> str:
    return "\n".join(note.message for note in record.notes if note.kind == kind)


def test_no_word_means_both():
    assert not AUTOMATIC & MANUAL


@pytest.mark.parametrize(
    "word", ["AUTO", " auto ", "Cas", "RCAS", "ROut", "PROG", "B-AUTO", "Rem Cas", "Automatik", "1", 1, 1.0, True]
)
def test_what_leaves_the_loop_closed_is_automatic(word: object):
    assert read(mode=[word] * N).automatic.all()


@pytest.mark.parametrize("word", ["MAN", "Manual", "IMAN", "LO", "TRK", "Hand", "OOS", "0", 0, False])
def test_what_opens_the_loop_is_not(word: object):
    assert not read(mode=[word] * N).automatic.any()


def test_all_modes_are_listed_with_their_counts():
    record = read(mode=["AUTO"] * 30 + ["CAS"] * 20 + ["MAN"] * 10)
    assert said(record, "mode") == "mode: automatic AUTO (30), CAS (20); not automatic MAN (10)."
    np.testing.assert_array_equal(record.automatic[:, 0], np.arange(N) < 50)


def test_an_unknown_mode_is_named_and_not_taken_for_automatic():
    record = read(mode=["AUTO"] * 40 + ["XYZ"] * 20)
    np.testing.assert_array_equal(record.automatic[:, 0], np.arange(N) < 40)
    assert "What XYZ (20) means is not known: 20 rows counted as not automatic" in said(record, "mode")
    assert 'automatic_values = ["AUTO", "XYZ"]' in said(record, "mode")


def test_numbers_that_nobody_declared_are_unknown():
    record = read(mode=[8] * 40 + [16] * 20)
    assert not record.automatic.any()
    assert "nothing is automatic" in said(record, "mode")
    assert "Name those of them that are automatic in automatic_values." in said(record, "mode")
    declared = read((8,), mode=[8] * 40 + [16] * 20)
    np.testing.assert_array_equal(declared.automatic[:, 0], np.arange(N) < 40)


def test_declared_values_are_all_that_is_automatic():
    record = read(("CAS", 3), mode=["cas"] * 20 + ["AUTO"] * 20 + ["3"] * 20)
    np.testing.assert_array_equal(record.automatic[:, 0], np.repeat([True, False, True], 20))
    assert "automatic_values names none of them" in said(read(("RSP",), mode=["AUTO"] * N), "mode")


def test_an_empty_cell_keeps_the_mode_before():
    record = read(mode=[None] * 10 + ["MAN"] * 10 + [""] * 10 + ["AUTO"] * 30)
    np.testing.assert_array_equal(record.automatic[:, 0], np.repeat([True, False, True], [10, 20, 30]))


def test_no_number_is_no_mode():
    record = read(mode=[1.0] * 20 + [float("nan")] * 10 + [0.0] * 30)
    np.testing.assert_array_equal(record.automatic[:, 0], np.arange(N) < 30)
    assert said(record, "mode") == "mode: automatic 1 (20); not automatic 0 (30)."


def test_a_column_of_values_is_no_mode():
    with pytest.raises(DataError, match=r"'mode' holds 60 different values .* no modes; name another column"):
        read(mode=np.linspace(0, 1, N))
    with pytest.raises(DataError, match="'mode' is empty; leave it out"):
        read(mode=pl.Series([None] * N, dtype=pl.String))


@pytest.mark.parametrize(
    ("good", "bad"), [("Good", "Bad"), ("GoodNonCascade", "Uncertain"), (192, 0), (0, 4), ("OK", "I/O Timeout")]
)
def test_values_of_bad_status_are_left_out(good: object, bad: object):
    record = read(pv_q=[good] * 50 + [bad] * 10)
    np.testing.assert_array_equal(np.isnan(record.y[:, 0]), np.arange(N) >= 50)
    assert np.isfinite(record.u).all()
    assert f"pv: 10 values with a bad status ('{bad}') left out." == said(record, "bad-quality")


def test_the_status_of_op_concerns_op():
    record = read(op_q=["Good"] * 50 + ["Bad"] * 10)
    np.testing.assert_array_equal(np.isnan(record.u[:, 0]), np.arange(N) >= 50)
    assert np.isfinite(record.y).all()


def test_a_status_without_any_good_value_says_what_stands_there():
    with pytest.raises(DataError, match=r"no value of 'pv' is of good quality: column 'pv_q' says 'No Data' \(60\)"):
        read(pv_q=["No Data"] * N)
