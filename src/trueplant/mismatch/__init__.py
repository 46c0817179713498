"""Mismatch between plant and model from closed-loop data: the expressions (17)-(20), and their use on records."""

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
from trueplant.mismatch.sampling import hold_response, sampled_frequency_response

__all__ = [
    "Mismatch",
    "closed_form",
    "closed_form_covariance",
    "consistency",
    "hold_response",
    "joint",
    "over_controller",
    "plant_covariance",
    "sampled_frequency_response",
    "standard_errors",
]
