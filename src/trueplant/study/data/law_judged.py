"""A declared law against the windows of a record: the sums that fit it best, its gains and times, and since when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from trueplant.loop import PID, Controller, Kind, Linear, Sum
from trueplant.study import levels
from trueplant.study.data.law_samples import wrong_samples
from trueplant.study.data.law_windows import Cuts, Fit, Label, Stretch, Windows, cut, windows_of

NAMES = {Kind.GAIN: "gain", Kind.INTEGRAL: "integral time", Kind.DERIVATIVE: "derivative time"}


@dataclass(frozen=True)
class Ratio:
    """A gain or a time over the declared one, as judged: an integral time by its inverse, which stays finite."""

    output: int
    kind: Kind
    base: bool
    """Is it the gain of the entry?"""
    judged: float
    judged_std: float

    @property
    def name(self) -> str:
        return "gain" if self.base else NAMES[self.kind]

    @property
    def value(self) -> float:
        """Over the declared one; infinite for an integral time where there is no integral action."""
        if self.base or self.kind is not Kind.INTEGRAL:
            return self.judged
        return 1 / self.judged if self.judged > 0 else np.inf

    @property
    def std(self) -> float:
        if self.base or self.kind is not Kind.INTEGRAL:
            return self.judged_std
        return self.judged_std / self.judged**2 if self.judged > 0 else np.inf

    @property
    def _wrong(self) -> float:
        """Times the declared value, or that part of it, from which one has to be found out."""
        return 1 + (levels.GAIN_OFF if self.base else levels.TIME_OFF)

    @property
    def known(self) -> bool:
        """Is it surely none of the values that have to be found out?"""
        spread = levels.LAW_SURE * self.judged_std
        return 1 / self._wrong < self.judged - spread and self.judged + spread < self._wrong

    @property
    def off(self) -> bool:
        """Nearer to such a value than to the declared one, on a logarithmic scale, and surely not the declared one."""
        if abs(self.judged - 1) < levels.LAW_SURE * self.judged_std:
            return False
        return self.judged <= 0 or 2 * abs(float(np.log(self.judged))) > float(np.log(self._wrong))


@dataclass(frozen=True, eq=False)
class Judged:
    """What a record says of a declared law."""

    windows: Windows
    ratios: tuple[Ratio, ...]
    missed: float
    """Root mean square of OP less the law as declared ..."""
    left: float
    """... and less the law with the gains that fit best, in windows."""
    allowed: float
    """What may be left."""
    rounding: float
    """What rounding alone would leave."""
    longest: int
    """Samples of a window."""
    integral: Sum | None
    """How the integral is summed up, where the record tells."""
    tried: tuple[Windows, ...] = ()
    """By every way of summing up that makes a difference."""

    @property
    def off(self) -> tuple[Ratio, ...]:
        return tuple(r for r in self.ratios if r.off)

    @property
    def known(self) -> bool:
        """Can the gains and integral times be told?"""
        return all_known(self.ratios)

    @property
    def confirmed(self) -> bool:
        return self.known and not self.off and self.left <= self.allowed


def all_known(ratios: Sequence[Ratio]) -> bool:
    """Are gains and integral times known? A derivative time often is not, as OP hardly shows it."""
    return all(r.known for r in ratios if r.base or r.kind is not Kind.DERIVATIVE)


def judged(stretches: Sequence[Stretch], controller: Controller, i: int, scale: float) -> Judged | None:
    """The law that writes OP i against the record, by the sums with which it misses OP least as it is declared.

    scale: root mean square of OP's own movement. Samples that only the historian saw are left out. None where too few
    are left to tell anything.
    """
    for _ in range(levels.STRIKING_ROUNDS):
        cuts = cut(stretches, controller, i)
        if cuts.samples < levels.LAW_WINDOW:
            return None
        tried = {sums: windows_of(cuts, controller, i, sums) for sums in product(*_sums(controller, i))}
        fits = {sums: windows.fit() for sums, windows in tried.items()}
        # what rounding alone makes a law miss is no fault of its sums
        missed = {
            sums: float(windows.missed().sum()) - fits[sums].share * windows.pv_rounding()
            for sums, windows in tried.items()
        }
        best = min(missed, key=lambda sums: missed[sums])
        windows, fit = tried[best], fits[best]
        wrong = wrong_samples(cuts, controller, i, best, (fit.gains, windows.usual()))
        if not any(w.any() for w in wrong):
            break
        stretches = [replace(s, good=s.good & ~w) for s, w in zip(stretches, wrong, strict=True)]
    others = [other for sums, other in missed.items() if sums[0] is not best[0]]
    clear = levels.LAW_SURE**2 * max(fit.rms**2, windows.plain.op_rounding)
    told = best[0] if others and min(others) - missed[best] > clear else None
    found = _with(windows, fit, cuts, scale, told)
    if found.off:
        # where no sum makes the declared law right, none can be told: the gains are those of backward sums
        usual = (Sum.BACKWARD, best[1])
        plain = _with(tried[usual], fits[usual], cuts, scale, None)
        found = plain if plain.off else found
    return replace(found, tried=tuple(tried.values()))


def _with(windows: Windows, fit: Fit, cuts: Cuts, scale: float, told: Sum | None) -> Judged:
    freedom = float(windows.freedom.sum())
    rounding = levels.LAW_ROUNDED * float(np.sqrt(windows.plain.op_rounding + windows.pv_rounding() / freedom))
    return Judged(
        windows,
        ratios_of(windows.labels, fit),
        missed=float(np.sqrt(windows.missed().sum() / freedom)),
        left=fit.rms,
        allowed=max(levels.CONFIRMED * scale, rounding),
        rounding=rounding,
        longest=cuts.longest,
        integral=told,
    )


def _sums(controller: Controller, i: int) -> tuple[Sequence[Sum], Sequence[Sum]]:
    """The ways of summing up that make a difference: of the integrals, and of all other dynamics."""
    entries = [entry for (row, _), entry in controller.entries.items() if row == i]
    pids = [entry.parallel for entry in entries if isinstance(entry, PID)]
    integral = any(isinstance(e, Linear) for e in entries) or any(ki for _, ki, _, _ in pids)
    rest = any(isinstance(e, Linear) for e in entries) or any(kd and tf for _, _, kd, tf in pids)
    return tuple(Sum) if integral else (Sum.BACKWARD,), tuple(Sum) if rest else (Sum.BACKWARD,)


def ratios_of(labels: Sequence[Label], fit: Fit) -> tuple[Ratio, ...]:
    """The gain of each entry, and relative to it the inverse of its integral time, and its derivative time."""
    found = []
    for j in sorted({j for j, _ in labels}):
        own = [n for n, (output, _) in enumerate(labels) if output == j]
        base = min(own, key=lambda n: list(Kind).index(labels[n][1]))
        for n in [base, *(n for n in own if n != base)]:
            gradient = np.zeros(len(labels))
            value = fit.gains[n]
            gradient[n] = 1.0
            if n != base:
                gradient[n] = 1 / fit.gains[base]
                value = value / fit.gains[base]
                gradient[base] = -value / fit.gains[base]
            found.append(Ratio(j, labels[n][1], n == base, float(value), fit.std(gradient)))
    return tuple(found)


@dataclass(frozen=True)
class Parted:
    """A record that the declared law wrote up to a moment or from it on, and another law the rest of it."""

    at: float
    declared_first: bool
    ratios: tuple[Ratio, ...]
    """Of the other law."""


def parted(found: Judged) -> Parted | None:
    """The moment at which the declared law became another one, or another one the declared law; None if neither.

    By the sums that leave least: those which suit a whole record best are neither law's own.
    """
    for declared_first in (True, False):
        ways = [_parted(windows, found.allowed, declared_first) for windows in found.tried]
        if told := [way for way in ways if way is not None]:
            return min(told, key=lambda way: way[0])[1]
    return None


def _parted(windows: Windows, allowed: float, declared_first: bool) -> tuple[float, Parted] | None:
    """Parted where the declared law on one side and the best gains on the other miss OP least together, and by how much
    in squares."""
    n, m = len(windows), len(windows.labels)
    cuts = np.arange(levels.LAW_BEFORE, n - levels.LAW_BEFORE + 1)
    if not cuts.size or not np.any(windows.plain.gram):
        return None
    way = slice(None) if declared_first else slice(None, None, -1)
    missed = np.concatenate([[0.0], np.cumsum(windows.missed()[way])])
    gram, moment, power = (
        np.concatenate([np.cumsum(x[way][::-1], axis=0)[::-1], np.zeros((1, *x.shape[1:]))])
        for x in (windows.plain.gram, windows.plain.moment, windows.plain.power)
    )
    G = gram[cuts] + np.finfo(float).eps * np.trace(gram[0]) * np.eye(m)
    gains = np.linalg.solve(G, moment[cuts][..., None])[..., 0]
    left = missed[cuts] + power[cuts] - np.sum(gains * moment[cuts], axis=1)
    best = int(cuts[np.argmin(left)])
    at = best if declared_first else n - best
    sides = slice(0, at), slice(at, None)
    declared, other = (windows.fit(side) for side in (sides if declared_first else sides[::-1]))
    ratios = ratios_of(windows.labels, declared)
    right = not any(r.off for r in ratios) and all_known(ratios) and declared.rms <= allowed
    changed = ratios_of(windows.labels, other)
    if not right or not any(r.off for r in changed):
        return None
    return float(left.min()), Parted(float(windows.start[at]), declared_first, changed)
