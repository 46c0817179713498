"""Controllers, closed-loop frequency functions and the simulator of the loop in time."""

from trueplant.loop.closed import LoopFunctions, check_loop, complementary, loop_functions, sensitivity
from trueplant.loop.controller import Controller
from trueplant.loop.linear import LinearLoop
from trueplant.loop.loads import Coloured, Filtered, Load, Ramp, RandomWalk, Step
from trueplant.loop.parts import Kind, Part, Sum, law_parts
from trueplant.loop.pid import PID, Linear
from trueplant.loop.signals import alternating_steps, ar1, arma, drift, random_steps, step_disturbance
from trueplant.loop.simulate import Simulation, replay, simulate
from trueplant.loop.stability import unstable_poles
from trueplant.loop.valve import Valve

__all__ = [
    "PID",
    "Coloured",
    "Controller",
    "Filtered",
    "Kind",
    "Linear",
    "LinearLoop",
    "Load",
    "LoopFunctions",
    "Part",
    "Ramp",
    "RandomWalk",
    "Simulation",
    "Step",
    "Sum",
    "Valve",
    "alternating_steps",
    "ar1",
    "arma",
    "check_loop",
    "complementary",
    "drift",
    "law_parts",
    "loop_functions",
    "random_steps",
    "replay",
    "sensitivity",
    "simulate",
    "step_disturbance",
    "unstable_poles",
]
