"""Continuous-time estimators of polynomial elements: equation error, SRIVC, RIVC, CLSRIVC, two-stage."""

from trueplant.identify.instrumental.choice import OrderChoice, choose_orders
from trueplant.identify.instrumental.closed_loop import clsrivc, two_stage
from trueplant.identify.instrumental.noise import ArmaNoise
from trueplant.identify.instrumental.open_loop import rivc, srivc, state_variable_filter
from trueplant.identify.instrumental.order import Order
from trueplant.identify.instrumental.result import PolynomialFit

__all__ = [
    "ArmaNoise",
    "Order",
    "OrderChoice",
    "PolynomialFit",
    "choose_orders",
    "clsrivc",
    "rivc",
    "srivc",
    "state_variable_filter",
    "two_stage",
]
