"""What the report draws, computed from the estimates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array, ComplexArray
from trueplant.detect import Found
from trueplant.identify import OutputEstimate, pieces_of
from trueplant.identify.levels import RESIDUAL_LAGS
from trueplant.lti import TransferMatrix
from trueplant.lti.sampled import sampled_response
from trueplant.mismatch import FrequencyResponse, speaking_band
from trueplant.record import excitation
from trueplant.result import Curves, Residuals, Trend
from trueplant.study.data.nonparametric import label_of
from trueplant.study.plant.elements import model_frequencies
from trueplant.study.plant.fit import simulate_row
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Place, Study

POINTS = 200
DRAWS = 200


def curves_of(
    study: Study,
    identified: Identified,
    found: Mapping[Place, Found],
    plant: TransferMatrix,
    response: FrequencyResponse | None,
) -> Curves:
    """All curves of the report: steps, Bode, trends, residuals, excitation."""
    project = study.project
    n_y, n_u = len(project.outputs), len(project.inputs)
    w = model_frequencies(study, plant)
    inputs_only = range(n_u)
    t, low, high = _step_bands(study, found, plant)
    step = [
        [sampled_response(m[i, j], np.ones(t.size), t[1], "zoh") for j in inputs_only]
        for m in (study.model, plant)
        for i in range(n_y)
    ]
    steps = np.array(step).reshape(2, n_y, n_u, t.size).transpose(0, 3, 1, 2)
    setpoints = any(s.closed and np.isfinite(s.r).any() for s in study.segments)
    excited = excitation(study.segments, "r" if setpoints else "u")
    return Curves(
        outputs=project.output_names,
        inputs=project.input_names,
        output_units=tuple(o.unit for o in project.outputs),
        input_units=tuple(u.unit for u in project.inputs),
        time_unit=project.time_unit,
        step_t=t,
        step_model=steps[0],
        step_plant=steps[1],
        step_low=low,
        step_high=high,
        w=w,
        bode_model=study.model(1j * w)[:, :, :n_u],
        bode_plant=plant(1j * w)[:, :, :n_u],
        bode_std=_relative_std(found, plant, w, n_y, n_u),
        band=tuple((None,) * n_u for _ in range(n_y)) if response is None else speaking_band(response),
        np_w=np.zeros(0) if response is None else response.w,
        np_value=np.zeros((0, n_y, n_u), complex) if response is None else _believable(response),
        np_std=np.zeros((0, n_y, n_u)) if response is None else response.std,
        np_label="" if response is None else label_of(response),
        trends=tuple(_trend(study, identified, k, plant) for k in range(len(study.screened))),
        residuals=tuple(_residuals(study, i, e) for i, e in sorted(identified.estimates.items())),
        condition_w=excited.w,
        condition=excited.condition,
    )


def _believable(response: FrequencyResponse) -> ComplexArray:
    """(n_w, n_y, n_u) the non-parametric response where its error is below its size; NaN elsewhere."""
    good = response.reliable[:, None, None] & (response.std < np.abs(response.sampled))
    return np.where(good, response.value, np.nan)


def _relative_std(found: Mapping[tuple[int, int], Found], plant: TransferMatrix, w: Array, n_y: int, n_u: int) -> Array:
    """(n_w, n_y, n_u) standard error of |G| over |G|, to first order."""
    out = np.zeros((w.size, n_y, n_u))
    for (i, j), element in found.items():
        if j >= n_u:
            continue
        gradient = element.spec.structure.gradient(element.theta, 1j * w)
        value = plant[i, j](1j * w)
        relative = np.real(gradient * np.conj(value)[:, None]) / np.maximum(np.abs(value), 1e-300)[:, None] ** 2
        variance = np.einsum("wp,pq,wq->w", relative, element.covariance, relative)
        out[:, i, j] = np.sqrt(np.maximum(variance, 0.0))
    return out


def _step_bands(
    study: Study, found: Mapping[tuple[int, int], Found], plant: TransferMatrix
) -> tuple[Array, Array, Array]:
    """Times (n_t,), and the band (n_t, n_y, n_u) of the step responses over plants drawn from the covariance."""
    n_y, n_u = len(study.project.outputs), len(study.project.inputs)
    slow = [-1 / p.real for m in (plant, study.model) for row in m.elements for e in row for p in e.poles if p.real < 0]
    dead = [term.dead_time for m in (plant, study.model) for row in m.elements for e in row for term in e.terms]
    span = max(segment.t[-1] - segment.t[0] for segment in study.segments)
    end = min(5 * max(slow, default=span / 10) + max(dead, default=0.0), 2 * span)
    t = np.linspace(0, end, POINTS + 1)
    low = np.zeros((t.size, n_y, n_u))
    high = np.zeros((t.size, n_y, n_u))
    tail = (1 - study.project.analysis.confidence) / 2
    rng = np.random.default_rng(study.project.analysis.seed)
    for i in range(n_y):
        for j in range(n_u):
            nominal = sampled_response(plant[i, j], np.ones(t.size), t[1])
            low[:, i, j] = high[:, i, j] = nominal
            if (i, j) in found:
                draws = _drawn_steps(found[i, j], t, rng)
                low[:, i, j], high[:, i, j] = np.quantile(draws, [tail, 1 - tail], axis=0)
    return t, low, high


def _drawn_steps(element: Found, t: Array, rng: np.random.Generator) -> Array:
    """(DRAWS, n_t) step responses of plants drawn from the covariance, inside the parameters' bounds."""
    theta, covariance = element.theta, element.covariance
    # A parameter that is not known at all would only hide what is known.
    scale = np.minimum(np.sqrt(np.diag(covariance)), 3 * np.abs(theta) + 1e-12)
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)) + 1e-300)
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = theta + scale * (rng.standard_normal((DRAWS, theta.size)) @ root.T)
    low, high = element.spec.structure.bounds()
    floor = np.where(low > 0, np.abs(theta) * 0.02, low)
    draws = np.clip(draws, floor, high)
    structure = element.spec.structure
    return np.array([sampled_response(structure.transfer(p), np.ones(t.size), t[1]) for p in draws])


def _trend(study: Study, identified: Identified, k: int, plant: TransferMatrix) -> Trend:
    screened = study.screened[k]
    record = screened.record
    simulated = {label: np.full(record.y.shape, np.nan) for label in ("model", "plant")}
    if screened.refusal is None:
        for i in range(record.y.shape[1]):
            for segment in identified.of_experiment(k):
                inside = (record.t >= segment.t[0]) & (record.t <= segment.t[-1])
                for piece in pieces_of([segment], i):
                    for label, matrix in (("model", study.model), ("plant", plant)):
                        y = simulate_row(matrix, i, piece)
                        simulated[label][inside, i] = np.interp(record.t[inside], segment.t, y)
    findings = [*record.notes, *screened.findings]
    return Trend(
        name=study.project.experiments[k].name,
        t=record.t,
        r=record.r,
        y=record.y,
        u=record.u,
        model=simulated["model"],
        plant=simulated["plant"],
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
