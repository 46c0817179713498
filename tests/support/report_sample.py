"""Results for the tests of the report, computed from simulated records of FOPDT elements.

The records are simulated by convolution with exact step responses, the parameters fitted by least squares, and all
intervals follow from its covariance: nothing in these results was made up by hand.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import csd
from scipy.stats import norm

from trueplant.result import (
    Code,
    ControllerCheck,
    Curves,
    DataFinding,
    Element,
    Excitation,
    Exclusion,
    ExperimentData,
    FitRow,
    Importance,
    MethodElement,
    MethodParameter,
    Methods,
    Parameter,
    Provenance,
    Reason,
    Residuals,
    Result,
    Settings,
    SignalExcitation,
    Trend,
)

Array = NDArray[np.float64]
NAMES, H, N = ("gain", "tau1", "dead_time"), 0.5, 480


def step(parameters: Array, t: Array) -> Array:
    """Unit step response of K exp(-theta s)/(tau s + 1); parameters (..., 3), result (..., n_t)."""
    gain, tau, theta = (parameters[..., k, None] for k in range(3))
    return gain * -np.expm1(-np.maximum(t - theta, 0.0) / tau)


def frequency(parameters: Array, w: Array) -> NDArray[np.complex128]:
    gain, tau, theta = (parameters[..., k, None] for k in range(3))
    return gain * np.exp(-1j * w * theta) / (1j * w * tau + 1)


def simulate(parameters: Array, u: Array) -> Array:
    """Outputs (N,) of one row of elements (n_u, 3), by superposing the steps of u (N, n_u) held between samples."""
    moves = np.diff(u, axis=0, prepend=u[:1])
    t = H * np.arange(len(u))
    size = 2 * len(u)
    spectra = np.fft.rfft(step(parameters, t), size) * np.fft.rfft(moves.T, size)
    return np.fft.irfft(spectra.sum(axis=0), size)[: len(u)]


def formula(parameters: Array) -> str:
    gain, tau, theta = parameters
    return f"{gain:.4g} exp(-{theta:.3g} s)/({tau:.4g} s + 1)"


def sample(
    outputs: Sequence[str] = ("top_temperature", "bottom_level"),
    inputs: Sequence[str] = ("reflux", "steam"),
    experiments: int = 2,
    scale: float = 1.0,
    with_setpoints: bool = True,
    seed: int = 7,
) -> Result:
    """Analysis of a simulated plant, of which the first element's gain and the last one's dead time have changed."""
    rng = np.random.default_rng(seed)
    n_y, n_u = len(outputs), len(inputs)
    i, j = np.indices((n_y, n_u))
    gain = scale * np.where(i == j, 1.8 + 0.4 * i, 0.5 * (-1.0) ** (i + j))
    model = np.stack([gain, 6.0 + 2 * i + 3 * j, 1.0 + 0.5 * (i + j)], axis=-1)
    plant = model.copy()
    plant[0, 0, 0] *= 1.3
    plant[-1, -1, 2] += 1.5
    t = H * np.arange(N)
    records = []
    for _ in range(experiments):
        u = np.repeat(rng.choice([-2.0, -1.0, 0.0, 1.0, 2.0], (N // 40, n_u)), 40, axis=0)
        y = np.column_stack([simulate(row, u) for row in plant]) + rng.normal(0, 0.25 * scale, (N, n_y))
        r = 50 + (u - u[0]) @ plant[..., 0].T if with_setpoints else np.full((N, n_y), np.nan)
        records.append((u + 40, y + 50, r))
    fitted = [_fit([(u - 40, y[:, k] - 50) for u, y, _ in records], model[k]) for k in range(n_y)]
    estimate = np.stack([f[0] for f in fitted])
    covariances = [f[1] for f in fitted]
    errors = np.stack([np.sqrt(np.diag(c)).reshape(n_u, 3) for c in covariances])
    units = (("degC", "%", "bar")[:n_y], ("%", "t/h", "%")[:n_u])
    elements = tuple(
        _element(outputs[a], inputs[b], model[a, b], estimate[a, b], errors[a, b], model[..., 0].size * 3)
        for a in range(n_y)
        for b in range(n_u)
    )
    trends = _trends(records, model, estimate, t, inputs[0])
    residuals = _residuals(records, estimate, outputs, inputs, t)
    curves = _curves(outputs, inputs, units, model, estimate, covariances, records, rng)
    curves = dataclasses.replace(curves, trends=trends, residuals=residuals)
    return Result(
        status="ok",
        reasons=(),
        provenance=Provenance(
            version="0.1.0",
            project="project",
            project_sha256="0" * 64,
            data_sha256={f"run_{k + 1}.csv": f"{k:064x}" for k in range(experiments)},
            time_spans={f"run_{k + 1}.csv": (0.0, float(t[-1])) for k in range(experiments)},
            time_unit="min",
            seed=seed,
            settings=Settings("auto", 0.95, 0.0),
        ),
        data=tuple(_data(f"run_{k + 1}", outputs, inputs, records[k], t) for k in range(experiments)),
        elements=elements,
        fit=tuple(_fit_row(outputs[k], trend, k) for trend in trends for k in range(n_y)),
        methods=Methods(
            answers={"joint": tuple(map(_summary, elements)), "direct": tuple(map(_summary, elements[:-1]))},
            agreement=("joint and direct agree within their intervals.",),
            controller_consistency=(
                ControllerCheck("run_1", inputs[0], "%", True, 0.021, "the declared controller reproduces OP"),
            ),
        ),
        notes=(Reason(Code.ONE_EXPERIMENT, "The spread between runs was added to the intervals."),),
        curves=curves,
    )


def _fit(records: list[tuple[Array, Array]], model: Array) -> tuple[Array, Array]:
    """Least-squares estimate (n_u, 3) and its covariance, from the model's values on; an offset for each record."""

    size = max(float(np.std(y)) for _, y in records)

    def errors(x: Array) -> Array:
        parts = [y - simulate(x.reshape(model.shape), u) for u, y in records]
        return np.concatenate([part - part.mean() for part in parts]) / size

    scale = np.maximum(np.abs(model).ravel(), 1e-12)
    lowest = np.where(np.arange(model.size) % 3 == 2, 0.0, -np.inf)
    found = least_squares(lambda x: errors(x * scale), model.ravel() / scale, bounds=(lowest, np.inf))
    variance = 2 * found.cost / (found.fun.size - model.size)
    covariance = variance * np.linalg.inv(found.jac.T @ found.jac) * np.outer(scale, scale)
    return (found.x * scale).reshape(model.shape), covariance


def _element(output: str, input_: str, model: Array, plant: Array, error: Array, questions: int) -> Element:
    parameters = []
    for name, m, p, s in zip(NAMES, model, plant, error, strict=True):
        raw = float(2 * norm.sf(abs(p - m) / s))
        adjusted = min(1.0, raw * questions)
        interval = (float(p - 1.96 * s), float(p + 1.96 * s))
        unit = "degC/%" if name == "gain" else "min"
        change = float(100 * (p - m) / m)
        parameters.append(
            Parameter(name, unit, float(m), float(p), float(s), interval, change, raw, adjusted, adjusted < 0.05)
        )
    changed = any(p.changed for p in parameters)
    smallest = min(p.p_adjusted for p in parameters if p.p_adjusted is not None)
    return Element(
        output,
        input_,
        "fopdt",
        formula(model),
        formula(plant),
        f"{formula(plant)} - ({formula(model)})",
        tuple(parameters),
        "changed" if changed else "unchanged",
        "" if changed else "No parameter differs from the model by more than the data's noise explains.",
        smallest,
        Importance(float(abs(plant[0] / model[0] - 1)), "open loop"),
        "A",
        2.8 * float(max(error / abs(model))),
    )


def _summary(element: Element) -> MethodElement:
    parameters = (MethodParameter(p.name, p.plant, p.std_error, p.ci) for p in element.parameters)
    return MethodElement(element.output, element.input, tuple(parameters))


def _predictions(u: Array, y: Array, parameters: Array) -> Array:
    free = np.column_stack([simulate(row, u - 40) for row in parameters])
    return free + (y - free).mean(axis=0)


def _trends(
    records: list[tuple[Array, Array, Array]], model: Array, plant: Array, t: Array, limited: str
) -> tuple[Trend, ...]:
    spans = ((20.0, 26.0, limited, "OP at its upper limit"), (150.0, 158.5, "all", "excluded in the project file"))
    return tuple(
        Trend(f"run_{k + 1}", t, r, y, u, _predictions(u, y, model), _predictions(u, y, plant), spans if k == 0 else ())
        for k, (u, y, r) in enumerate(records)
    )


def _residuals(
    records: list[tuple[Array, Array, Array]], plant: Array, outputs: Sequence[str], inputs: Sequence[str], t: Array
) -> tuple[Residuals, ...]:
    u, y, _ = records[0]
    e = y - _predictions(u, y, plant)
    lags, both = np.arange(25.0), np.arange(-12.0, 13.0)

    def correlate(a: Array, b: Array, at: Array) -> Array:
        a, b = a - a.mean(), b - b.mean()
        full = np.correlate(a, b, "full") / np.sqrt((a @ a) * (b @ b))
        return full[at.astype(int) + len(b) - 1]

    bound = 1.96 / np.sqrt(N)
    return tuple(
        Residuals(
            name,
            t,
            e[:, k],
            lags,
            correlate(e[:, k], e[:, k], lags),
            bound,
            {x: correlate(e[:, k], u[:, m], both) for m, x in enumerate(inputs)},
            both,
            bound,
        )
        for k, name in enumerate(outputs)
    )


def _curves(
    outputs: Sequence[str],
    inputs: Sequence[str],
    units: tuple[Sequence[str], Sequence[str]],
    model: Array,
    plant: Array,
    covariances: list[Array],
    records: list[tuple[Array, Array, Array]],
    rng: np.random.Generator,
) -> Curves:
    n_y, n_u = model.shape[:2]
    draws = [
        rng.multivariate_normal(p.ravel(), c, 300).reshape(300, n_u, 3) for p, c in zip(plant, covariances, strict=True)
    ]
    step_t, w = np.linspace(0, 60, 121), np.geomspace(0.01, 3, 90)
    spread = np.stack([np.quantile(step(d, step_t), [0.025, 0.975], axis=0) for d in draws], axis=1)
    low, high = np.moveaxis(spread, -1, 1)
    response = [frequency(d, w) for d in draws]
    relative = np.stack([(np.std(r, axis=0) / np.abs(r.mean(axis=0))) for r in response])
    u, y = records[0][0] - 40, records[0][1] - 50
    settings = {"fs": 1 / H, "nperseg": 120}
    s_uu = np.stack([[csd(a, b, **settings)[1] for b in u.T] for a in u.T])[..., 1:30:2].transpose(2, 0, 1)
    s_uy = np.stack([[csd(a, b, **settings)[1] for b in y.T] for a in u.T])[..., 1:30:2].transpose(2, 0, 1)
    frequencies = 2 * np.pi * csd(u[:, 0], u[:, 0], **settings)[0][1:30:2]
    value = np.linalg.solve(s_uu, s_uy).transpose(0, 2, 1)
    return Curves(
        outputs=tuple(outputs),
        inputs=tuple(inputs),
        output_units=tuple(units[0]),
        input_units=tuple(units[1]),
        time_unit="min",
        step_t=step_t,
        step_model=np.moveaxis(step(model, step_t), -1, 0),
        step_plant=np.moveaxis(step(plant, step_t), -1, 0),
        step_low=low,
        step_high=high,
        w=w,
        bode_model=np.moveaxis(frequency(model, w), -1, 0),
        bode_plant=np.moveaxis(frequency(plant, w), -1, 0),
        bode_std=np.moveaxis(relative, -1, 0),
        band=tuple(tuple((0.02, 0.4) if a == b else (0.03, 0.2) for b in range(n_u)) for a in range(n_y)),
        np_w=frequencies,
        np_value=value,
        np_std=0.1 * np.abs(value) * (1 + frequencies[:, None, None]),
        np_label="spectral estimate",
        trends=(),
        residuals=(),
        condition_w=frequencies,
        condition=np.linalg.cond(s_uu),
    )


def _data(
    name: str, outputs: Sequence[str], inputs: Sequence[str], record: tuple[Array, Array, Array], t: Array
) -> ExperimentData:
    u, _, _ = record
    moves = (SignalExcitation(i, 12, float(std), (0.01, 1.0)) for i, std in zip(inputs, u.std(axis=0), strict=True))
    return ExperimentData(
        name=name,
        loop="open",
        samples=N,
        sample_time=H,
        start=None,
        span=(0.0, float(t[-1])),
        used=((0.0, 150.0), (158.5, float(t[-1]))),
        usable_share=dict.fromkeys(outputs, 0.98),
        saturated_share=dict.fromkeys(inputs, 0.0),
        excluded=(Exclusion(150.0, 158.5, "all", "excluded in the project file"),),
        findings=(DataFinding("saturated", inputs[0], "OP at its upper limit.", 12, False, None, ()),),
        refused=None,
        excitation=Excitation("inputs", len(inputs), tuple(moves), 3.5, ()),
    )


def _fit_row(output: str, trend: Trend, k: int) -> FitRow:
    y = trend.y[:, k]
    spread = np.linalg.norm(y - y.mean())
    model, plant = (float(100 * (1 - np.linalg.norm(y - p[:, k]) / spread)) for p in (trend.model, trend.plant))
    return FitRow(output, trend.name, model, plant)


def refused(curves: bool = False) -> Result:
    """One loop that was never moved; with curves: only the model's, everything else unknown."""
    full = sample(("level",), ("valve",), experiments=1) if curves else None
    element = Element(
        "level",
        "valve",
        "fopdt",
        "1.8 exp(-1 s)/(6 s + 1)",
        None,
        None,
        tuple(
            Parameter(n, "", v, None, None, None, None, None, None, False, "the input never moved")
            for n, v in zip(NAMES, (1.8, 6.0, 1.0), strict=True)
        ),
        "not identifiable",
        "The valve never moved by more than its resolution.",
        None,
        Importance(None, "open loop"),
        "D",
    )
    return Result(
        status="refused",
        reasons=(Reason(Code.NO_EXCITATION, "The valve never moved: step its set-point, record again.", "run_1.csv"),),
        provenance=Provenance("0.1.0", "project", "0" * 64, {}, {}, "min", 0, Settings("auto", 0.95, 0.0)),
        data=(),
        elements=(element,) if curves else (),
        curves=None if full is None or full.curves is None else _unanswered(full.curves),
    )


def _unanswered(curves: Curves) -> Curves:
    unknown = {k: np.full_like(getattr(curves, k), np.nan) for k in ("step_plant", "step_low", "step_high", "bode_std")}
    nowhere = {k: np.zeros((0, 1, 1)) for k in ("np_std",)}
    return dataclasses.replace(
        curves,
        **unknown,
        **nowhere,
        bode_plant=np.full_like(curves.bode_plant, np.nan),
        band=((None,),),
        np_w=np.zeros(0),
        np_value=np.zeros((0, 1, 1), dtype=complex),
        trends=tuple(dataclasses.replace(t, plant=np.full_like(t.plant, np.nan)) for t in curves.trends),
        residuals=(),
        condition_w=np.zeros(0),
        condition=np.zeros(0),
    )


LOOP = """
time_unit = "min"
data = {files = ["record.csv"], time = "t"}
output = [{name = "top_temperature", pv = "pv1", sp = "sp1", unit = "degC"}]
input = [{name = "reflux", op = "op1", unit = "%"}]
model = [{output = "top_temperature", input = "reflux", tf = "2 exp(-3 s)/(8 s + 1)"}]
controller = [{input = "reflux", output = "top_temperature", Kc = 0.6, Ti = 8.0, sample_time = 0.5}]

[robustness]
wI = {gain_percent = 15, dead_time = 0.4}
wP = {bandwidth = 0.04}

[tuning]
methods = ["certain-share", "simc"]

[simulate]
plant = [{output = "top_temperature", input = "reflux", tf = "3 exp(-3 s)/(7 s + 1)"}]
duration = 400
sample_time = 0.5
noise = 0.1
setpoints = [
    {time = 20, output = "top_temperature", value = 2},
    {time = 120, output = "top_temperature", value = -1},
    {time = 240, output = "top_temperature", value = 1},
]
"""


def with_loop(folder: Path) -> Result:
    """One simulated loop whose plant has a gain half as large again, with weights and tuning declared."""
    from trueplant import Project
    from trueplant.project.simulation import as_file, simulate_record
    from trueplant.study.pipeline import analyse

    project = Project.from_toml(LOOP, folder)
    (folder / "record.csv").write_bytes(as_file(simulate_record(project), "record.csv"))
    return analyse(project)
