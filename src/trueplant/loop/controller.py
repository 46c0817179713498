"""Controllers of several loops: PIDs or transfer functions, each from one PV to one OP."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.loop.pid import PID, Entry, hold


@dataclass(frozen=True)
class Controller:
    """``u = Q (F r - y)`` with entries[(input, output)]; what is not listed is zero.

    Called with complex points s (n_s,) it gives Q (n_s, n_u, n_y). For a sampled entry with scan h,
    Q = Q_d(e^(s h)) H and F = 1/H, with H = (1 - e^(-s h))/(s h): y(s) is then the transform of the
    continuous PV (as long as little of it lies above half the scan rate), u(s) and r(s) are those of the
    held OP and held set-point.
    """

    entries: Mapping[tuple[int, int], Entry]
    n_u: int
    n_y: int

    def __post_init__(self) -> None:
        for i, j in self.entries:
            if not (0 <= i < self.n_u and 0 <= j < self.n_y):
                raise LoopError(
                    f"controller entry ({i}, {j}) is outside {self.n_u} inputs and {self.n_y} outputs, counted from 0"
                )
        object.__setattr__(self, "entries", dict(sorted(self.entries.items())))
        for i in range(self.n_u):
            if len({e.limits for (row, _), e in self.entries.items() if row == i and e.limits is not None}) > 1:
                raise LoopError(f"the controllers that write input {i + 1} declare different limits for it: keep one")

    @classmethod
    def diagonal(cls, entries: Sequence[Entry]) -> Controller:
        """One controller a loop, output i to input i."""
        return cls({(i, i): entry for i, entry in enumerate(entries)}, len(entries), len(entries))

    @property
    def is_decentralised(self) -> bool:
        """True if no two entries share an input or an output."""
        inputs, outputs = [i for i, _ in self.entries], [j for _, j in self.entries]
        return len(set(inputs)) == len(inputs) and len(set(outputs)) == len(outputs)

    @property
    def limits(self) -> Array:
        """(n_u, 2) low and high limit of each OP, infinite where none is declared."""
        bounds = np.tile([-np.inf, np.inf], (self.n_u, 1))
        for (i, _), entry in self.entries.items():
            if entry.limits is not None:
                bounds[i] = entry.limits
        return bounds

    @property
    def scan(self) -> float | None:
        """The one scan of all entries; None if any is continuous or they differ."""
        scans = {entry.sample_time for entry in self.entries.values()}
        return scans.pop() if len(scans) == 1 else None

    def __call__(self, s: ArrayLike) -> ComplexArray:
        """Q (n_s, n_u, n_y) at the complex points s (n_s,)."""
        return self._assembled(s, "feedback")

    def reference(self, s: ArrayLike) -> ComplexArray:
        """C_r = Q F (n_s, n_u, n_y), the law from the set-points, found without inverting Q."""
        return self._assembled(s, "reference")

    def setpoint(self, s: ArrayLike) -> ComplexArray:
        """F (n_s, n_y, n_y) in u = Q (F r - y). Needs a square Q that can be inverted at s."""
        z = np.atleast_1d(np.asarray(s, dtype=complex))
        if all(entry.one_degree for entry in self.entries.values()):
            scans = {entry.sample_time for entry in self.entries.values()}
            if len(scans) <= 1:
                h = next(iter(scans), None)
                factor = np.ones(z.shape, complex) if h is None else 1 / hold(z, h)
                return np.asarray(factor[:, None, None] * np.eye(self.n_y), dtype=np.complex128)
        if self.n_u != self.n_y:
            raise LoopError(
                f"F needs as many inputs as outputs, not {self.n_u} and {self.n_y}: use reference(s), which is Q F"
            )
        try:
            value = np.linalg.solve(self(z), self.reference(z))
        except np.linalg.LinAlgError as error:
            raise LoopError("Q cannot be inverted at one of the frequencies: use reference(s), which is Q F") from error
        return np.asarray(value, dtype=np.complex128)

    def linearised(self, pv: ArrayLike) -> Controller:
        """The law for small changes about the PVs (n_y,): pv_transforms replaced by their slopes."""
        point = np.broadcast_to(np.asarray(pv, dtype=float), (self.n_y,))
        return replace(
            self,
            entries={
                (i, j): entry.linearised(float(point[j])) if isinstance(entry, PID) else entry
                for (i, j), entry in self.entries.items()
            },
        )

    def _assembled(self, s: ArrayLike, part: str) -> ComplexArray:
        z = np.atleast_1d(np.asarray(s, dtype=complex))
        value = np.zeros((z.size, self.n_u, self.n_y), dtype=complex)
        for (i, j), entry in self.entries.items():
            if isinstance(entry, PID) and entry.pv_transform is not None:
                raise LoopError(
                    "a controller that acts on a transformed PV has no frequency function: use linearised(pv) first"
                )
            value[:, i, j] = entry.feedback(z) if part == "feedback" else entry.reference(z)
        return value
