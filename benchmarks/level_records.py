"""The records of `bench_levels.py`: small, simulated, and together through every part of an analysis.

Each is made from its seed alone. A name says what the record has; K = 2, lag 10 min, dead time 3.3 min and a PI with
h = 1 min, where nothing else is said.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.changing import changing_loop
from support.laws import Law, Loop
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching
from trueplant.loop import PID, Controller, Simulation, Step, Valve, alternating_steps, simulate
from trueplant.lti import TransferMatrix, to_formula
from trueplant.lti.sampled import sampled_response
from trueplant.project import Project

Array = np.ndarray
Frame = dict[str, Array]
Made = tuple[Project, list[Any]]
TF = "2 exp(-3.3 s)/(10 s + 1)"
ONE = TransferMatrix.of([[TF]], "min")
PI = {"Kc": 0.66, "Ti": 10.0, "sample_time": 1.0}
LAW = Controller.diagonal([PID(**PI)])
FEED = "1.5 exp(-2.3 s)/(6 s + 1)"


def ar(rng: np.random.Generator, n: int, std: float = 0.1, columns: int = 1) -> Array:
    return coloured(rng, n, columns, [1, -0.8], [1], std)


def moves(rng: np.random.Generator, n: int) -> Array:
    return random_switching(rng, n, 1, 40.0)


def one(seed: int, n: int = 800, plant: TransferMatrix = ONE, law: Controller = LAW, **given: Any) -> Simulation:
    """The one loop; `given` goes to the simulation in place of an AR(1) disturbance of 0.1."""
    rng = np.random.default_rng(seed)
    r = given.pop("r", None)
    r = moves(rng, n) if r is None else r
    return simulate(plant, law, r, 1.0, **({"v": ar(rng, n)} | given))


def columns(sim: Simulation, keep: slice = slice(None)) -> Frame:
    frame = {"t": sim.t[keep]}
    for k in range(sim.y.shape[1]):
        frame |= {f"sp{k}": sim.r[keep, k], f"op{k}": sim.u[keep, k], f"pv{k}": sim.y[keep, k]}
    return frame


def loop(frames: list[Frame], tf: str | None = TF, law: dict[str, float] | None = PI, **tables: Any) -> Made:
    """One loop as a project; `tables` go over those that it would have."""
    files = [f"run {k}" for k in range(len(frames))]
    made = {
        "time_unit": "min",
        "data": {"files": files, "time": "t"},
        "output": [{"name": "y", "pv": "pv0", "sp": "sp0", "limits": [-40, 40], "span": [-40, 40]}],
        "input": [{"name": "u", "op": "op0"} | tables.pop("of_input", {})],
        "model": [{"output": "y", "input": "u", "tf": tf}] if tf else [],
        "controller": [{"input": "u", "output": "y", **law}] if law else [],
    }
    return Project(**{k: v for k, v in (made | tables).items() if v != []}), frames


def plain() -> Made:
    return loop([columns(one(1))])


def changed() -> Made:
    """Gain 30 % higher than the model's; other settings are asked for."""
    sim = one(2, plant=TransferMatrix.of([["2.6 exp(-3.3 s)/(10 s + 1)"]], "min"))
    return loop([columns(sim)], tuning={"methods": ["improved-simc", "certain-share"]})


def a_little() -> Made:
    """Gain 8 % higher than the model's, at the edge of what the record tells."""
    return loop([columns(one(3, plant=TransferMatrix.of([["2.16 exp(-3.3 s)/(10 s + 1)"]], "min")))])


def backlash() -> Made:
    v = ar(np.random.default_rng(4), 800, 0.03)
    band = 0.04 * float(np.ptp(one(4, v=v).u))
    return loop([columns(one(4, v=v, valves=[Valve(backlash=band)]))])


def loads() -> Made:
    return loop([columns(one(5, input_disturbance=[Step(250.0, (0.6,)), Step(560.0, (-0.8,))]))])


def walk() -> Made:
    rng = np.random.default_rng(6)
    return loop([columns(one(6, v=0.05 * np.cumsum(rng.standard_normal((800, 1)), axis=0)))])


def level() -> Made:
    """A vessel: an integrator."""
    tf, law = "0.1 exp(-2 s)/s", {"Kc": 1.5, "Ti": 30.0, "sample_time": 1.0}
    sim = one(7, plant=TransferMatrix.of([[tf]], "min"), law=Controller.diagonal([PID(**law)]))
    return loop([columns(sim)], tf, law)


def structure() -> Made:
    """Declared first order; inverse response in truth."""
    plant = TransferMatrix.of([["2 (1 - 4 s) exp(-1 s)/((12 s + 1)(5 s + 1))"]], "min")
    law = {"Kc": 0.4, "Ti": 15.0, "sample_time": 1.0}
    sim = one(8, plant=plant, law=Controller.diagonal([PID(**law)]))
    return loop([columns(sim)], "2 exp(-8 s)/(13 s + 1)", law)


def rare() -> Made:
    """Two steps of the set-point in the whole record, and much noise."""
    at = np.arange(800)[:, None]
    sim = one(9, r=1.0 * ((at >= 200) & (at < 500)), v=ar(np.random.default_rng(9), 800, 0.2))
    return loop([columns(sim)])


def two_by_two() -> Made:
    """Wood-Berry, one gain 30 % higher, disturbances correlated over the outputs."""
    rng = np.random.default_rng(10)
    rows = [list(row) for row in WOOD_BERRY.elements]
    rows[1][0] = rows[1][0] * 1.3
    r, v = random_switching(rng, 700, 2, 20.0), ar(rng, 700, 0.3, 2)
    v[:, 1] += 1.5 * np.concatenate([[0.0, 0.0], v[:-2, 0]])
    sim = simulate(TransferMatrix.of(rows, "min"), BLT, r, 1.0, v=v)
    names = ("top", "bottom")
    model = [
        {"output": names[i], "input": f"u{j}", "tf": to_formula(WOOD_BERRY[i, j], 12)}
        for i in range(2)
        for j in range(2)
    ]
    laws = ({"Kc": 0.375, "Ti": 8.29}, {"Kc": -0.0754, "Ti": 23.6})
    project = Project(
        time_unit="min",
        data={"files": ["run"], "time": "t"},
        output=[{"name": name, "pv": f"pv{k}", "sp": f"sp{k}"} for k, name in enumerate(names)],
        input=[{"name": f"u{k}", "op": f"op{k}"} for k in range(2)],
        model=model,
        controller=[{"input": f"u{k}", "output": name, "sample_time": 1.0, **laws[k]} for k, name in enumerate(names)],
    )
    return project, [columns(sim)]


def two_runs() -> Made:
    """Two step tests of a rig whose gain is 15 % higher in the second."""
    higher = TransferMatrix.of([["2.3 exp(-3.3 s)/(10 s + 1)"]], "min")
    return loop([columns(one(11, 500)), columns(one(12, 500, higher))])


def first_model() -> Made:
    return loop([columns(one(13))], tf=None)


def halfway() -> Made:
    """The gain rises by 40 % halfway."""
    rng = np.random.default_rng(14)
    gain = 2 * np.where(np.arange(1000) < 500, 1.0, 1.4)
    return loop([columns(changing_loop(ONE, LAW, moves(rng, 1000), ar(rng, 1000), (0, 0), gain, 10.0, 3.3))])


def louder() -> Made:
    """The disturbance doubles halfway."""
    v = ar(np.random.default_rng(15), 1000) * np.where(np.arange(1000) < 500, 1.0, 2.0)[:, None]
    return loop([columns(one(15, 1000, v=v))])


def law(**declared: float) -> Made:
    """A PI with OP at its limits, two manual stretches, a few wrong samples."""
    made = Loop(Law(Kc=2.0, Ti=40.0), gain=1.2, limits=(42.0, 60.0), manual=((700, 900),), bad=0.0025, seed=3)
    return made.project(**declared), [made.record()]


def cascade() -> Made:
    """A slave with a lag of 6 s below a PI master."""
    rng = np.random.default_rng(16)
    n, a, c = 1500, np.exp(-1 / 30.0), np.exp(-1 / 6.0)
    r = random_switching(rng, n, 1, 120.0)[:, 0]
    pv, op, slave = 0.02 * rng.standard_normal(n), np.zeros(n), np.zeros(n)
    x = integral = 0.0
    for k in range(n):
        slave[k] = c * slave[k - 1] + (1 - c) * op[k - 1] if k else 0.0
        x = a * x + 2 * (1 - a) * (slave[k - 5] if k > 4 else 0.0)
        pv[k] += x
        integral += 0.05 * (r[k] - pv[k])
        op[k] = 1.5 * (r[k] - pv[k]) + integral
    measured = slave + 0.005 * rng.standard_normal(n)
    frame = {"t": np.arange(n, dtype=float), "sp0": r, "op0": op, "pv0": pv, "fsp": op, "fpv": measured}
    more = {"slave_sp": "fsp", "slave_pv": "fpv"}
    return loop([frame], "2 exp(-4 s)/(30 s + 1)", {"Kc": 1.5, "Ti": 30.0, "sample_time": 1.0}, of_input=more)


def computed() -> Made:
    """A set-point that is computed from PV, beside rare moves of an operator."""
    rng = np.random.default_rng(17)
    n, pole = 900, np.exp(-0.1)
    v, r, u, y = ar(rng, n, 1.0)[:, 0], np.zeros(n), np.zeros(n), np.zeros(n)
    x = integral = 0.0
    for k in range(n):
        y[k] = x + v[k]
        r[k] = -0.3 * y[k]
        integral += 0.08 * (r[k] - y[k])
        u[k] = 0.8 * (r[k] - y[k]) + integral
        x = pole * x + 2 * (1 - pole) * (u[k - 3] if k > 2 else 0.0)
    return loop([{"t": np.arange(n, dtype=float), "sp0": r, "op0": u, "pv0": y}], law=None)


def still() -> Made:
    return loop([columns(one(18, 500, r=np.ones((500, 1))))])


def short() -> Made:
    """200 min that leave much open, and limits within which a test has to stay."""
    law = {"Kc": 0.8, "Ti": 12.0, "sample_time": 1.0}
    plant = TransferMatrix.of([["2 exp(-3 s)/(12 s + 1)"]], "min")
    r = 60 + alternating_steps(200, 1.0, 80.0, [1.0])
    sim = simulate(plant, Controller.diagonal([PID(**law)]), r, 1.0, noise=0.3, seed=3, u0=50.0, y0=60.0)
    output = [{"name": "y", "pv": "pv0", "sp": "sp0", "limits": [50, 70], "span": [0, 100]}]
    more = {"limits": [35, 65]}
    return loop([columns(sim)], "2 exp(-3 s)/(12 s + 1)", law, output=output, of_input=more)


def feed() -> Made:
    """A measured disturbance of which nobody says how it runs between its samples."""
    rng = np.random.default_rng(19)
    d = ar(rng, 800, 1.0)
    v = sampled_response(TransferMatrix.of([[FEED]], "min"), d, 1.0) + ar(rng, 800, 0.03)
    frame = columns(one(19, v=v)) | {"f": d[:, 0]}
    both = [{"output": "y", "input": "u", "tf": TF}, {"output": "y", "input": "feed", "tf": FEED}]
    return loop([frame], disturbance=[{"name": "feed", "column": "f"}], model=both)


def fine() -> Made:
    """15,000 samples at a fiftieth of the lag of 500."""
    tf, law = "2 exp(-160.3 s)/(500 s + 1)", {"Kc": 0.66, "Ti": 500.0, "sample_time": 1.0}
    r = random_switching(np.random.default_rng(20), 15_000, 1, 1500.0)
    v = coloured(np.random.default_rng(20), 15_000, 1, [1, -0.99], [1], 0.1)
    plant = TransferMatrix.of([[tf]], "min")
    return loop([columns(one(20, 15_000, plant, Controller.diagonal([PID(**law)]), r=r, v=v))], tf, law)


def every_fifth() -> Made:
    """Each fifth sample of a loop that runs five times as fast."""
    return loop([columns(one(21, 4000), slice(None, None, 5))])


def all_methods() -> Made:
    detectors = ["partial-correlation", "plant-model-ratio", "stepwise", "one-class"]
    return loop([columns(one(22, 600))], analysis={"method": "all", "detectors": detectors})


def open_loop() -> Made:
    """OP moved by hand, the first order in truth of second."""
    rng = np.random.default_rng(23)
    u = random_switching(rng, 600, 1, 60.0)
    y = sampled_response(ONE, u, 1.0) + ar(rng, 600, 0.3)
    frame = {"t": np.arange(600.0), "op0": u[:, 0], "pv0": y[:, 0]}
    output = [{"name": "y", "pv": "pv0"}]
    data = {"data": {"time": "t"}, "experiment": [{"file": "run 0", "loop": "open"}]}
    return loop([frame], law=None, output=output, **data)


RECORDS: dict[str, Callable[[], Made]] = {
    "plain": plain,
    "gain +30 %, retuned": changed,
    "gain +8 %": a_little,
    "backlash of 4 %": backlash,
    "load steps": loads,
    "random walk": walk,
    "level": level,
    "wrong structure": structure,
    "rare moves": rare,
    "2 x 2, correlated": two_by_two,
    "two runs": two_runs,
    "first model": first_model,
    "gain +40 % halfway": halfway,
    "noise doubles halfway": louder,
    "limits and manual": law,
    "wrong law": lambda: law(gain=1.1),
    "cascade": cascade,
    "computed set-point": computed,
    "no moves": still,
    "short, plan": short,
    "measured disturbance": feed,
    "finely sampled": fine,
    "every fifth sample": every_fifth,
    "all methods": all_methods,
    "open loop": open_loop,
}
WHOLE = {"short, plan", "all methods", "gain +30 %, retuned"}
"""These go through the whole of an analysis for the levels of every room; the others for those of `study` alone."""
FIRST = ("gain +8 %", "rare moves", "wrong structure")
"""These come before the others, whatever they cost: they are at the edge of what is said."""
