"""One row with its changes: the windows between them, and what these say about each element."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array
from trueplant.detect.since import Series
from trueplant.identify import OutputEstimate
from trueplant.identify.levels import SHARED_FACTOR
from trueplant.identify.onestep import OneStep, one_step
from trueplant.study.study import Progress
from trueplant.tracking import levels
from trueplant.tracking.rows import Fitted, FollowedRow, Plan
from trueplant.tracking.windows import Stretch


@dataclass(frozen=True)
class Gap:
    """A step: no window reaches into its interval."""

    time: float
    interval: tuple[float, float]
    found_in: int
    """The column that was tested."""
    p_adjusted: float


@dataclass(frozen=True, eq=False)
class Followed:
    """A row with the gaps that its changes leave, and the windows between them."""

    row: FollowedRow
    plan: Plan
    gaps: tuple[Gap, ...] = ()
    """In order of time."""
    windows: tuple[Fitted | Stretch, ...] = ()
    steps: dict[tuple[Stretch, ...], OneStep] = field(default_factory=dict)
    """A memory of what some windows say together."""

    @classmethod
    def of(cls, row: FollowedRow, say: Progress) -> Followed:
        """Without changes, its windows planned from the pilot estimate."""
        say(f"{row.study.project.output_names[row.output]}: planning windows")
        return cls(row, row.plan_from(row.pilot)).laid(say)

    @property
    def fitted(self) -> list[Fitted]:
        return [w for w in self.windows if isinstance(w, Fitted)]

    def laid(self, say: Progress) -> Followed:
        """The same with windows laid anew between its gaps."""
        return replace(self, windows=tuple(self.row.windows(self.plan, [g.interval for g in self.gaps], say)))

    def with_gap(self, gap: Gap, say: Progress) -> Followed:
        """The same with one more gap."""
        return replace(self, gaps=tuple(sorted([*self.gaps, gap], key=lambda g: g.time))).laid(say)

    def planned_anew(self, estimate: OutputEstimate, say: Progress) -> Followed:
        """The same with windows as another estimate of this output asks for."""
        return replace(self, plan=self.row.plan_from(estimate)).laid(say)

    def sections(self) -> list[tuple[float, float]]:
        edges = [-np.inf, *(t for gap in self.gaps for t in gap.interval), np.inf]
        return list(zip(edges[::2], edges[1::2], strict=True))

    def kept(self, column: int) -> list[int]:
        """The parameters of an element that its history rests on; none if its gain is not among them."""
        windows = [w.found[column] for w in self.fitted if column in w.found]
        if not windows:
            return []
        is_gain = windows[0].spec.structure.is_gain
        share = [np.mean([k not in f.reasons for f in windows]) for k in range(is_gain.size)]
        kept = [k for k in range(is_gain.size) if share[k] >= levels.ANSWERED]
        return kept if np.any(is_gain[kept]) else []

    def inside(self, section: tuple[float, float]) -> list[Fitted]:
        return [w for w in self.fitted if w.start >= section[0] and w.end <= section[1]]

    def series(self, column: int, section: tuple[float, float]) -> Series | None:
        """What the windows of a section say about an element, each as a step from what they say together."""
        kept, windows = self.kept(column), self.inside(section)
        if not kept or len(windows) < 2:
            return None
        place = self._places(column)
        steps = self._steps(windows)
        return Series(
            np.array([w.start for w in windows]),
            np.array([w.end for w in windows]),
            steps.theta[:, place],
            steps.covariance[:, place[:, None], place],
        )

    def estimates(self, column: int, section: tuple[float, float]) -> Series | None:
        """The full estimates of an element in the windows of a section that answer for it."""
        kept = self.kept(column)
        used = [
            w
            for w in self.inside(section)
            if kept and column in w.found and not any(k in w.found[column].reasons for k in kept)
        ]
        if not used:
            return None
        found = [w.found[column] for w in used]
        return Series(
            np.array([w.start for w in used]),
            np.array([w.end for w in used]),
            np.array([f.theta[kept] for f in found]),
            np.array([f.covariance[np.ix_(kept, kept)] for f in found]),
        )

    def together(self, column: int, section: tuple[float, float]) -> tuple[Array, Array] | None:
        """What all windows of a section say together about an element, with its covariance."""
        windows = self.inside(section)
        if not windows or not self.kept(column):
            return None
        steps, place = self._steps(windows), self._places(column)
        return steps.common[place], steps.common_covariance[np.ix_(place, place)]

    def _places(self, column: int) -> NDArray[np.intp]:
        """The kept parameters of an element among those of the row."""
        part = np.arange(self.row.pilot.theta.size)[self._part(column)]
        return np.asarray(part[self._order(column)][self.kept(column)])

    def _part(self, column: int) -> slice:
        return next(p for s, p in zip(self.row.specs, self.row.pilot.row.slices, strict=True) if s.column == column)

    def _order(self, column: int) -> NDArray[np.intp]:
        """Lags in order of size, as in `Found`."""
        structure = next(s.structure for s in self.row.specs if s.column == column)
        return np.asarray(structure.sorted(self.row.pilot.theta[self._part(column)]))

    def _steps(self, windows: Sequence[Fitted]) -> OneStep:
        key = tuple(w.stretch for w in windows)
        if key not in self.steps:
            rows = [w.estimate.fit.row for w in windows]
            precise = np.array([1 / np.maximum(np.diag(w.estimate.covariance), 1e-300) for w in windows])
            start = np.sum(precise * [w.estimate.theta for w in windows], axis=0) / precise.sum(axis=0)
            steps = one_step(rows, [w.estimate.fit.ar for w in windows], start)
            if self.row.pilot.predicted_by:
                more = steps.common_covariance * SHARED_FACTOR**2
                steps = replace(steps, covariance=steps.covariance * SHARED_FACTOR**2, common_covariance=more)
            self.steps[key] = steps
        return self.steps[key]
