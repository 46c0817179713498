"""The plant without a parametric model: local responses from the set-points, turned into G by either form.

Everything is a relation between samples: u held, y read at the instants. The response found is therefore the
sampled one, to be compared with `sampled_frequency_response` of a parametric plant; the continuous response is
obtained from it by dividing by the hold, or, where a model is known, by correcting the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, BoolArray, ComplexArray
from trueplant.errors import LoopError, Refused, UsageError
from trueplant.loop.controller import Controller
from trueplant.lti.sampled import sampled_response
from trueplant.lti.transfer import TransferMatrix
from trueplant.mismatch import levels
from trueplant.mismatch.expressions import over_controller
from trueplant.mismatch.polynomial import Windows, fit_windows
from trueplant.mismatch.sampling import hold_response, sampled_frequency_response
from trueplant.record.types import Segment

METHODS = ("joint", "closed-form", "direct")


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Non-parametric plant at frequencies w (n_w,) in rad per time unit, with what is known of its error.

    Errors are circular: the real and the imaginary part each have half of std^2. Frequencies come in windows
    of `points`; those of one window are correlated, different windows are independent.
    """

    w: Array
    value: ComplexArray
    """(n_w, n_y, n_u) continuous response G(jw), as far as samples determine it."""
    sampled: ComplexArray
    """(n_w, n_y, n_u) response between the samples of u and of y."""
    std: Array
    """(n_w, n_y, n_u) standard error of `sampled`, sqrt(E|dG|^2); of `value` it is std over |hold|."""
    covariance: ComplexArray
    """(n_windows, points, points, n_y, n_u) of each element of `sampled` within each window."""
    reliable: BoolArray
    """(n_w,) False where noise hides how the loop answers, so that value and std are not to be trusted."""
    h: float
    hold: tuple[str, ...]
    method: str
    dof: int
    """Complex degrees of freedom of the noise in one window."""
    notes: tuple[str, ...] = ()
    periods: int = 0
    """Periods that were averaged; 0 where the response is of local polynomials."""

    @property
    def points(self) -> int:
        """Frequencies in one window."""
        return int(self.covariance.shape[1])


@dataclass(frozen=True)
class Sampled:
    """How u and y were sampled: the sample time, and the hold of each input (`sampled_response`)."""

    h: float
    hold: tuple[str, ...]

    def hold_response(self, w: Array) -> ComplexArray:
        """(n_w, n_u)"""
        return np.stack([hold_response(w, self.h, one) for one in self.hold], axis=1)


@dataclass(frozen=True, eq=False)
class Form:
    """Which expression turns responses from set-points into the plant, and what it takes (as in `local_response`)."""

    method: str
    model: TransferMatrix | None
    controller: Controller | None
    near: bool


@dataclass(frozen=True, eq=False)
class _Expressed:
    """The mismatch at the points of each window, and its error left dZ right, dZ being that of the windows."""

    delta: ComplexArray
    """(n_win, points, n_y, n_u)"""
    left: ComplexArray
    right: ComplexArray
    spread: Array
    """(n_win, points) relative standard error of the loop's own response: where large, first order is not enough."""


def local_response(
    segments: Sequence[Segment],
    method: str = "joint",
    model: TransferMatrix | None = None,
    controller: Controller | None = None,
    near: bool = False,
) -> FrequencyResponse:
    """The plant's frequency response from one or several records by the local polynomial method.

    method: "joint", Delta = (E R^-1)(U R^-1)^-1; "closed-form", (17) with X from set-points to e, which needs model and
    controller; "direct", from u in open-loop records. e = y - Ghat u is simulated with the model, or is y without
    one: the better the model, the smaller the systematic error of records that are short against the loop's settling
    (a window of m bins lets responses last about 1.5/m of the record). Set-points that move at different instants
    are told apart within one record; a single step near the start of a record cannot be told from its transient. All
    segments must have one sample time and the same holds. Missing PV samples, up to a tenth, are bridged by straight
    lines, which is said in `notes`.

    (17) has OP from the law of the controller, so that the closed form takes the stretches in which no OP is at a limit
    or in manual; the model is driven by OP throughout, so that it starts where the plant does.

    near: the model is all but the plant, so that I - X = I up to noise; the closed form is then linear in the noise,
    and so are its errors, however large.

    Raises Refused where the records cannot tell, LoopError where the closed form does not apply, UsageError for
    segments that do not fit together.
    """
    h, hold, inputs, outputs, notes = gathered(segments)
    n_y, n_u = outputs[0].shape[1], inputs[0].shape[1]
    errors = outputs
    if model is not None:
        errors = [y - sampled_response(model, u, h, hold) for y, u in zip(outputs, inputs, strict=True)]
    poles = () if model is None else tuple(p for row in model.elements for element in row for p in element.poles)
    references = moved(segments, method)
    joined = method == "joint"
    signals = [np.hstack(z) for z in zip(errors, inputs, strict=True)] if joined else errors
    if method == "closed-form":
        references, signals = (_where_free(segments, signal) for signal in (references, signals))
    colours = levels.COLOURS if near and not joined else levels.COLOURS[:1]
    windows = fit_windows(references, signals, h, poles, colours)
    form = Form(method, model, controller, near)
    return plant_response(windows, (n_y, n_u), form, Sampled(h, hold), tuple(notes))


def gathered(segments: Sequence[Segment]) -> tuple[float, tuple[str, ...], list[Array], list[Array], list[str]]:
    """Sample time, holds, inputs and outputs relative to their first sample, and what was done to missing samples."""
    if not segments:
        raise Refused("there is no usable segment: see what screening left out, and why")
    h, hold = segments[0].h, segments[0].hold
    if any(abs(s.h - h) > 1e-9 * h or s.hold != hold for s in segments):
        raise UsageError("segments of different sample times or holds cannot be combined: resample them to one")
    if all(s.closed for s in segments):
        hold = segments[0].holds[: len(hold)]
    notes: list[str] = []
    return h, hold, [s.u - s.u[0] for s in segments], [_bridged(s, notes) for s in segments], notes


def moved(segments: Sequence[Segment], method: str) -> list[Array]:
    """What moves the loop by this method, set-points or inputs, from the first sample on; refused where it rests."""
    if method not in METHODS:
        raise UsageError(f'method must be "joint", "closed-form" or "direct", not {method!r}')
    direct = method == "direct"
    moving = [s.u if direct else s.setpoints for s in segments]
    if method == "closed-form":
        moving = _where_free(segments, moving)
        if not moving:
            raise Refused("no sample is left at which no OP is at a limit or in manual: (17) holds for free OPs only")
    _check_moved(moving, "input" if direct else "set-point")
    return [s.u - s.u[0] if direct else s.r - s.r[0] for s in segments]


def plant_response(
    windows: Windows,
    shape: tuple[int, int],
    form: Form,
    sampled: Sampled,
    notes: tuple[str, ...] = (),
    periods: int = 0,
) -> FrequencyResponse:
    """The plant (shape n_y, n_u) from responses to set-points, with the covariance on top of theirs.

    `windows` hold the responses of (e, u) for the joint form, of e otherwise.
    """
    n_y, n_u = shape
    found = _expressed(windows, shape, form, sampled)
    spread = _steadied(found.spread, windows.gram) if periods else found.spread
    base = TransferMatrix.of([[0.0] * n_u] * n_y) if form.model is None else form.model
    covariance = _variance(windows, found.left, found.right)
    variance = np.einsum("wppik->wpik", covariance).real
    w = windows.w.ravel()
    delta = found.delta.reshape(w.size, n_y, n_u)
    return FrequencyResponse(
        w=w,
        value=base(1j * w) + delta / sampled.hold_response(w)[:, None, :],
        sampled=sampled_frequency_response(base, w, sampled.h, sampled.hold) + delta,
        std=np.sqrt(np.maximum(variance, 0.0)).reshape(delta.shape),
        covariance=covariance,
        reliable=(spread < levels.FIRST_ORDER).ravel(),
        h=sampled.h,
        hold=sampled.hold,
        method=form.method,
        dof=windows.dof,
        notes=notes,
        periods=periods,
    )


def _expressed(windows: Windows, shape: tuple[int, int], form: Form, sampled: Sampled) -> _Expressed:
    n_y, n_u = shape
    if form.method == "direct":
        delta = windows.value
        left = np.broadcast_to(np.eye(n_y, dtype=complex), (*delta.shape[:2], n_y, n_y))
        right = np.broadcast_to(np.eye(n_u, dtype=complex), (*delta.shape[:2], n_u, n_u))
        return _Expressed(delta, left, right, np.zeros(delta.shape[:2]))
    if form.method == "joint":
        return _joint(windows, n_y)
    if form.model is None or form.controller is None:
        raise LoopError("the closed form needs a model and a declared controller: use the joint form without")
    return _closed(windows, form.model, form.controller, sampled, form.near)


def speaking_band(
    response: FrequencyResponse, plant: TransferMatrix
) -> tuple[tuple[tuple[float, float] | None, ...], ...]:
    """Lowest and highest frequency between which each element is known to better than half its size in `plant`.

    As averages over an octave: what moves set-points is seldom strong at all frequencies, a square wave at odd
    multiples of its own alone. The response itself would not do for the size, being at least that of its noise. The
    longest run of frequencies, in octaves, without an interruption; None where no two neighbours speak.
    """
    size = np.abs(sampled_frequency_response(plant, response.w, response.h, response.hold))
    with np.errstate(divide="ignore", invalid="ignore"):
        known = size**2 / response.std**2
    # bounded, so that a sum keeps what is added to it
    known = np.where(response.reliable[:, None, None], np.clip(np.nan_to_num(known), 0.0, 1e6), 0.0)
    # points of one window say the same, windows and lines something of their own
    own = known / response.points
    octave = np.searchsorted(response.w, np.outer([1 / np.sqrt(2), np.sqrt(2)], response.w))
    total = np.concatenate([np.zeros((1, *own.shape[1:])), np.cumsum(own, axis=0)])
    speaks = total[octave[1]] - total[octave[0]] > 1 / levels.SPEAKS**2
    _, n_y, n_u = speaks.shape
    return tuple(tuple(_longest_run(response.w, speaks[:, i, j]) for j in range(n_u)) for i in range(n_y))


def _longest_run(w: Array, speaks: NDArray[np.bool_]) -> tuple[float, float] | None:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], speaks, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2] - 1
    if starts.size == 0 or not np.any(ends > starts):
        return None
    best = int(np.argmax(w[ends] / w[starts]))
    return float(w[starts[best]]), float(w[ends[best]])


def _where_free(segments: Sequence[Segment], signals: Sequence[Array]) -> list[Array]:
    """The signals (N, n) of segments, cut to the stretches in which no OP is at a limit or in manual."""
    return [
        signal[begin:end]
        for segment, signal in zip(segments, signals, strict=True)
        for begin, end in segment.free_spans()
    ]


def _check_moved(references: Sequence[Array], what: str) -> None:
    if not all(np.all(np.isfinite(r)) for r in references):
        raise Refused("set-points are missing in these records: without them only open-loop records can be used")
    still = np.flatnonzero(~np.any([np.ptp(r, axis=0) > 0 for r in references], axis=0))
    if still.size:
        raise Refused(
            f"{what} {still[0] + 1} does not move in any record: its effect cannot be told from disturbances; "
            "move it, or leave it out of the matrix"
        )


def _bridged(segment: Segment, notes: list[str]) -> Array:
    """PVs with missing samples filled by straight lines, relative to the first."""
    y = segment.y.copy()
    for i in range(y.shape[1]):
        missing = ~np.isfinite(y[:, i])
        if missing.mean() > levels.MOST_MISSING:
            raise Refused(
                f"{100 * missing.mean():.0f} % of output {i + 1} is missing in experiment {segment.experiment + 1}: "
                f"local models need at least {100 * (1 - levels.MOST_MISSING):.0f} % of the samples; "
                "use a parametric fit"
            )
        if missing.any():
            at = np.arange(len(y))
            y[missing, i] = np.interp(at[missing], at[~missing], y[~missing, i])
            notes.append(
                f"experiment {segment.experiment + 1}, output {i + 1}: {missing.sum()} missing samples were bridged by "
                "straight lines"
            )
    relative: Array = y - y[0]
    return relative


def _joint(windows: Windows, n_y: int) -> _Expressed:
    """Delta = E_r U_r^-1, the factors of its error [I, -Delta] dZ_r U_r^-1, and the size of dU_r U_r^-1."""
    E_r, U_r = windows.value[:, :, :n_y], windows.value[:, :, n_y:]
    n_u, n_r = U_r.shape[2:]
    if n_r < n_u:
        raise Refused(f"{n_r} set-points cannot tell {n_u} inputs apart: use open-loop records or declare more loops")
    inverse = np.linalg.pinv(U_r) if n_r > n_u else np.linalg.inv(U_r)
    delta = E_r @ inverse
    identity = np.broadcast_to(np.eye(n_y, dtype=complex), (*delta.shape[:3], n_y))
    select = np.broadcast_to(np.eye(n_y + n_u, dtype=complex)[n_y:], (*delta.shape[:2], n_u, n_y + n_u))
    left = np.concatenate([identity, -delta], axis=3)
    return _Expressed(delta, left, inverse, _spread(windows, select, inverse))


def _closed(
    windows: Windows, model: TransferMatrix, controller: Controller, sampled: Sampled, near: bool
) -> _Expressed:
    """(17) with X = E_r F^-1, the factors of its error (I - X)^-1 dE_r F^-1 (G + Q^-1), and the size of (I - X)^-1 dX.

    Between samples: u(jw) = h H u_d, r(jw) = h H_zoh r_d and y(jw) = h y_d turn Q into Q/H and F into F H_zoh.
    """
    n_y, n_u = model.shape
    if n_y != n_u:
        raise LoopError(f"(17)-(20) need as many inputs as outputs, not {n_u} and {n_y}: use the joint form")
    w = windows.w.ravel()
    Q = controller(1j * w) / sampled.hold_response(w)[:, :, None]
    F = controller.setpoint(1j * w) * hold_response(w, sampled.h)[:, None, None]
    Ghat = sampled_frequency_response(model, w, sampled.h, sampled.hold)
    X = over_controller(windows.value.reshape(w.size, n_y, n_y), F)
    identity = np.broadcast_to(np.eye(n_y, dtype=complex), X.shape)
    left = identity if near else np.linalg.inv(identity - X)
    inverse = over_controller(identity, Q)
    delta = left @ X @ (Ghat + inverse)
    over_F = np.linalg.inv(F)
    right = over_F @ ((Ghat if near else Ghat + delta) + inverse)
    square = (*windows.w.shape, n_y, n_y)
    left = left.reshape(square)
    spread = np.zeros(windows.w.shape) if near else _spread(windows, left, over_F.reshape(square))
    return _Expressed(delta.reshape(square), left, right.reshape(square), spread)


def _variance(windows: Windows, left: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Covariance (n_win, p, q, i, k) between points p and q of element (i, k) of left_p dZ_p right_p.

    dZ_p is linear in the window's coefficients, whose covariance is gram times noise.
    """
    n_win, n_p, _, n_k = right.shape
    through = np.einsum("pa,wpjk->wpajk", windows.basis, right).reshape(n_win, n_p, -1, n_k)
    of_rows = np.einsum("wpiz,wzv,wqiv->wpqi", left, windows.noise, left.conj(), optimize=True)
    of_columns = np.einsum("wpck,wcd,wqdk->wpqk", through, windows.gram, through.conj(), optimize=True)
    value: ComplexArray = of_rows[..., :, None] * of_columns[..., None, :]
    return value


def _spread(windows: Windows, left: ComplexArray, right: ComplexArray) -> Array:
    """(n_win, points) largest standard error on the diagonal of left dZ right, which no choice of units alters."""
    variance = np.einsum("wppii->wpi", _variance(windows, left, right)).real
    spread: Array = np.sqrt(np.maximum(variance, 0.0)).max(axis=2)
    return spread


def _steadied(spread: Array, gram: ComplexArray) -> Array:
    """The spread (n_lines, 1) as neighbouring lines have it, on the whole, but for how strong each line is.

    A line that is taken because its own spread came out small, or its response large, would get too small an error.
    """
    strength = np.linalg.slogdet(gram)[1] / (2 * gram.shape[1])
    size = np.log(np.maximum(spread[:, 0], 1e-300)) - strength
    place = np.arange(size.size)
    low, high = np.maximum(place - levels.NEIGHBOURS, 0), np.minimum(place + levels.NEIGHBOURS + 1, size.size)
    total = np.concatenate([[0.0], np.cumsum(size)])
    steady: Array = np.exp((total[high] - total[low]) / (high - low) + strength)[:, None]
    return steady
