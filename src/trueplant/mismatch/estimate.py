"""Parameters of the plant's elements by way of the local frequency response, by the closed form or the joint form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array, BoolArray
from trueplant.errors import Refused, TrueplantError
from trueplant.loop.controller import Controller
from trueplant.lti.structure import Structure, structure_of
from trueplant.lti.transfer import TransferFunction, TransferMatrix
from trueplant.mismatch import levels
from trueplant.mismatch.local import FrequencyResponse, local_response
from trueplant.mismatch.periodic import periodic_response
from trueplant.mismatch.reduction import fit_structure
from trueplant.record.types import Segment

Element = tuple[int, int]


@dataclass(frozen=True, eq=False)
class LocalFit:
    """Parameters and covariance of each element that was estimated, and the response they were read from."""

    parameters: Mapping[Element, Array]
    covariance: Mapping[Element, Array]
    plant: TransferMatrix
    """The model with the estimated elements put in."""
    response: FrequencyResponse
    converged: bool
    distance: float
    """Chi-square of the responses about the structures."""
    freedom: int

    @property
    def agrees(self) -> bool:
        """Do the rounds end where the response is that of the structures, but for chance?"""
        return self.converged and bool(chi2.sf(self.distance, self.freedom) > levels.SAME_ELEMENT)


def fit_locally(
    segments: Sequence[Segment],
    structures: Mapping[Element, Structure],
    model: TransferMatrix,
    method: str = "joint",
    controller: Controller | None = None,
    periodic: bool = False,
) -> LocalFit:
    """Estimate elements {(output, input): structure} by the mismatch expression and the local polynomial method.

    Each round takes the mismatch against the present model (see `local_response` for `method`), reduces the plant's
    response to the structures, and puts the result in as the next model: what the local polynomials get wrong is in
    proportion to the mismatch, and vanishes as the rounds settle. Elements without a structure keep the model's value.
    Each element is fitted by itself; covariances between elements are not given. `periodic` takes the response from
    averages over periods (`periodic_response`); weights from a spread of nu degrees of freedom make the covariance
    nu/(nu - 2) times what known weights would leave.

    From the second round on (17) is taken as linear in the mismatch, which it is near the plant alone: rounds that
    begin at a wrong dead time may end there. The response then lies off the structures beyond chance, the rounds
    begin anew, linear about the model, and the end where it lies nearer is taken.

    Raises what `local_response` and `fit_structure` raise.
    """
    asked = segments, structures, model, method, controller, periodic
    found = _rounds(*asked)
    if method == "closed-form" and not found.agrees:
        with suppress(TrueplantError, np.linalg.LinAlgError):
            found = min(found, _rounds(*asked, near_model=True), key=_badness)
    return found


def _badness(fit: LocalFit) -> tuple[bool, float]:
    return not fit.converged, fit.distance / fit.freedom


def _rounds(
    segments: Sequence[Segment],
    structures: Mapping[Element, Structure],
    model: TransferMatrix,
    method: str,
    controller: Controller | None,
    periodic: bool,
    near_model: bool = False,
) -> LocalFit:
    """`fit_locally` from one start: exact about the model, or linear about it."""
    parameters: dict[Element, Array] = {}
    covariance: dict[Element, Array] = {}
    near = {place: known for place, of in structures.items() if (known := _parameters(model[place], of)) is not None}
    plant, converged, distance, freedom = model, False, 0.0, 0
    respond = periodic_response if periodic else local_response
    corner = min((abs(p) for place in structures for p in model[place].poles if p), default=np.inf)
    for round_ in range(levels.FIT_ROUNDS):
        response = respond(segments, method, plant, controller, near=near_model or round_ > 0)
        if round_ == 0 and method == "closed-form" and not _lowest(response) <= levels.BEYOND_CORNER * corner:
            # noise hides the loop's answer, and (17) is linear in it about the model alone
            response = respond(segments, method, plant, controller, near=True)
        _check(response, corner)
        trusted = np.where(_clear(response), 1.0, np.nan)
        before, distance, freedom = dict(parameters), 0.0, 0
        for (i, j), structure in structures.items():
            one = fit_structure(
                response.w,
                response.sampled[:, i, j],
                response.std[:, i, j],
                structure,
                response.h,
                response.hold[j],
                trusted[:, None, None] * response.covariance[..., i, j],
                before.get((i, j)) if round_ > 1 else None,
            )
            parameters[i, j], covariance[i, j] = one.parameters, one.covariance
            distance, freedom = distance + one.distance, freedom + one.freedom
            if periodic:
                covariance[i, j] = covariance[i, j] * response.dof / (response.dof - 2)
        for place in structures:
            found = parameters[place]
            if _speaks(found, covariance[place]) and _contradicts(found, covariance[place], near.get(place)):
                near[place] = found
        plant = _with_elements(model, {place: structures[place] for place in near}, near)
        converged = bool(before) and all(_settled(before[e], parameters[e], covariance[e]) for e in structures)
        if converged:
            break
    return LocalFit(parameters, covariance, plant, response, converged, distance, freedom)


def _clear(response: FrequencyResponse) -> BoolArray:
    """(n_windows,) Is every point of the window reliable?"""
    return np.asarray(response.reliable.reshape(-1, response.points).all(axis=1), dtype=bool)


def _lowest(response: FrequencyResponse) -> float:
    """Frequency from which on windows are clear; infinite where none is."""
    return float(response.w.reshape(-1, response.points)[_clear(response)].min(initial=np.inf))


def _check(response: FrequencyResponse, corner: float) -> None:
    """Refused where the noise's size, or the response near the corner frequency, is not known."""
    if response.periods and response.dof < levels.LEAST_DOF:
        raise Refused(
            f"{response.periods} periods after the transient leave the noise {response.dof} degree"
            f"{'s'[: response.dof > 1]} of freedom at a line, and parameters need {levels.LEAST_DOF}: "
            "record more periods"
        )
    if levels.BEYOND_CORNER * corner < _lowest(response) < np.inf:
        raise Refused(
            f"noise hides how the loop answers below {_lowest(response):.2g} rad per time unit, and the gains with it: "
            "use a longer record or larger set-point changes"
        )


def _speaks(parameters: Array, covariance: Array) -> bool:
    """Is the gain (or slope) known to better than half its size? Else what it was taken about is better."""
    return bool(np.sqrt(covariance[0, 0]) < levels.SPEAKS * abs(parameters[0]))


def _parameters(system: TransferFunction, structure: Structure) -> Array | None:
    """Of an element of that structure; None of one that has another."""
    if system.is_zero:
        return None
    own, values = structure_of(system)
    return np.array(values) if own.names == structure.names else None


def _contradicts(found: Array, covariance: Array, near: Array | None) -> bool:
    """Is what was found another element than the one that the response was taken about?

    A response that says little has minima far apart, and taken about one of them the next one would confirm it.
    """
    if near is None:
        return True
    shift = found - near
    apart = float(shift @ np.linalg.pinv(covariance, rcond=1e-14, hermitian=True) @ shift)
    return bool(chi2.sf(apart, shift.size) < levels.SAME_ELEMENT)


def _settled(before: Array, now: Array, covariance: Array) -> bool:
    limit = levels.SETTLED * np.sqrt(np.diag(covariance)) + 1e-9 * np.abs(before)
    return bool(np.all(np.abs(now - before) <= limit))


def _with_elements(
    model: TransferMatrix, structures: Mapping[Element, Structure], parameters: Mapping[Element, Array]
) -> TransferMatrix:
    rows = [list(row) for row in model.elements]
    for (i, j), structure in structures.items():
        rows[i][j] = structure.transfer(parameters[i, j])
    return TransferMatrix(tuple(tuple(row) for row in rows), model.time_unit)
