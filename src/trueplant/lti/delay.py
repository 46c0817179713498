"""Dead time and lags of an element as one delay: how late it answers to what is slow, or at a frequency."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array
from trueplant.lti.structure import Structure


def total_delay(structure: Structure, p: Array, w: float) -> tuple[float, Array]:
    """-d phase/d w at a frequency w (rad per time unit), and its derivative (n,) by the parameters p (n,).

    It is -Re(d ln G/ds) at s = jw. Towards w = 0: lags and dead times less leads, of several delayed terms the mean
    of the dead times weighted by the gains; an integrator, which only turns the phase, has no part in it.
    """
    s, out = 1j * w, np.zeros(len(p), dtype=complex)
    lags, leads = p[structure.is_lag], p[structure.is_lead]
    value = np.sum(lags / (lags * s + 1)) - np.sum(leads / (leads * s + 1))
    out[structure.is_lag], out[structure.is_lead] = 1 / (lags * s + 1) ** 2, -1 / (leads * s + 1) ** 2
    omega, zeta = p[structure.is_frequency], p[structure.is_damping]
    # of a pair, d ln D/ds = slope/D with D = (s/omega)^2 + 2 zeta s/omega + 1
    pair, slope = (s / omega) ** 2 + 2 * zeta * s / omega + 1, 2 * (s / omega + zeta) / omega
    value += np.sum(slope / pair)
    by_omega = -2 * (2 * s / omega + zeta) / omega**2, -2 * s * (s / omega + zeta) / omega**2
    out[structure.is_frequency] = (by_omega[0] * pair - slope * by_omega[1]) / pair**2
    out[structure.is_damping] = (2 / omega * pair - slope * 2 * s / omega) / pair**2
    gains, dead = p[structure.is_gain], structure.dead_times(p)
    term = np.exp(-(dead - dead[0]) * s)
    late = np.sum(dead * gains * term) / np.sum(gains * term)
    out[structure.is_gain] = term * (dead - late) / np.sum(gains * term)
    if structure.has_dead_time:
        out[structure.is_dead_time] = gains * term * (1 - (dead - late) * s) / np.sum(gains * term)
    return float(np.real(value + late)), np.real(out)


def phase(structure: Structure, p: Array, w: float) -> float:
    """Of G(jw) in rad: with all turns that lags, dead times and integrators make on the way there from w = 0.

    That of a negative gain begins at pi.
    """
    s, dead = 1j * w, structure.dead_times(p)
    gain = np.sum(p[structure.is_gain] * np.exp(-(dead - dead[0]) * s))
    omega, zeta = p[structure.is_frequency], p[structure.is_damping]
    turned = np.sum(np.arctan(p[structure.is_lead] * w)) - np.sum(np.arctan(p[structure.is_lag] * w))
    turned -= np.sum(np.angle((s / omega) ** 2 + 2 * zeta * s / omega + 1))
    return float(np.angle(gain) + turned - structure.integrators * np.pi / 2 - dead[0] * w)
