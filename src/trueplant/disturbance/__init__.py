"""Unmeasured disturbances: their models, the plant estimated along with them, and what they were."""

from trueplant.disturbance.fit import DisturbedFit, fit_with_disturbance, likelihood_p
from trueplant.disturbance.models import Part
from trueplant.disturbance.noise import Noise
from trueplant.disturbance.recover import Recovered, recover

__all__ = ["DisturbedFit", "Noise", "Part", "Recovered", "fit_with_disturbance", "likelihood_p", "recover"]
