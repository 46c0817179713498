"""From windows to changes: which elements changed, since when, in a step or little by little.

All elements of all outputs are tested together, and Holm's procedure keeps the chance of a single false alarm at the
requested level. The time of the most significant step is estimated from the raw record, new windows are placed on both
sides of it, so that none contains it, and the tests are repeated until none is significant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from trueplant.detect import holm
from trueplant.detect.change_point import change_point
from trueplant.detect.since import History, Series, Shift, history, slope
from trueplant.result import Change, ChangeKind, ElementHistory, Moved, TrackedElement
from trueplant.study.study import Progress
from trueplant.tracking import levels
from trueplant.tracking.rows import Fitted, FollowedRow
from trueplant.tracking.series import Followed, Gap


@dataclass(frozen=True)
class Key:
    """One hypothesis: element `column` of row `row` does not change in a section."""

    row: int
    column: int
    section: tuple[float, float]


def find_changes(
    rows: Sequence[FollowedRow], level: float, seed: int, say: Progress
) -> tuple[list[Followed], list[TrackedElement], list[Change]]:
    """All changes of all rows, in order of time, and the history of every element."""
    followed = [Followed.of(row, say) for row in rows]
    tests: dict[Key, History] = {}
    settled: dict[Key, float] = {}
    """Drifts and undecided changes, by their adjusted p-value."""
    rejected: set[Key] = set()
    """Steps that are not significant any more with windows that end at them."""
    for _ in range(levels.MOST_CHANGES):
        say("looking for changes")
        _test(followed, tests, seed)
        keys = list(tests)
        adjusted = dict(zip(keys, holm([tests[k].p_value for k in keys]), strict=True)) if keys else {}
        left = [k for k in keys if adjusted[k] < level and k not in settled and k not in rejected]
        if not left:
            break
        key = min(left, key=lambda k: (tests[k].p_value, -max(tests[k].step, tests[k].drift)))
        if tests[key].kind != ChangeKind.STEP:
            settled[key] = float(adjusted[key])
            continue
        one = followed[key.row]
        gap = _dated(one, key, tests, float(adjusted[key]), level)
        split = one.with_gap(gap, say)
        if not _holds(split, gap, level):
            rejected.add(key)
            continue
        if split.row.planned_across(gap.time):
            split = split.planned_anew(max(split.fitted, key=lambda w: w.estimate.fit.count).estimate, say)
        followed[key.row] = split
    # a section that a later step divides is no longer there: its two parts were tested instead
    changes = [_gradual(followed[k.row], k, tests[k], p, level) for k, p in settled.items() if k in tests]
    for one in followed:
        for gap in one.gaps:
            drifting = {k.column for k in settled if k in tests and followed[k.row] is one and _borders(gap, k.section)}
            changes += _steps(one, gap, level, drifting)
    changes.sort(key=lambda c: (c.time if c.time is not None else c.interval[0], c.output, c.input))
    return followed, [e for n, one in enumerate(followed) for e in _elements(one, n, tests, changes)], changes


def _test(followed: Sequence[Followed], tests: dict[Key, History], seed: int) -> None:
    """Bring the tests up to the sections as they now are."""
    wanted: set[Key] = set()
    for n, one in enumerate(followed):
        for spec in one.row.specs:
            for section in one.sections():
                key = Key(n, spec.column, section)
                series = one.series(spec.column, section)
                if series is not None:
                    wanted.add(key)
                    if key not in tests:
                        tests[key] = _with_shape(history(series, seed=seed), one.estimates(spec.column, section))
    for key in set(tests) - wanted:
        del tests[key]


def _with_shape(found: History, full: Series | None) -> History:
    """Significance by the one-step estimates; kind, time and size by the full ones, valid for large changes as well."""
    if full is None or len(full) < levels.LEAST_TO_SHAPE:
        return found
    shape = history(full, draws=1)
    return replace(found, kind=shape.kind, time=shape.time, step=shape.step, drift=shape.drift)


def _dated(one: Followed, key: Key, tests: dict[Key, History], p: float, level: float) -> Gap:
    """The time of a step, estimated from the raw record around it; where that fails, between two windows."""
    windows = one.inside(key.section)
    instant = tests[key].time
    ends = [k for k, w in enumerate(windows) if w.end <= instant + 1e-9]
    begins = [k for k, w in enumerate(windows) if w.start >= instant - 1e-9]
    last, first = ends[-1], begins[0]
    around = windows[max(last - levels.AROUND + 1, 0) : first + levels.AROUND]
    rough = (windows[last].end, windows[first].start) if first - last > 1 else _between(windows[last], windows[first])
    row, clock = one.row.row_of(around)
    before, after = windows[last].estimate.theta, windows[first].estimate.theta
    changing = np.zeros(before.size, dtype=bool)
    for spec, part in zip(row.specs, row.slices, strict=True):
        other = tests.get(replace(key, column=spec.column))
        stepped = other is not None and other.kind == ChangeKind.STEP and other.p_value < level
        near = other is not None and around[0].start <= other.time <= around[-1].end
        changing[part] = spec.column == key.column or (stepped and near)
    ar = windows[last].estimate.fit.ar
    undated = one.plan.settle / levels.UNDATED
    search = (around[0].start + undated, around[-1].end - undated)
    found = change_point(row.without_unseen(before), clock, before, after, changing, ar, search, 1 - level)
    if found is None:
        return Gap((rough[0] + rough[1]) / 2, rough, key.column, p)
    return Gap(found.time, found.interval, key.column, p)


def _between(before: Fitted, after: Fitted) -> tuple[float, float]:
    """Where a step between two neighbouring windows may lie: in the halves next to each other."""
    return (before.start + before.end) / 2, (after.start + after.end) / 2


def _shift(one: Followed, column: int, gap: Gap) -> Shift | None:
    """What the windows between this step and its neighbours say before and after; None where a side has none."""
    sections = one.sections()
    here = one.gaps.index(gap)
    before, after = (one.together(column, section) for section in sections[here : here + 2])
    if before is None or after is None:
        return None
    series = [one.series(column, section) for section in sections[here : here + 2]]
    scatter = max([1.0, *(history(s, draws=1).scatter for s in series if s is not None)])
    return Shift(before[0], after[0], scatter**2 * (before[1] + after[1]))


def _holds(one: Followed, gap: Gap, level: float) -> bool:
    """Is the step still significant with the new windows, in the element in which it was found?"""
    shift = _shift(one, gap.found_in, gap)
    return shift is not None and shift.p_value < level


def _borders(gap: Gap, section: tuple[float, float]) -> bool:
    return section[1] == gap.interval[0] or section[0] == gap.interval[1]


def _steps(one: Followed, gap: Gap, level: float, drifting: set[int]) -> list[Change]:
    """The elements that changed at a step: the one in which it was found, and others that changed with it.

    Those that drift beside it differ across it anyway, and are not said to have stepped.
    """
    columns = [spec.column for spec in one.row.specs]
    shifts = {c: s for c in columns if (s := _shift(one, c, gap)) is not None}
    others = [c for c in shifts if c != gap.found_in and c not in drifting]
    adjusted = dict(zip(others, holm([shifts[c].p_value for c in others]), strict=True)) if others else {}
    adjusted = {c: float(p) for c, p in adjusted.items() if p < level} | {gap.found_in: gap.p_adjusted}
    return [
        _change(one, c, ChangeKind.STEP, (gap.time, gap.interval), p, shifts[c], level)
        for c, p in sorted(adjusted.items())
    ]


def _gradual(one: Followed, key: Key, found: History, p: float, level: float) -> Change:
    windows = one.inside(key.section)
    series = one.estimates(key.column, key.section)
    if series is None or len(series) < 2:
        series = one.series(key.column, key.section)
    assert series is not None  # it was tested
    before, after, covariance = slope(series, found.scatter)
    if len(series) == 2:
        before, after = series.theta
        covariance = series.covariance.sum(axis=0)
    interval = (windows[0].start, windows[-1].end)
    kind = ChangeKind(found.kind)
    return _change(one, key.column, kind, (None, interval), p, Shift(before, after, covariance), level)


def _change(
    one: Followed,
    column: int,
    kind: ChangeKind,
    when: tuple[float | None, tuple[float, float]],
    p: float,
    shift: Shift,
    level: float,
) -> Change:
    """One change of one element, with the parameters that moved: by how much, and how surely beyond the whole.

    when: the instant of a step (None for a drift) and its interval. p: adjusted, of the element as a whole.
    """
    project = one.row.study.project
    structure = next(s.structure for s in one.row.specs if s.column == column)
    units = one.row.units(column)
    kept = one.kept(column)
    before, after = shift.before, shift.after
    sigma = np.sqrt(np.diag(shift.covariance))
    rise = after - before
    raw = 2 * norm.sf(np.abs(rise) / sigma)
    adjusted = np.maximum(holm(raw), p)
    changed = adjusted < level  # of none where they have changed jointly, and no single one for certain
    half = norm.ppf(1 - level / 2) * sigma
    parameters = tuple(
        Moved(
            structure.names[k],
            units[k],
            float(before[m]),
            float(after[m]),
            float(sigma[m]),
            (float(rise[m] - half[m]), float(rise[m] + half[m])),
            100 * float(rise[m] / before[m]) if before[m] else None,
            float(adjusted[m]),
            bool(changed[m]),
        )
        for m, k in enumerate(kept)
    )
    names = one.row.study.columns
    return Change(project.output_names[one.row.output], names[column], kind, *when, p, parameters)


def _elements(one: Followed, n: int, tests: dict[Key, History], changes: Sequence[Change]) -> list[TrackedElement]:
    project = one.row.study.project
    output = project.output_names[one.row.output]
    out = []
    for spec in one.row.specs:
        name = one.row.study.columns[spec.column]
        own = [c for c in changes if (c.output, c.input) == (output, name)]
        count = sum(spec.column in w.found and not w.found[spec.column].reasons for w in one.fitted)
        tested = [h for key, h in tests.items() if (key.row, key.column) == (n, spec.column)]
        across = [shift.p_value for gap in one.gaps if (shift := _shift(one, spec.column, gap)) is not None]
        kinds = [c.kind for c in own]
        if kinds:
            worst = ElementHistory(next(kind for kind in ChangeKind if kind in kinds))
            out.append(TrackedElement(output, name, worst, min(c.p_adjusted for c in own), count, _scatter(tested)))
        elif tested or across:
            p = min([1.0, *(len(tests) * h.p_value for h in tested), *(len(one.row.specs) * p for p in across)])
            out.append(TrackedElement(output, name, ElementHistory.CONSTANT, p, count, _scatter(tested)))
        else:
            why = _why_untested(one, spec.column, count)
            out.append(TrackedElement(output, name, ElementHistory.NOT_IDENTIFIABLE, None, count, 1.0, why))
    return out


def _scatter(tested: Sequence[History]) -> float:
    return max((h.scatter for h in tested), default=1.0)


def _why_untested(one: Followed, column: int, count: int) -> str:
    if not one.fitted:
        return "no window could be fitted"
    if count == 1:
        return "only one window answers for it: there is nothing to compare it with"
    reasons = [why.text for w in one.fitted if column in w.found for why in w.found[column].reasons.values()]
    return max(set(reasons), key=reasons.count) if reasons else "too few windows answer for it"
