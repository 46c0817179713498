"""What a structure that a search found leaves open: that the element has one more lag and one more lead.

Whether the structure that the record asks for is the plant's nobody knows. What moves slower than the record lasts
bends PV a little and says next to nothing of where PV would settle, and a structure that bends it as well says that
for sure. So a row counts besides what it would say if the element had a further lag and lead, somewhere near its own
lag, by the odds that it has: the ratio of marginal likelihoods (Laplace's approximation: Kass and Raftery 1995).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from scipy.special import softmax

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import of_a_part
from trueplant.identify.estimate import free_of_noise
from trueplant.identify.fit import RowFit, fit_row
from trueplant.identify.kept_structures import Told, counting
from trueplant.identify.likelihood import rise, with_element, with_parameters
from trueplant.identify.minima import distinct
from trueplant.identify.output import OutputEstimate
from trueplant.identify.row import Spec


def with_further_lags(estimate: OutputEstimate, columns: Collection[int], confidence: float) -> OutputEstimate:
    """The estimate, no surer than a further lag and lead of each of the elements in these columns lets it be."""
    fit = of_a_part(estimate.fit)
    for m, spec in enumerate(fit.row.specs):
        if spec.column in columns and (fits := distinct(further(fit, m))):
            shares = softmax([0.0, *(log_odds(one, fit, m) for one in fits)])
            own, *richer = (Told.of(one.row, one.theta, one.covariance) for one in (fit, *fits))
            estimate = counting(estimate, own, richer, shares[1:], confidence)
    return estimate


def further(fit: RowFit, m: int) -> list[RowFit]:
    """Fits of the row with a further lag and lead of element m, about the lag that it has, from several starts."""
    spec = fit.row.specs[m]
    structure, p = spec.structure, fit.theta[fit.row.slices[m]]
    lag = structure.lag(p)
    if lag <= 0 or free_of_noise(fit):
        return []
    wanted = replace(structure, lags=structure.lags + 1, leads=structure.leads + 1)

    def cancelled(further: float) -> Array:
        """The element as it is."""
        lags, leads = np.append(p[structure.is_lag], further), np.append(p[structure.is_lead], further)
        pairs = p[structure.is_frequency], p[structure.is_damping]
        return wanted.parameters(p[structure.is_gain], lags, *pairs, leads, p[structure.is_dead_time])

    about, stated = cancelled(lag), np.zeros(p.size + 2, dtype=bool)
    stated[[np.flatnonzero(wanted.is_lag)[-1], np.flatnonzero(wanted.is_lead)[-1]]] = True
    if spec.initial is not None:
        about[wanted.is_gain] = np.array(spec.initial)[structure.is_gain]
        stated[wanted.is_gain] = ~np.isin(np.flatnonzero(structure.is_gain), spec.undeclared)
    undeclared = tuple(int(k) for k in np.flatnonzero(~stated))
    other = Spec(spec.column, wanted, tuple(float(x) for x in about), undeclared)
    row, free = with_element(fit, m, other)

    def fitted(start: Array) -> RowFit:
        theta = np.clip(with_parameters(fit, m, start), *row.bounds())
        return fit_row(row, theta, fit.ar, weights=fit.weights, free=free, reweight=False)

    return [fitted(cancelled(share * lag)) for share in levels.SECOND_LAGS]


def log_odds(richer: RowFit, fit: RowFit, m: int) -> float:
    """That element m has the further lag and lead of `richer`, at even odds before the record is looked at.

    By what they explain beyond what their initial states would by chance, and by how much the record narrows them.
    """
    structure, first = richer.row.specs[m].structure, richer.row.slices[m].start
    new = first + np.array([np.flatnonzero(mask)[-1] for mask in (structure.is_lag, structure.is_lead)])
    stated = richer.row.prior.normal_equations(richer.theta)[0][new]
    narrowed = -np.linalg.slogdet(richer.covariance[np.ix_(new, new)])[1] - np.log(stated).sum()
    states = richer.row.nuisance_count - fit.row.nuisance_count
    return float(rise(richer, fit) - states - narrowed) / 2
