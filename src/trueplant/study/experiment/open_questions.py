"""What an analysis had to leave open, and whether it matters to the loops."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array, ComplexArray
from trueplant.detect.levels import GRADE_A
from trueplant.identify import Spec
from trueplant.loop import LinearLoop
from trueplant.lti import KnownRow, TransferMatrix, UncertainPlant
from trueplant.lti.uncertain import responses
from trueplant.study import levels
from trueplant.study.experiment.known import Known
from trueplant.study.study import Place, Study


@dataclass(frozen=True)
class Open:
    """A parameter that is not known well enough."""

    output: int
    column: int
    index: int
    """In theta of its output."""
    name: str
    unit: str
    wanted: float
    """Half-width of an interval that is narrow enough."""
    now: float
    """Half-width of its interval."""
    found: bool = True
    """Is it of an element that has been seen, or that the model has?"""

    @property
    def place(self) -> Place:
        return self.output, self.column


@dataclass(frozen=True, eq=False)
class Matter:
    """How much what is open of an element changes the loops' answers to their set-points."""

    place: Place
    part: slice
    """Of theta of its output."""
    gradient: ComplexArray
    """(n_w, p) of the answer of PV, as a share of what it has moved, by each parameter."""
    now: float

    def after(self, covariances: Array) -> Array:
        """(n,) the largest change over frequency, for covariances (n, q, q) of its output."""
        own = covariances[:, self.part, self.part]
        variances = np.einsum("wa,nab,wb->nw", self.gradient, own, self.gradient.conj(), optimize=True).real
        return np.asarray(levels.MATTERS_SURE * np.sqrt(np.maximum(variances, 0.0).max(axis=1)))


def open_parameters(study: Study, known: Mapping[int, Known], confidence: float) -> list[Open]:
    """The parameters whose intervals are too wide, where more data can help."""
    z = float(norm.ppf(0.5 + confidence / 2))
    project, found = study.project, []
    for i, spec, part in _elements(study, known):
        own, structure, p = known[i], spec.structure, known[i].fit.theta[part]
        lags = own.fit.row.lag_of_dead_times(own.fit.theta)[part]
        units = structure.units(project.outputs[i].unit, project.inputs[spec.column].unit, project.time_unit)
        for k, name in enumerate(structure.names):
            index = part.start + k
            model = abs(spec.initial[k]) if spec.initial is not None else 0.0
            size = max(abs(p[k]), model if structure.is_gain[k] else 0.0) + lags[k]
            low, high = own.estimate.intervals[index]
            if own.without_dynamics(spec, part):
                low = high = 0.0  # these are intervals beside other dynamics
                if spec.initial is None and not structure.is_gain[k]:
                    continue  # first it has to be seen whether there is anything
            half = (high - low) / 2 if np.isfinite(high - low) else 0.0
            now = max(z * float(np.sqrt(own.covariance[index, index])), half)
            wanted = float(GRADE_A * size)
            if size > 0 and not own.hopeless(part)[k] and (index in own.reasons or now > wanted):
                seen = spec.initial is not None or not own.without_dynamics(spec, part)
                found.append(Open(i, spec.column, index, name, units[k], wanted, float(now), seen))
    return found


def possible_plants(
    study: Study, known: Mapping[int, Known], plant: TransferMatrix, loop: LinearLoop | None
) -> UncertainPlant:
    """The plant (n_y, n_u) with all that the record leaves open, also of what is not answered.

    Gains keep their sign where a loop is closed over them.
    """
    rows = {}
    for i, own in known.items():
        specs, theta = own.fit.row.specs, own.fit.theta
        sigma = np.sqrt(np.maximum(np.diag(own.covariance), 1e-300))
        scale = np.minimum(1.0, _largest_spread(own) / sigma)
        covariance = own.covariance * np.outer(scale, scale)
        rows[i] = KnownRow(tuple(s.column for s in specs), tuple(s.structure for s in specs), theta, covariance)
    whole = UncertainPlant(plant, rows).first(study.n_u)
    return whole if loop is None else whole.keeping_signs([(i, j) for j, i in loop.controller.entries])


def _largest_spread(own: Known) -> Array:
    """(n,) standard deviations of the parameters at most: beyond its own size nothing is known of one.

    The gain of an element without answered dynamics and without a model may be anything that the record allows; of
    several gains that is their sum.
    """
    most = np.full(own.fit.theta.size, np.inf)
    for m, (spec, part) in enumerate(own.elements):
        lag = own.fit.row.lag(m, own.fit.theta[part])
        sizes = spec.structure.sizes(own.fit.theta[part], lag)
        if spec.initial is not None:
            initial = np.asarray(spec.initial, dtype=float)
            sizes = np.maximum(sizes, spec.structure.sizes(initial, own.fit.row.lag(m, initial)))
        elif own.without_dynamics(spec, part):
            gains = np.arange(part.start, part.stop)[spec.structure.is_gain]
            net = float(np.sqrt(max(own.covariance[np.ix_(gains, gains)].sum(), 0.0)))
            sizes = np.where(spec.structure.is_gain, net / levels.DRAWN_SPREAD, sizes)
        most[part] = levels.DRAWN_SPREAD * sizes
    return most


def what_matters(
    study: Study, known: Mapping[int, Known], loop: LinearLoop | None, w: Array, seen: Array
) -> list[Matter]:
    """How much what is open of each element changes the answers of PVs at the frequencies w, where more data can help.

    An error E of the plant changes the loops' answers to their set-points by S E Q S, to first order; `seen` (n_y,) is
    how far each PV and set-point moves. In open loop `seen` (n_u,) is how far each OP moves, and an error counts as a
    share of what all of them do to the PV: what an OP does that never moves is not asked for.
    """
    found = []
    seen = np.where(seen > 0, seen, seen.max()) if loop is not None else seen
    closed = None if loop is None else loop.functions(1j * w)
    for i, spec, part in _elements(study, known):
        theta, structure = known[i].fit.theta, spec.structure
        if closed is None:
            weight = _share_of_answer(known[i], w, seen) * seen[spec.column]
        else:
            weight = (np.abs(closed.S[:, :, i]) / seen).max(axis=1)
            weight = weight * (np.abs(closed.QS[:, spec.column]) * seen).max(axis=1)
        gradient = structure.gradient(theta[part], 1j * w) * weight[:, None] * ~known[i].hopeless(part)
        one = Matter((i, spec.column), part, gradient, 0.0)
        found.append(replace(one, now=float(one.after(known[i].covariance[None])[0])))
    return found


def _elements(study: Study, known: Mapping[int, Known]) -> Iterator[tuple[int, Spec, slice]]:
    """(output, element, its parameters) of all that someone can move and more data can tell."""
    for i, own in known.items():
        for spec, part in own.elements if own.data_can_help else ():
            if spec.column < study.n_u and not own.hopeless(part).all():
                yield i, spec, part


def _share_of_answer(own: Known, w: Array, seen: Array) -> Array:
    """(n_w,) 1 over what OPs that move by `seen` (n_u,) do to a PV; over that at the corner where they do less."""
    answers = np.zeros(w.size)
    for spec, part in own.elements:
        if spec.column < seen.size:
            answer = np.abs(responses(spec.structure, own.fit.theta[None, part], w)[0]) * seen[spec.column]
            answers = np.maximum(answers, answer)
    both = [(spec.structure, own.fit.theta[part]) for spec, part in own.elements]
    slowest = max(structure.lag(p) + structure.longest_dead_time(p) for structure, p in both)
    corner = np.interp(1 / max(slowest, 1 / w[-1]), w, answers)
    return np.asarray(1 / np.maximum(answers, max(float(corner), 1e-300)))


def with_what_is_wanted(asked: Sequence[Open], elements: Sequence[Matter]) -> tuple[Open, ...]:
    """The same; of an element that has not been seen a gain is wanted as well as it takes for it not to matter."""
    share = {one.place: levels.MATTERS / max(one.now, 1e-300) for one in elements}
    return tuple(
        one if one.found else replace(one, wanted=max(one.wanted, one.now * share.get(one.place, 0.0))) for one in asked
    )
