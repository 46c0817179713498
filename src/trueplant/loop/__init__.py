"""Controllers, closed-loop frequency functions and the simulator of the loop in time."""

from trueplant.loop.controller import Controller
from trueplant.loop.pid import PID, Linear
from trueplant.loop.signals import alternating_steps, ar1, arma, drift, random_steps, step_disturbance
from trueplant.loop.simulate import Simulation, replay, simulate

__all__ = [
    "PID",
    "Controller",
    "Linear",
    "Simulation",
    "alternating_steps",
    "ar1",
    "arma",
    "drift",
    "random_steps",
    "replay",
    "simulate",
    "step_disturbance",
]
