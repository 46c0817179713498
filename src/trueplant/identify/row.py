"""The output of one row of the plant, simulated on recorded inputs, with its derivatives.

Signals enter as deviations from their first sample. What happened before the record is summed up by
nuisance terms that are linear: an offset for each segment and, unless the record starts at rest, the
free response of every lag.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.identify.initial_state import Modes, Past, Unknown, unknown_of
from trueplant.identify.pieces import Piece
from trueplant.identify.prior import Prior
from trueplant.identify.restricted import Restriction
from trueplant.lti.structure import Structure
from trueplant.record.types import Load


@dataclass(frozen=True)
class Spec:
    """One element of the row: which input drives it, and its structure."""

    column: int
    """Index into the inputs followed by the measured disturbances."""
    structure: Structure
    initial: tuple[float, ...] | None = None
    """The model's parameters, near which the plant is taken to be (`prior`) and with which the estimate is compared;
    None where the model has no such element."""
    undeclared: tuple[int, ...] = ()
    """Places of parameters in `initial` which the model does not have: the search starts there, and no more."""
    guess: tuple[float, ...] | None = None
    """Initial guess of the parameters; None for the model's."""


@dataclass(frozen=True, eq=False)
class Row:
    """A row of elements over pieces of data, seen at every `stride`-th sample."""

    specs: tuple[Spec, ...]
    pieces: tuple[Piece, ...]
    stride: int = 1
    restricted: Restriction | None = None
    """Whose restricted likelihood the fits maximise; None: the likelihood itself."""
    per_look: int = 1
    """Measurements of PV for each that is looked at, where a controller acted on all of them; 1: none is left out."""

    def rests(self, k: int) -> bool:
        """Does piece k start in steady state, so that it needs no free response?"""
        return self.pieces[k].starts_at_rest

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        ends = np.cumsum([len(s.structure.names) for s in self.specs])
        return tuple(slice(int(e) - len(s.structure.names), int(e)) for s, e in zip(self.specs, ends, strict=True))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of all parameters, in the order of theta."""
        return tuple(name for spec in self.specs for name in spec.structure.names)

    @property
    def size(self) -> int:
        return len(self.names)

    @cached_property
    def is_gain(self) -> BoolArray:
        """(size,) masks over theta: gains and slopes."""
        return self._joined(spec.structure.is_gain for spec in self.specs)

    @cached_property
    def is_lag(self) -> BoolArray:
        """(size,) time constants of real poles."""
        return self._joined(spec.structure.is_lag for spec in self.specs)

    @cached_property
    def is_frequency(self) -> BoolArray:
        """(size,) natural frequencies of complex pairs."""
        return self._joined(spec.structure.is_frequency for spec in self.specs)

    @cached_property
    def is_lead(self) -> BoolArray:
        """(size,) time constants of zeros."""
        return self._joined(spec.structure.is_lead for spec in self.specs)

    @cached_property
    def is_dead_time(self) -> BoolArray:
        """(size,)"""
        return self._joined(spec.structure.is_dead_time for spec in self.specs)

    @staticmethod
    def _joined(masks: Iterable[BoolArray]) -> BoolArray:
        joined = np.concatenate([np.zeros(0, dtype=bool), *masks])
        joined.flags.writeable = False
        return joined

    def element_of(self, index: int) -> int:
        """Which element theta[index] belongs to."""
        return next(m for m, part in enumerate(self.slices) if part.start <= index < part.stop)

    def lag_of_dead_times(self, theta: Array) -> Array:
        """(size,) for each dead time the lag of its element, against which an error in it shows; 0 for the rest."""
        lags = np.zeros(self.size)
        for m, (spec, part) in enumerate(zip(self.specs, self.slices, strict=True)):
            lags[part] = np.where(spec.structure.is_dead_time, self.lag(m, theta[part]), 0.0)
        return lags

    def lag(self, m: int, p: Array) -> float:
        """How long element m with the parameters p takes to answer, in time units.

        Of an integrator without a lag of its own it is the time in which the whole of its input's range in the
        record takes PV through the whole of its own.
        """
        spec = self.specs[m]
        if not spec.structure.integrators or spec.structure.lag(p) > 0:
            return spec.structure.lag(p)
        piece = max(self.pieces, key=lambda piece: piece.y.size)
        drive = abs(float(p[spec.structure.is_gain].sum())) * float(np.ptp(piece.inputs[spec.column]))
        travel = float(np.ptp(piece.y[piece.valid])) if piece.valid.any() else 0.0
        return max(travel / drive, piece.h) if drive > 0 else piece.h

    def bounds(self) -> tuple[Array, Array]:
        """Of theta where it is sought: as `limits`, and no dead time within STRIDES_PER_DEAD_TIME looks.

        Where measurements of PV are left out, an answer of the plant between them passes for what the controller made
        of the disturbance, which is not seen.
        """
        low, high = self.limits()
        if self.per_look > 1:
            low[self.is_dead_time] = levels.STRIDES_PER_DEAD_TIME * self.stride * self.pieces[0].h
        return low, high

    def limits(self) -> tuple[Array, Array]:
        """Of theta; lags far shorter than a sample are not identifiable and end at a twentieth of one."""
        pairs = [(np.zeros(0), np.zeros(0)), *(s.structure.bounds() for s in self.specs)]
        low, high = np.concatenate([low for low, _ in pairs]), np.concatenate([high for _, high in pairs])
        h = self.pieces[0].h
        low[self.is_lag] = levels.FASTEST_LAG * h
        high[self.is_frequency] = 1 / (levels.FASTEST_LAG * h)
        return low, high

    @cached_property
    def prior(self) -> Prior:
        """Of theta, about the model."""
        initial = (None if s.initial is None else np.array(s.initial, dtype=float) for s in self.specs)
        return Prior.joined(
            [Prior.about(s.structure, model, s.undeclared) for s, model in zip(self.specs, initial, strict=True)]
        )

    def measured(self, k: int) -> tuple[Array, BoolArray]:
        """Output (n,) of piece k about its mean, 0 where it was not measured, and where it was."""
        piece = self.pieces[k]
        return piece.about_its_mean[:: self.stride], piece.valid[:: self.stride]

    @property
    def energy(self) -> float:
        """Sum of squares of the output, of each piece about its mean."""
        return float(sum(y[ok] @ y[ok] for y, ok in map(self.measured, range(len(self.pieces)))))

    @property
    def guessed_time_scale(self) -> float:
        """How long an element takes to answer of which nothing is known."""
        return max(piece.span for piece in self.pieces) / 20

    def without_unseen(self, theta: Array) -> Row:
        """The row without the outputs that still answer to inputs from before a record that starts in motion.

        What OP did in the last dead time before the record is not in it, and no free response makes up for it.
        """
        dead = float(np.max(theta[self.is_dead_time], initial=0.0))
        pieces = []
        for piece in self.pieces:
            unseen = int(np.ceil(dead / piece.h)) + 1  # the dead time may turn out a little longer
            valid = piece.valid.copy()
            if not piece.starts_at_rest:
                valid[: min(unseen, piece.y.size // 5)] = False
            for start in piece.restarts:
                valid[start : start + min(unseen, piece.y.size // 5)] = False
            pieces.append(replace(piece, valid=valid, y=np.where(valid, piece.y, 0.0)))
        return replace(self, pieces=tuple(pieces))

    def between(self, begin: int, end: int) -> tuple[Piece, ...]:
        """The pieces from one sample to before another, counted over all pieces on end."""
        found, start = [], 0
        for piece in self.pieces:
            size = piece.y.size
            low, high = max(begin - start, 0), min(end - start, size)
            low, high = low - low % self.stride, high if high == size else high - high % self.stride
            if high > low:
                found.append(piece.from_sample(low, None if high == size else high))
            start += size
        return tuple(found)

    def parted(self, place: int) -> tuple[tuple[Piece, ...], tuple[Piece, ...]]:
        """The pieces before a sample, counted over all pieces on end, and those from it on."""
        return self.between(0, place), self.between(place, sum(piece.y.size for piece in self.pieces))

    @property
    def middle(self) -> int:
        """The sample, over all pieces on end, with as many measured ones before as after."""
        seen = np.cumsum(np.concatenate([piece.valid for piece in self.pieces]))
        return int(np.searchsorted(seen, seen[-1] / 2)) + 1

    def response(self, theta: Array, k: int) -> Array:
        """Simulated output of piece k at the strided samples, from rest."""
        piece = self.pieces[k]
        total = np.zeros(-(-piece.y.size // self.stride))
        for spec, part in zip(self.specs, self.slices, strict=True):
            u, hold = piece.inputs[spec.column], piece.hold[spec.column]
            total += spec.structure.response(theta[part], u, piece.h, hold, self.stride)
        return total

    def response_and_gradient(self, theta: Array, k: int) -> tuple[Array, Array]:
        """Simulated output (n,) of piece k and its derivative by theta (n, size)."""
        piece = self.pieces[k]
        n = len(range(0, piece.y.size, self.stride))
        total, gradient = np.zeros(n), np.zeros((self.size, n))
        for spec, part in zip(self.specs, self.slices, strict=True):
            u, hold = piece.inputs[spec.column], piece.hold[spec.column]
            rows = spec.structure.response_and_gradient(theta[part], u, piece.h, hold, self.stride)
            total += rows[0]
            gradient[part] = rows[1:]
        return total, gradient.T

    def unknown(self, theta: Array, k: int) -> Unknown:
        """What is linear and not known of piece k: offset, free responses of an unknown past, jumps, loads."""
        piece, found = self.pieces[k], unknown_of(theta, self._modes, self._pasts[k])
        answers, places, largest = [], [], []
        for load, m in self.loads(k):
            course, hold, part = load.course(piece.times), piece.hold[load.column], self.slices[m]
            structure = self.specs[m].structure
            answers.append(structure.response_and_gradient(theta[part], course, piece.h, hold, self.stride))
            places.append(part)
            largest.append(levels.LARGEST_FREE_RESPONSE * float(piece.input_spread[load.column]))
        return found.including(answers, places, largest)

    def loads(self, k: int) -> list[tuple[Load, int]]:
        """The loads that step within piece k and reach its output, each with the element that they reach it through."""
        places = {spec.column: m for m, spec in enumerate(self.specs)}
        return [(load, places[load.column]) for load in self.pieces[k].stepping if load.column in places]

    def nuisance(self, theta: Array, k: int) -> Array:
        """Columns (n, n_z) of `unknown`."""
        return self.unknown(theta, k).columns

    @cached_property
    def nuisance_count(self) -> int:
        """Offsets, free responses, jumps and loads over all pieces, which are estimated along."""
        loads = sum(len(self.loads(k)) for k in range(len(self.pieces)))
        return loads + sum(1 + past.starts.size * self._modes.free_responses + past.jumps.size for past in self._pasts)

    @cached_property
    def spike_count(self) -> int:
        """Samples that count for what all others say of them."""
        taken = [piece.spikes[:: self.stride] for piece in self.pieces if piece.spikes is not None]
        return sum(int(np.count_nonzero(sizes)) for sizes in taken)

    @property
    def unknown_count(self) -> int:
        """Degrees of freedom that both of these cost."""
        return self.nuisance_count + self.spike_count

    @cached_property
    def _modes(self) -> Modes:
        structures = [spec.structure for spec in self.specs]
        return Modes(
            np.flatnonzero(self.is_lag),
            np.flatnonzero(self.is_frequency),
            np.flatnonzero(self.is_gain),
            np.repeat(np.arange(len(structures)), np.array([len(s.names) for s in structures], dtype=int)),
            np.flatnonzero([s.integrators > 0 for s in structures]),
        )

    @cached_property
    def _pasts(self) -> tuple[Past, ...]:
        """Of each piece."""
        columns = [spec.column for spec in self.specs]
        return tuple(
            Past(
                np.array([*([] if self.rests(k) else [0]), *piece.restarts], dtype=np.int64),
                np.array(piece.jumps, dtype=np.int64),
                piece.y.size,
                self.stride,
                piece.h,
                piece.spread,
                piece.input_spread[columns],
            )
            for k, piece in enumerate(self.pieces)
        )
