"""What the report draws, computed from the estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.identify import OutputEstimate, pieces_of
from trueplant.identify.levels import RESIDUAL_LAGS
from trueplant.lti import TransferMatrix, UncertainPlant
from trueplant.mismatch import FrequencyResponse, speaking_band
from trueplant.record import excitation
from trueplant.result import Curves, Interval, Residuals, Trend
from trueplant.study import levels
from trueplant.study.data.declared import model_response, model_steps, step_responses
from trueplant.study.data.nonparametric import label_of
from trueplant.study.plant.elements import model_frequencies
from trueplant.study.plant.fit import simulate_row
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study


def curves_of(
    study: Study, identified: Identified, known: UncertainPlant, response: FrequencyResponse | None
) -> Curves:
    """All curves of the report: steps, Bode, trends, residuals, excitation; `known` (n_y, n_u + n_d)."""
    project, plant = study.project, known.nominal
    n_y, n_u = len(project.outputs), study.n_u
    band = ((None,) * n_u,) * n_y if response is None else speaking_band(response, plant.columns(0, n_u))
    w, t = model_frequencies(study, plant), _step_times(study, plant, band)
    low, high = _step_bands(study, known, t)
    setpoints = any(s.closed and np.isfinite(s.r).any() for s in study.segments)
    excited = excitation(study.segments, "r" if setpoints else "u")
    said = np.where(study.modelled[:, :n_u], 1.0, np.nan)
    return Curves(
        outputs=project.output_names,
        inputs=project.input_names,
        output_units=tuple(o.unit for o in project.outputs),
        input_units=tuple(u.unit for u in project.inputs),
        time_unit=project.time_unit,
        step_t=t,
        step_model=model_steps(study, t) * said,
        step_plant=step_responses(plant.columns(0, n_u), t),
        step_low=low[:, :, :n_u],
        step_high=high[:, :, :n_u],
        w=w,
        bode_model=model_response(study, w) * said,
        bode_plant=plant(1j * w)[:, :, :n_u],
        bode_std=_relative_std(known, w)[:, :, :n_u],
        band=band,
        np_w=np.zeros(0) if response is None else response.w,
        np_value=np.zeros((0, n_y, n_u), complex) if response is None else _reliable(response),
        np_std=np.zeros((0, n_y, n_u)) if response is None else response.std,
        np_label="" if response is None else label_of(response),
        trends=tuple(_trend(study, k, _predicted(study, identified, k, plant)) for k in range(len(study.screened))),
        residuals=tuple(_residuals(study, i, e) for i, e in sorted(identified.estimates.items())),
        condition_w=excited.w,
        condition=excited.condition,
    )


def _reliable(response: FrequencyResponse) -> ComplexArray:
    """(n_w, n_y, n_u) the non-parametric response where its error is below its size; NaN elsewhere."""
    good = response.reliable[:, None, None] & (response.std < np.abs(response.sampled))
    return np.where(good, response.value, np.nan)


def _relative_std(plant: UncertainPlant, w: Array) -> Array:
    """(n_w, n_y, n_u + n_d) standard error of |G| over |G|, to first order; 0 where nothing is uncertain."""
    out = np.zeros((w.size, *plant.nominal.shape))
    for i, row in plant.rows.items():
        for j, structure, part in zip(row.columns, row.structures, row.slices, strict=True):
            gradient = structure.gradient(row.theta[part], 1j * w)
            value = plant.nominal[i, j](1j * w)
            relative = np.real(gradient * np.conj(value)[:, None]) / np.maximum(np.abs(value), 1e-300)[:, None] ** 2
            variance = np.einsum("wp,pq,wq->w", relative, row.covariance[part, part], relative)
            out[:, i, j] = np.sqrt(np.maximum(variance, 0.0))
    return out


def _step_times(study: Study, plant: TransferMatrix, band: Sequence[Sequence[Interval | None]]) -> Array:
    """(n_t,) until model and plant have settled, twice the longest record at most.

    What never settles is shown for as long as a lag would take that is as slow as the data tell.
    """
    both = [e for m in (plant, study.model) for row in m.elements for e in row]
    slow = [-1 / p.real for e in both for p in e.poles if p.real < 0]
    dead = [term.dead_time for e in both for term in e.terms]
    span = max(segment.t[-1] - segment.t[0] for segment in study.segments)
    lowest = [part[0] for row in band for part in row if part is not None]
    settled = 5 * max(slow) if slow else 1 / min(lowest) if lowest else span / 2
    end = min(settled + max(dead, default=0.0), 2 * span)
    return np.linspace(0, end, levels.STEP_POINTS + 1)


def trends_alone(study: Study) -> Curves:
    """The records as they were read, where nothing can be said of a plant."""
    project = study.project
    n_y, n_u = len(project.outputs), study.n_u
    none, elements = np.zeros(0), np.zeros((0, n_y, n_u))
    return Curves(
        outputs=project.output_names,
        inputs=project.input_names,
        output_units=tuple(o.unit for o in project.outputs),
        input_units=tuple(u.unit for u in project.inputs),
        time_unit=project.time_unit,
        step_t=none,
        step_model=elements,
        step_plant=elements,
        step_low=elements,
        step_high=elements,
        w=none,
        bode_model=elements.astype(complex),
        bode_plant=elements.astype(complex),
        bode_std=elements,
        band=((None,) * n_u,) * n_y,
        np_w=none,
        np_value=elements.astype(complex),
        np_std=elements,
        np_label="",
        trends=tuple(_trend(study, k, {}) for k in range(len(study.screened))),
        residuals=(),
        condition_w=none,
        condition=none,
    )


def _step_bands(study: Study, plant: UncertainPlant, t: Array) -> tuple[Array, Array]:
    """(n_t, n_y, n_u + n_d) each: the band of the step responses over plants drawn from what is known of this one.

    NaN for the drawn elements where almost no draw is a plant that can be.
    """
    low = step_responses(plant.nominal, t)
    high = low.copy()
    tail = (1 - study.project.analysis.confidence) / 2
    try:
        drawn = plant.draw(levels.STEP_DRAWS, study.project.analysis.seed).parameters
    except LoopError:
        for i, row in plant.rows.items():
            low[:, i, row.columns] = high[:, i, row.columns] = np.nan
        return low, high
    for (i, j), (structure, parameters) in drawn.items():
        responses = [structure.response(p, np.ones(t.size), t[1]) for p in parameters]
        low[:, i, j], high[:, i, j] = np.quantile(responses, [tail, 1 - tail], axis=0)
    return low, high


def _band(response: FrequencyResponse | None, plant: TransferMatrix) -> tuple[tuple[Interval | None, ...], ...]:
    n_y, n_u = plant.shape
    return ((None,) * n_u,) * n_y if response is None else speaking_band(response, plant)


def _predicted(study: Study, identified: Identified, k: int, plant: TransferMatrix) -> dict[str, Array]:
    """What model and plant make of the recorded OP of an experiment, (N, n_y) each."""
    screened = study.screened[k]
    record = screened.record
    simulated = {label: np.full(record.y.shape, np.nan) for label in ("model", "plant")}
    if screened.refusal is None:
        for i in range(record.y.shape[1]):
            for segment in identified.of_experiment(k):
                inside = (record.t >= segment.t[0]) & (record.t <= segment.t[-1])
                for piece in pieces_of([segment], i):
                    both = [("plant", plant)] + ([("model", study.model)] if study.modelled[i].any() else [])
                    for label, matrix in both:
                        y = simulate_row(matrix, i, piece)
                        simulated[label][inside, i] = np.interp(record.t[inside], segment.t, y)
    return simulated


def _trend(study: Study, k: int, predicted: Mapping[str, Array]) -> Trend:
    screened = study.screened[k]
    record = screened.record
    unknown = np.full(record.y.shape, np.nan)
    findings = [*record.notes, *screened.findings]
    return Trend(
        name=study.project.experiments[k].name,
        t=record.t,
        start=record.start.isoformat() if record.start else None,
        time_zone=record.zone,
        r=record.r,
        y=record.y,
        u=record.u,
        model=predicted.get("model", unknown),
        plant=predicted.get("plant", unknown),
        excluded=tuple(
            (a, b, f.signal, f.kind) for f in findings if f.excludes or f.kind in SHADED for a, b in f.spans
        ),
    )


SHADED = ("saturated", "manual")


def _residuals(study: Study, i: int, estimate: OutputEstimate) -> Residuals:
    tests = estimate.tests
    z = float(norm.ppf(0.5 + study.project.analysis.confidence / 2))
    return Residuals(
        output=study.project.output_names[i],
        t=tests.t,
        e=tests.e,
        lags=tests.lags,
        acf=tests.acf,
        acf_bound=tests.bound,
        ccf={name: tests.ccf[j] for j, name in enumerate(study.columns)},
        ccf_lags=np.arange(1, RESIDUAL_LAGS + 1),
        ccf_bound=z / np.sqrt(max(int(np.isfinite(tests.e).sum()), 1)),
    )
