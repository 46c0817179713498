"""What an analysis returns: frozen data, its JSON form, and the curves that the report draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Interval = tuple[float, float]


@dataclass(frozen=True)
class Reason:
    """Why something was refused or limited."""

    code: str
    message: str
    where: str = ""


@dataclass(frozen=True)
class Parameter:
    """One parameter of one element: the model's value, the plant's, and how sure that is."""

    name: str
    unit: str
    model: float | None
    plant: float | None
    std_error: float | None
    ci: Interval | None
    change_percent: float | None
    """Of the model's value."""
    p_value: float | None
    p_adjusted: float | None
    changed: bool
    reason: str = ""
    """Why it is not answered, when `plant` is None."""


@dataclass(frozen=True)
class Importance:
    """What the change does: peak of sigma_max of Delta_ij in Q Shat ("loop"), or relative change ("open loop")."""

    value: float | None
    basis: str


@dataclass(frozen=True)
class Element:
    output: str
    input: str
    structure: str
    tf_model: str
    tf_plant: str | None
    tf_mismatch: str | None
    parameters: tuple[Parameter, ...]
    verdict: str
    """"unchanged", "changed" or "not identifiable"."""
    reason: str
    p_adjusted: float | None
    importance: Importance
    grade: str
    """A..D, defined in docs/verdicts.md."""


@dataclass(frozen=True, eq=False)
class Trend:
    """One experiment for the report; arrays time first."""

    name: str
    t: Array
    r: Array
    y: Array
    u: Array
    model: Array
    """(N, n_y) simulated output of the model, driven by the recorded OP, with its offset fitted."""
    plant: Array
    """(N, n_y) the same for the estimated plant."""
    excluded: tuple[tuple[float, float, str, str], ...]
    """(from, to, signal, reason)."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Prediction errors of one output, and the tests on them."""

    output: str
    t: Array
    e: Array
    lags: NDArray[np.integer[Any]]
    acf: Array
    acf_bound: float
    ccf: Mapping[str, Array]
    """Cross-correlation with each input at `ccf_lags`."""
    ccf_lags: NDArray[np.integer[Any]]
    ccf_bound: float


@dataclass(frozen=True, eq=False)
class MuCurves:
    """Nominal performance, robust stability and robust performance of today's loop over frequency."""

    system: str
    """"model" and "plant" under the declared uncertainty, "estimate" for the plant under that of its parameters."""
    w: Array
    """(n_w,) rad per time unit; the first stands for the limit towards 0."""
    bounds: Mapping[str, Array]
    """By test, "NP", "RS", "RP": (n_w, 2) lower and upper bound."""
    peaks: Mapping[str, Interval]
    """By test: frequency (0 for the limit towards 0) and upper bound."""


@dataclass(frozen=True, eq=False)
class CoherenceCurves:
    """What of each output the set-points (or OP) explain over frequency."""

    w: Array
    multiple: Array
    """(n_w, n_y) between 0 and 1."""
    level: float
    """What noise alone exceeds at a share `significance` of the frequencies."""
    significance: float
    setpoints: bool


@dataclass(frozen=True, eq=False)
class RetuningCurves:
    """One loop before and after retuning, on the plant as estimated, the other loops closed likewise.

    All tables are by "before" and "after"; (n_t, 3): low, value, high over plants drawn from the estimate.
    """

    input: str
    output: str
    method: str
    t: Array
    setpoint: Mapping[str, Array]
    """PV after a unit step of the set-point."""
    load: Mapping[str, Array]
    """PV after a unit step at the plant's input."""
    op_setpoint: Mapping[str, Array]
    op_load: Mapping[str, Array]
    replay_t: Array
    replay: Mapping[str, Array]
    """Control error r - y (n,) under the disturbance recovered from the record; also "record", as it was. Empty where
    no stretch of the record allows it."""


@dataclass(frozen=True, eq=False)
class Curves:
    """What is drawn. Everything here can be recomputed from the data and result.json."""

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    output_units: tuple[str, ...]
    input_units: tuple[str, ...]
    time_unit: str
    step_t: Array
    step_model: Array
    """(n_t, n_y, n_u)."""
    step_plant: Array
    step_low: Array
    step_high: Array
    w: Array
    bode_model: ComplexArray
    """(n_w, n_y, n_u); w in rad per time unit."""
    bode_plant: ComplexArray
    bode_std: Array
    """(n_w, n_y, n_u) standard error of |G| relative to |G| (also of the phase, in rad)."""
    band: tuple[tuple[Interval | None, ...], ...]
    """[n_y][n_u]: the frequencies in which the data speak, or None."""
    np_w: Array
    np_value: ComplexArray
    """(n_w2, n_y, n_u) non-parametric estimate; NaN where there is none."""
    np_std: Array
    np_label: str
    trends: tuple[Trend, ...]
    residuals: tuple[Residuals, ...]
    condition_w: Array
    condition: Array
    """Condition number of the set-points' (or inputs') excitation at `condition_w`."""
    mu: tuple[MuCurves, ...] = ()
    retuning: tuple[RetuningCurves, ...] = ()
    coherence: CoherenceCurves | None = None


@dataclass(frozen=True, eq=False)
class Result:
    """The outcome of an analysis. `to_dict` is result.json (schema 1)."""

    status: str
    reasons: tuple[Reason, ...]
    provenance: Mapping[str, Any]
    data: tuple[Mapping[str, Any], ...]
    elements: tuple[Element, ...]
    fit: tuple[Mapping[str, Any], ...] = ()
    methods: Mapping[str, Any] = field(default_factory=dict)
    robustness: Mapping[str, Any] = field(default_factory=dict)
    controllers: tuple[Mapping[str, Any], ...] = ()
    more_data: tuple[Mapping[str, Any], ...] = ()
    """Moves that would settle what is open, the shortest first."""
    notes: tuple[Reason, ...] = ()
    """What the reader should know although it was not refused; also in result.json."""
    curves: Curves | None = None
    plant_toml: str = ""

    @property
    def mismatch(self) -> bool:
        return any(element.verdict == "changed" for element in self.elements)

    @property
    def headline(self) -> str:
        """The verdict in one sentence for the person at the panel."""
        from trueplant.study.words import headline

        return headline(self)

    def to_dict(self) -> dict[str, Any]:
        """result.json as plain Python; numbers that are not finite become None."""
        from trueplant.study.words import document

        return document(self, left_out=("curves", "plant_toml"))

    def __repr__(self) -> str:
        from trueplant.study.words import text_summary

        return text_summary(self)

    def _repr_html_(self) -> str:
        from trueplant.study.words import html_summary

        return html_summary(self)
