"""Check says of each set-point how it moves, and against what noise (simulated)."""

from __future__ import annotations

import numpy as np
import pytest

from support.stamped import project_text, record, square_wave, stamped
from trueplant.cli.data import show_check
from trueplant.project import Project
from trueplant.result import SetpointMoves
from trueplant.study.check import check


def told(r: np.ndarray, std: float = 0.05) -> SetpointMoves:
    found = check(Project.from_toml(project_text()), frames=[stamped(record(r, std=std), "numbers")])
    (one,) = found.data[0].setpoints
    assert found.to_dict()["data"][0]["setpoints"][0]["message"] == one.message
    return one


def test_moves_of_several_sizes():
    r = square_wave(1500, 150)
    r[r > 0] = np.repeat([0.5, 1.0, 1.0, 1.0, 2.0], 150)
    found = told(r)
    # noise of pole 0.8: its second differences are those of white noise of this size
    assert (found.moves, found.smallest, found.median, found.largest, found.interval) == (9, 0.5, 1.0, 2.0, 150)
    assert found.message.startswith("sp moved 9 times, by 0.5 to 2 degC (median 1), every 2.5 h; PV noise is 0.0")
    assert 0.005 < found.noise < 0.05


@pytest.mark.parametrize(
    ("r", "said"),
    [
        (np.zeros((600, 1)), "sp never moved; PV noise is"),
        (square_wave(600, 300, 2.0), "sp moved once, by 2 degC; PV noise is"),
        (square_wave(600, 60), "sp moved 9 times, by 1 degC, every 60 min; PV noise is"),
        (np.sin(np.arange(600) / 10)[:, None], "sp changes all the time, by "),
    ],
)
def test_how_a_set_point_moves_in_words(r: np.ndarray, said: str, capsys: pytest.CaptureFixture[str]):
    found = told(r)
    assert found.message.startswith(said)
    show_check(check(Project.from_toml(project_text()), frames=[stamped(record(r), "numbers")]))
    assert said in capsys.readouterr().out
