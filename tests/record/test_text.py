"""Text files: whatever the separator, decimal mark and encoding, the same numbers come back; or one clear error."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueplant.errors import DataError
from trueplant.record import Channel, Layout, read_record, read_table

ONE = Layout((Channel("T", "pv", sp="sp"),), (Channel("Q", "op"),), project_time_unit="s")
HEADER = "t,sp,pv,op\n"


def rows(n: int = 20, line: str = "{i},1.5,{i}.25,{j}.125") -> str:
    return "".join(line.format(i=i, j=i % 3) + "\n" for i in range(n))


@pytest.fixture
def write(tmp_path: Path):
    def write_file(content: str | bytes, name: str = "run.csv", encoding: str = "utf-8") -> Path:
        file = tmp_path / name
        file.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
        return file

    return write_file


numbers = st.floats(-1e12, 1e12, allow_nan=False)


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(st.tuples(numbers, numbers, numbers), min_size=10, max_size=25),
    separator=st.sampled_from([";", "\t", "|", ",", "  "]),
    comma=st.booleans(),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252", "utf-16-le"]),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
    preamble=st.sampled_from(["", "# Export of März 2024\n", "Werk Süd\n\n", "Site: A\nBlock: 7\n"]),
    units=st.booleans(),
)
def test_what_was_written_comes_back(
    tmp_path_factory, values, separator, comma, encoding, newline, preamble, units
) -> None:
    comma = comma and separator != ","
    lines = [separator.join(["t", "sp", "pv °C", "op"] if separator != "  " else ["t", "sp", "pv°C", "op"])]
    if units:
        lines.append(separator.join(["s", "degC", "degC", "%"]))
    for k, row in enumerate(values):
        cells = [repr(float(k)), *map(repr, row)]
        lines.append(separator.join(c.replace(".", ",") if comma else c for c in cells))
    file = tmp_path_factory.mktemp("csv") / "run.txt"
    file.write_bytes((preamble + "\n".join(lines) + "\n").replace("\n", newline).encode(encoding))
    name = "pv°C" if separator == "  " else "pv °C"
    record = read_record(file, Layout((Channel("T", name, sp="sp"),), (Channel("Q", "op"),), project_time_unit="s"))
    expected = np.array(values)
    np.testing.assert_array_equal(record.t, np.arange(len(values)))
    np.testing.assert_array_equal(np.column_stack([record.r, record.y, record.u]), expected)


def test_raw_table_needs_no_layout(write) -> None:
    table = read_table(write("# made by a logger\nZeit;TC 1;OP\ns;degC;%\n" + "0;1,5;2\n1;2,25;3\n"))
    assert table.names == ("Zeit", "TC 1", "OP")
    assert (table.separator, table.decimal, table.encoding) == (";", ",", "utf-8")
    assert table.units == {"Zeit": "s", "TC 1": "degC", "OP": "%"}
    np.testing.assert_array_equal(table.numbers("TC 1")[0], [1.5, 2.25])
    assert table.where(1) == "line 5"


def test_quoted_decimal_commas_in_a_comma_separated_file(write) -> None:
    record = read_record(write(HEADER + rows(line='{i},"1,5","{i},25","0,5"')), ONE)
    np.testing.assert_array_equal(record.y[:, 0], np.arange(20) + 0.25)
    np.testing.assert_array_equal(record.u[:, 0], 0.5)


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        ('"1,234.5"', 1234.5),
        ('"1,234,567"', 1234567.0),
        ("1'234.5", 1234.5),
        ("\N{MINUS SIGN}3.5", -3.5),
        ("1e3", 1000.0),
    ],
)
def test_ways_to_write_a_number(write, cell: str, value: float) -> None:
    record = read_record(write(HEADER + rows(line="{i},1.5,{i}.25," + cell)), ONE)
    np.testing.assert_array_equal(record.u[:, 0], value)


def test_an_ambiguous_comma_is_said(write) -> None:
    text = "t;sp;pv;op\n" + rows(line="{i};1;{i};1,234")
    record = read_record(write(text), ONE)
    np.testing.assert_array_equal(record.u[:, 0], 1.234)
    assert [n.kind for n in record.notes if "two ways" in n.message] == ["decimal"]


def test_dots_as_thousands_in_a_decimal_comma_file(write) -> None:
    record = read_record(write("t;sp;pv;op\n" + rows(line="{i};1;1.234,5;{i}.000,25")), ONE)
    np.testing.assert_array_equal(record.y[:, 0], 1234.5)
    np.testing.assert_array_equal(record.u[1:, 0], np.arange(1, 20) * 1000 + 0.25)


def test_trailing_separators_and_blank_lines_do_not_matter(write) -> None:
    record = read_record(write("t;sp;pv;op;\n\n" + rows(line="{i};1.5;{i};{j};") + "\n;;;;\n\n"), ONE)
    np.testing.assert_array_equal(record.y[:, 0], np.arange(20))


def test_comments_among_the_rows_and_quotes_in_names_do_not_matter(write) -> None:
    text = 't,12" valve,sp,op\n' + rows(10) + "# paused\n" + rows(20).split("9,1.5,9.25,0.125\n")[1]
    record = read_record(
        write(text), Layout((Channel("V", '12" valve'),), (Channel("Q", "op"),), project_time_unit="s")
    )
    np.testing.assert_array_equal(record.t, np.arange(20))


def test_text_among_numbers_is_missing_and_noted(write) -> None:
    words = {3: "Bad", 5: "No Data", 9: "#N/A", 11: "I/O Timeout", 12: "---"}
    text = HEADER + "".join(f"{i},1,{words.get(i, i)},{i % 2}\n" for i in range(20))
    record = read_record(write(text), ONE)
    assert set(np.flatnonzero(np.isnan(record.y[:, 0]))) == set(words)
    (note,) = [n for n in record.notes if n.kind == "text"]
    assert note.samples == 5
    assert "'Bad', 'No Data', '#N/A', 'I/O Timeout' (first: line 5)" in note.message
    assert note.spans[0] == (3.0, 3.0)


def test_empty_cells_are_missing_without_a_word(write) -> None:
    text = HEADER + "".join(f"{i},1,{'' if i % 4 == 0 else i},{i % 2}\n" for i in range(20))
    record = read_record(write(text), ONE)
    assert int(np.isnan(record.y).sum()) == 5
    assert {n.kind for n in record.notes} == {"constant"}


def test_a_constant_column_is_noted(write) -> None:
    record = read_record(write(HEADER + rows()), ONE)
    (note,) = [n for n in record.notes if n.kind == "constant"]
    assert (note.signal, note.value) == ("sp", 1.5)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", ["run.csv is empty"]),
        ("  \n \n", ["run.csv is empty"]),
        (HEADER, ["no rows of numbers"]),
        ("hello world\nno table\n", ["run.csv"]),
        (bytes(range(256)) * 20, ["not a text file"]),
        (b"\x1f\x8b\x08\x00aaaaaaaa", ["compressed"]),
        (HEADER + rows(3), ["three rows", "at least 10"]),
        (HEADER + rows(12) + "12,1,2\n", ["line 14", "3 fields", "have 4"]),
        (HEADER + rows(5) + "5,1,2,3,4\n" + rows(9), ["line 7", "5 fields", "have 4"]),
        (rows(20), ["no header"]),
        ("t,sp,pv,pv,op\n" + rows(20, "{i},1,2,3,4"), ["'pv' more than once"]),
        ("t,sp,PV1,op\n" + rows(), ["no column 'pv'", "did you mean 'PV1'", "t, sp, PV1, op"]),
        (HEADER + rows(20, "{i},1,,{j}"), ["'pv'", "is empty"]),
        (HEADER + rows(20, "{i},1,Bad,{j}"), ["'pv'", "'Bad' in 20 rows of 20"]),
        (HEADER + rows(12).replace("7,1.5", "x,1.5"), ["line 9", "'t'", "'x' is not a time"]),
        ("a;b\n" + rows(20, "{i};{j}"), ["no column 'pv'"]),
        ("t,sp,pv,op\n" + rows(20, "{i},1,5,{j},25,3,5"), ["4 names", "7 fields", "decimal commas"]),
    ],
)
def test_one_clear_error(write, content: str | bytes, says: list[str]) -> None:
    with pytest.raises(DataError) as caught:
        read_record(write(content), ONE)
    message = str(caught.value)
    assert all(part in message for part in says), message
    assert "\n" not in message


MISSPELT = {
    "the PV of y": {"outputs": (Channel("y", "TIC1.PVV", sp="TIC1.SP"),)},
    "the set-point of y": {"outputs": (Channel("y", "TIC1.PV", sp="TIC1.SPP"),)},
    "the OP of u": {"inputs": (Channel("u", "TIC1.OPP"),)},
    "the mode of u": {"inputs": (Channel("u", "TIC1.OP", mode="TIC1.MODEE"),)},
    "the slave's set-point of u": {"inputs": (Channel("u", "TIC1.OP", slave_sp="FIC2.SPP", slave_pv="FIC2.PV"),)},
    "the slave's PV of u": {"inputs": (Channel("u", "TIC1.OP", slave_sp="FIC2.SP", slave_pv="FIC2.PVV"),)},
    "disturbance d": {"disturbances": (Channel("d", "TI3.PVV"),)},
    "time": {"time": "Time stampp"},
}


@pytest.mark.parametrize(("role", "change"), MISSPELT.items(), ids=MISSPELT)
def test_every_misspelt_column_is_answered_by_the_nearest(write, role: str, change: dict) -> None:
    names = "Time stamp,TIC1.SP,TIC1.PV,TIC1.OP,TIC1.MODE,FIC2.SP,FIC2.PV,TI3.PV"
    file = write(names + "\n" + "".join(f"{k},1,2,3,1,4,5,{k}\n" for k in range(20)))
    sound = Layout((Channel("y", "TIC1.PV", sp="TIC1.SP"),), (Channel("u", "TIC1.OP"),), time="Time stamp")
    read_record(file, sound)
    with pytest.raises(DataError, match=f"has no column '[^']+' for {role}; did you mean '") as caught:
        read_record(file, replace(sound, **change))
    wrong, near = re.findall("'([^']+)'", str(caught.value).replace("slave's", ""))[:2]
    assert wrong[:-1] == near


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nowhere\.csv does not exist"):
        read_record(tmp_path / "nowhere.csv", ONE)
    with pytest.raises(DataError, match="is a folder"):
        read_record(tmp_path, ONE)


def test_named_separator_is_used(write) -> None:
    file = write("t:sp:pv:op\n" + rows(line="{i}:1.5:{i}.25:{j}"))
    record = read_record(file, Layout(ONE.outputs, ONE.inputs, separator=":", project_time_unit="s"))
    np.testing.assert_array_equal(record.y[:, 0], np.arange(20) + 0.25)
    with pytest.raises(DataError, match="only one column"):
        read_record(file, Layout(ONE.outputs, ONE.inputs, separator=";"))


def test_the_digest_is_that_of_the_file(write) -> None:
    import hashlib

    file = write(HEADER + rows())
    assert read_record(file, ONE).sha256 == hashlib.sha256(file.read_bytes()).hexdigest()


@pytest.mark.parametrize("ending", ["csv", "xlsx"])
def test_lines_above_the_header_may_hold_dates_and_numbers(tmp_path, ending):
    """As spreadsheets save them: each line has as many fields as the data."""
    banner = [["Report", "unit 3", "", ""], ["Created", "01.05.2024", "", ""], ["Interval", "60", "", ""]]
    head = [["Time", "FIC1.PV", "FIC1.OP", "FIC1.MODE"], ["", "m3/h", "%", ""]]
    data = [[f"2024-05-01 00:{k:02d}:00", f"{k}.5", "" if k == 0 else f"{k}", "AUTO"] for k in range(30)]
    path = tmp_path / f"a.{ending}"
    if ending == "csv":
        path.write_text("\n".join(";".join(row) for row in [*banner, *head, *data]))
    else:
        import xlsxwriter

        with xlsxwriter.Workbook(str(path)) as book:
            sheet = book.add_worksheet()
            for k, row in enumerate([*banner, *head, *data]):
                sheet.write_row(k, 0, row)
    table = read_table(path)
    assert table.names == tuple(head[0]) and table.units == {"FIC1.PV": "m3/h", "FIC1.OP": "%"}
    assert len(table) == 30 and table.where(0) == "line 6"
    assert table.numbers("FIC1.PV")[0][3] == 3.5


def test_a_column_by_itself_may_have_blanks_in_its_name(tmp_path):
    """Such as the coefficients of one element."""
    path = tmp_path / "steps.csv"
    path.write_text("steam -> reactor\n" + "".join(f"{k / 10}\n" for k in range(30)))
    table = read_table(path, fewest=1)
    assert table.names == ("steam -> reactor",)
    assert table.numbers("steam -> reactor")[0][:3].tolist() == [0.0, 0.1, 0.2]
