"""Mismatch between plant and model from closed-loop data: the expressions (17)-(20), and their use on records."""

from trueplant.mismatch.coherence import Coherence, coherence
from trueplant.mismatch.estimate import LocalFit, fit_locally
from trueplant.mismatch.expressions import (
    Mismatch,
    closed_form,
    closed_form_covariance,
    consistency,
    joint,
    over_controller,
    plant_covariance,
    standard_errors,
)
from trueplant.mismatch.local import FrequencyResponse, local_response, speaking_band
from trueplant.mismatch.periodic import period_of, periodic_response
from trueplant.mismatch.reduction import fit_structure
from trueplant.mismatch.sampling import hold_response, sampled_frequency_response

__all__ = [
    "Coherence",
    "FrequencyResponse",
    "LocalFit",
    "Mismatch",
    "closed_form",
    "closed_form_covariance",
    "coherence",
    "consistency",
    "fit_locally",
    "fit_structure",
    "hold_response",
    "joint",
    "local_response",
    "over_controller",
    "period_of",
    "periodic_response",
    "plant_covariance",
    "sampled_frequency_response",
    "speaking_band",
    "standard_errors",
]
