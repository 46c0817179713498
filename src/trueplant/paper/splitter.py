"""Section 4, what follows from its printed models alone: stability, margins, error model, Table 4, what 20 % means."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import SignConflict
from trueplant.identify import equation_error
from trueplant.loop import PID, Controller, check_loop, simulate, unstable_poles
from trueplant.lti import TransferMatrix, sampled_response
from trueplant.lti.structure import structure_of
from trueplant.paper import levels
from trueplant.paper.entry import Entry, rounded, shown
from trueplant.paper.records import ELEMENTS
from trueplant.plants import splitter
from trueplant.robust import margins

CALCULATED = TransferMatrix.of(
    [["-0.677/(10.40 s + 1)", "4.65 exp(-3 s)/(15.87 s + 1)"], ["0", "3.81 exp(-0.5 s)/(2.96 s + 1)"]], "min"
)
"""(48)"""
TABLE_4 = {
    "gain": ("16.7 %", "16.3 %", "0.3 %"),
    "tau": ("4.0 %", "5.8 %", "5.7 %"),
    "delay": (None, "0 %", "0 %"),
}
"""As printed, for the elements (1, 1), (1, 2) and (2, 2)."""
TOP, VAPORISATION = PID(Kc=1.0, Ti=8.0, Td=0.5, alpha=0.1), PID(Kc=0.5, Ti=2.0)
"""Table 2 as printed, (38)."""
FINE, LONG = 0.005, 60_000
"""Step (min) and length of the record from which the error model of loop 1 is taken."""


def splitter_section() -> list[Entry]:
    """Compute what needs no record of section 4."""
    case = splitter()
    assert case.plant is not None
    return [
        *_signs(case.plant),
        *_changes(case.model, case.plant),
        *_error_model(case.model, case.plant),
        *_table_4(case.plant),
    ]


def _one_loop(matrix: TransferMatrix, k: int) -> TransferMatrix:
    return TransferMatrix(((matrix[k, k],),), matrix.time_unit)


def _law(pid: PID) -> tuple[Array, Array]:
    """Numerator and denominator of (38)."""
    kp, ki, kd, tf = pid.parallel
    den = np.array([tf, 1.0, 0.0])
    return np.array([kp * tf + kd, kp + ki * tf, ki]), den


def _signs(plant: TransferMatrix) -> Iterator[Entry]:
    """Table 2 and the loop of Fig. 1 together."""
    top = _one_loop(plant, 0)
    num, den = _law(TOP)
    g = top[0, 0].terms[0]
    poles = np.roots(np.polyadd(np.polymul(g.den, den), np.polymul(g.num, num)))
    worst = float(poles.real.max())
    count = unstable_poles(top, Controller.diagonal([TOP]))
    try:
        check_loop(top, Controller.diagonal([TOP]))
        said = "nothing"
    except SignConflict as error:
        said = str(error)
    yield Entry(
        "splitter.loop1.stable_as_printed",
        "the top temperature loop is stable with Kc = +1 (Table 2) in u = Q (r - y) (4)",
        "in operation, hence stable",
        bool(count == 0),
        bool(count == 0),
        f"{count} unstable pole, at {worst:+.3f} per min: the gain of (40)'s element (1, 1) is negative, so the "
        f"controller "
        f"must be direct acting, Kc = -1 in (4). This program says of it: {said}",
    )
    yield shown(
        "splitter.loop1.pole", "its rightmost closed-loop pole (per min)", worst, "from the characteristic polynomial"
    )
    direct = Controller.diagonal([replace(TOP, action="direct"), VAPORISATION])
    stable = unstable_poles(plant, direct) == 0
    yield Entry(
        "splitter.stable_direct",
        "both loops together are stable with the top temperature's controller direct acting",
        "in operation, hence stable",
        stable,
        stable,
        "plant (40), dead time exact, by the argument principle",
    )
    own = margins(_one_loop(plant, 1), Controller.diagonal([VAPORISATION]))
    for key, what, value in (
        ("gm", "gain margin", own.gain_margin),
        ("pm", "phase margin (deg)", own.phase_margin),
        ("ms", "peak of the sensitivity", own.Ms),
    ):
        yield shown(
            f"splitter.loop2.{key}", f"{what} of the vaporisation loop with (40) and Table 2", value, "continuous"
        )
    first = margins(top, Controller.diagonal([replace(TOP, action="direct")]))
    yield shown(
        "splitter.loop1.ms",
        "peak of the sensitivity of the top temperature loop, direct acting",
        first.Ms,
        "continuous",
    )


def _changes(model: TransferMatrix, plant: TransferMatrix) -> Iterator[Entry]:
    """20 % of what?"""
    old, new = (np.array([structure_of(m[0, j])[1][:2] for j in (0, 1)]) for m in (model, plant))
    for k, name in enumerate(("gain", "tau")):
        of_model, of_plant = (100 * (new - old)[:, k] / x[:, k] for x in (old, new))
        for base, change, note in (
            ("model", of_model, "relative to the original model, which is how the change is told"),
            ("plant", of_plant, "relative to the new plant: this is what the 20 % is"),
        ):
            size = float(np.abs(change).mean())
            yield rounded(
                f"splitter.change.{name}.of_{base}",
                f"size of the change of {'gain' if name == 'gain' else 'time constant'} of (1, 1) and (1, 2) in % "
                f"of the {base}",
                "20 %",
                size,
                f"{note}; by element {change[0]:+.1f} % and {change[1]:+.1f} %",
            )


def _error_model(model: TransferMatrix, plant: TransferMatrix) -> Iterator[Entry]:
    """e_Mr of loop 1, which has no dead time: exactly, and by equation error from a record without noise."""
    num, den = _law(replace(TOP, action="direct"))
    g, ghat = plant[0, 0].terms[0], model[0, 0].terms[0]
    delta = np.polysub(np.polymul(g.num, ghat.den), np.polymul(ghat.num, g.den))
    above = np.polymul(delta, num)
    below = np.polymul(ghat.den, np.polyadd(np.polymul(g.den, den), np.polymul(g.num, num)))
    above, below = above / below[0], below / below[0]
    zeros, poles = np.sort(np.roots(above).real), np.sort_complex(np.roots(below))
    yield shown(
        "splitter.error_model.loop1",
        "e_Mr = Delta Q/(1 + G Q) of loop 1, (43): zeros, poles and gain",
        {
            "zeros": [float(z) for z in zeros],
            "poles_real": [float(p.real) for p in poles],
            "poles_imaginary": [float(p.imag) for p in poles],
            "gain": float(above[-1] / below[-1]),
        },
        "per min; 3 zeros and 4 poles. The paper gives no orders for its fit",
    )
    r = np.zeros((LONG, 1))
    for k, first in enumerate((2_000, 22_000, 42_000)):
        r[first:] = (k + 1) % 2
    law = Controller.diagonal([replace(TOP, action="direct")])
    run = simulate(_one_loop(plant, 0), law, r, FINE)
    e = run.y - sampled_response(_one_loop(model, 0), run.u, FINE)
    b, a = equation_error(run.r, e[:, 0], FINE, 4, 3, 0.3)
    s = 1j * np.geomspace(0.01, 2.0, 50)
    exact = np.polyval(above, s) / np.polyval(below, s)
    off = float(np.max(np.abs(np.polyval(b[0], s) / np.polyval(a, s) - exact)) / np.max(np.abs(exact)))
    yield Entry(
        "eq43.loop1",
        "e_Mr of loop 1 by the equation error (43)-(47) from a record without noise",
        "B0/A0 supplies e r^-1",
        off,
        off < levels.TRANSFER_ERROR,
        f"largest error from 0.01 to 2 rad/min relative to the peak of |e_Mr|; simulated, h = {FINE:g} min, "
        f"{LONG * FINE:g} min, lambda = 0.3 per min; tolerance: 1 %. With noise it is biased: see the paper's "
        f"route below",
    )


def _table_4(plant: TransferMatrix) -> Iterator[Entry]:
    """The printed models' own arithmetic, (48) against (40)."""
    for k, (i, j) in enumerate(ELEMENTS):
        old, new = structure_of(plant[i, j])[1], structure_of(CALCULATED[i, j])[1]
        for m, (name, what) in enumerate((("gain", "gain"), ("tau", "time constant"), ("delay", "dead time"))):
            printed = TABLE_4[name][k]
            if printed is None:
                continue
            note = "|(48) - (40)| in % of (40)"
            if name == "delay":
                note += ". The dead times of (48) are those of (40) exactly: they were kept, not estimated"
            yield rounded(
                f"table4.{name}{i + 1}{j + 1}",
                f"difference of {what} between (48) and (40), element ({i + 1}, {j + 1})",
                printed,
                float(100 * abs(new[m] / old[m] - 1)),
                note,
            )
