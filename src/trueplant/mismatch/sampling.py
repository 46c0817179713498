"""What samples of u and y are related by: the response of a plant between held inputs and sampled outputs.

With z = e^(jwh), the transform of the samples of y is G_d(z) times that of the samples of u. G_d is the sum of
G H over all aliases, H being the hold; it is computed here without that sum, from the exact recursion.
"""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import FormulaError
from trueplant.lti.sampled import discretise, flags_of, realise, split_dead_time
from trueplant.lti.transfer import TransferFunction, TransferMatrix


def hold_response(w: Array, h: float, hold: str = "zoh") -> ComplexArray:
    """Transform (n_w,) of the hold over one sample, relative to the sample: 1 at w = 0."""
    x = np.asarray(w, dtype=float) * h / 2
    sinc = np.sinc(x / np.pi)
    if hold == "linear":
        return (sinc**2).astype(complex)
    if hold not in ("zoh", "written"):
        raise FormulaError(f'hold must be "zoh", "linear" or "written", not {hold!r}')
    value: ComplexArray = sinc * np.exp(-1j * x)
    return value


def rows_frequency_response(
    num: Array, den: Array, dead_time: float, w: Array, h: float, hold: str = "zoh"
) -> ComplexArray:
    """Sampled responses (n_w, m) of m numerators (m, n + 1) over one monic denominator (n + 1,)."""
    linear, written = flags_of(hold)
    a, b, c, d = realise(np.ascontiguousarray(num, dtype=float), np.ascontiguousarray(den, dtype=float))
    q, phi = split_dead_time(dead_time, h)
    z = np.exp(1j * w * h)
    direct = ((1 - phi) + phi / z) if linear else (1 / z if phi > 0 or written else np.ones_like(z))
    value = direct[:, None] * d[None, :]
    if a.size:
        ad, taps = discretise(a, b, h, phi, linear)
        drive = taps[0] * z[:, None] + taps[1] + taps[2] / z[:, None]
        state = np.linalg.solve(z[:, None, None] * np.eye(ad.shape[0]) - ad, drive[:, :, None])[:, :, 0]
        value = value + state @ c.T
    delayed: ComplexArray = value * np.exp(-1j * q * h * w)[:, None]
    return delayed


def sampled_frequency_response(
    G: TransferFunction | TransferMatrix, w: Array, h: float, hold: str | tuple[str, ...] = "zoh"
) -> ComplexArray:
    """Exact response between samples of the held input and samples of the output, at w (n_w,) rad per time unit.

    (n_w,) for a transfer function, (n_w, n_y, n_u) for a matrix. Dead times may be any fraction of h; `hold` is
    "zoh", "linear" or "written" (`sampled_response`), one for all inputs or one each. A plant with integral action is
    infinite at w = 0: begin above it.

    Raises FormulaError for improper systems.
    """
    w = np.atleast_1d(np.asarray(w, dtype=float))
    if isinstance(G, TransferMatrix):
        n_y, n_u = G.shape
        holds = (hold,) * n_u if isinstance(hold, str) else hold
        value = np.zeros((w.size, n_y, n_u), dtype=complex)
        for i in range(n_y):
            for j in range(n_u):
                if not G[i, j].is_zero:
                    value[:, i, j] = sampled_frequency_response(G[i, j], w, h, holds[j])
        return value
    one = hold if isinstance(hold, str) else hold[0]
    total = np.zeros(w.size, dtype=complex)
    for term in G.terms:
        if not term.is_proper:
            raise FormulaError(f"{G} is improper: it has no response to a held input; add a lag")
        num = np.zeros((1, len(term.den)))
        num[0, len(term.den) - len(term.num) :] = term.num
        total += rows_frequency_response(num, np.array(term.den), term.dead_time, w, h, one)[:, 0]
    return total
