"""Columns in each other's place. The records are made by hand."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from support.simulated import segment_of, wood_berry
from trueplant.record.types import Segment
from trueplant.result import Code
from trueplant.study.data.swapped import swapped_columns


def said(segment: Segment) -> list[tuple[str, str]]:
    """Who is said to be swapped with whom."""
    project = SimpleNamespace(
        outputs=[SimpleNamespace(pv=f"PV{i}") for i in (1, 2)], inputs=[SimpleNamespace(op=f"OP{j}") for j in (1, 2)]
    )
    records: Any = SimpleNamespace(segments=(segment,), project=project)
    notes = swapped_columns(records)
    assert all(note.code is Code.SWAPPED for note in notes)
    return [(note.where, note.message.split(", and ")[1].split(" does")[0]) for note in notes]


@pytest.fixture(scope="module")
def loops() -> Segment:
    """Wood-Berry at 80 and 40, OPs about 55 and 45."""
    plain = segment_of(wood_berry(3, 600))
    levels, ops = np.array([80, 40]), np.array([55, 45])
    return dataclasses.replace(plain, y=plain.y + levels, r=plain.r + levels, u=plain.u + ops)


def test_loops_at_their_set_points_are_as_they_are_named(loops):
    assert said(loops) == []


def test_two_pvs_in_each_others_place_are_named(loops):
    assert said(dataclasses.replace(loops, y=loops.y[:, ::-1])) == [("PV1", "PV2")]


def test_a_pv_in_the_place_of_its_op_is_named(loops):
    y, u = loops.y.copy(), loops.u.copy()
    y[:, 0], u[:, 0] = loops.u[:, 0], loops.y[:, 0]
    assert said(dataclasses.replace(loops, y=y, u=u)) == [("PV1", "OP1")]


def test_an_offset_that_a_loop_without_integral_action_leaves_is_no_swap(loops):
    """PV 2 stays 4 above its set-point, which OP 2 crosses at times."""
    y, u = loops.y.copy(), loops.u.copy()
    y[:, 1] += 4 + np.ptp(loops.y[:, 1] - loops.r[:, 1])
    u[:, 1] = 41 + 200 * (u[:, 1] - 45)
    assert np.any(u[:, 1] < loops.r[:, 1]) and np.any(u[:, 1] > loops.r[:, 1])
    assert said(dataclasses.replace(loops, y=y, u=u)) == []


def test_what_was_moved_by_hand_or_has_no_set_point_is_not_asked(loops):
    assert said(dataclasses.replace(loops, y=loops.y[:, ::-1], closed=False)) == []
    assert said(dataclasses.replace(loops, y=loops.y[:, ::-1], r=loops.r * [np.nan, 1])) == []
