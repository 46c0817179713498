"""Valves that may not follow OP, as likelihood ratios count them. All records are simulated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from support.simulated import coloured, random_switching, segment_of
from support.valve_loop import PLANT, record
from trueplant.identify import identify_matrix, specs_of, with_open_valves
from trueplant.identify.likelihood import held_at
from trueplant.identify.open_valves import OutputByOutput, gain, likeliest
from trueplant.identify.valve_effects import behind
from trueplant.identify.valves import Tries, tries_of
from trueplant.loop import PID, Controller, Valve, simulate
from trueplant.lti import TransferMatrix
from trueplant.lti.sampled import sampled_response
from trueplant.lti.structure import structure_of
from trueplant.record.types import Segment


def test_a_likelihood_ratio_takes_no_valve_for_a_changed_plant():
    """16 simulated records, backlash of a tenth of OP's span that no search finds, unchanged plants: the ratio of one
    that takes OP at its word rejects the model in 14 at 5 %; with its bands open, in 4 with a chance of 0.7 %. A gain
    20 % off it still rejects in all at 1 %."""
    model, index = np.array([2.0, 10.0, 3.3]), np.arange(3)
    plain, open_bands, changed = [], [], []
    for seed in range(16):
        estimates = identify_matrix([record(seed, 0.1, std=0.5)[0]], PLANT, specs_of(PLANT))
        estimate = with_open_valves(estimates, {0: ()}, {})[0]
        plain.append(estimate.likelihood_ratio_p(index, model))
        open_bands.append(estimate.likelihood_ratio_p(index, model, doubting=True))
        changed.append(estimate.likelihood_ratio_p(index, model * [1.2, 1.0, 1.0], doubting=True))
    assert np.sum(np.less(plain, 0.05)) >= 10
    assert np.sum(np.less(open_bands, 0.05)) <= 3
    assert max(changed) < 0.01


def test_open_valves_gain_what_the_fit_behind_the_likeliest_gains():
    """Beside the model, where the noise model alone is free: all bands fitted one by one, 1 % apart."""
    fit = identify_matrix([record(1, 0.02, std=0.1)[0]], PLANT, specs_of(PLANT))[0].fit
    held = held_at(fit, np.arange(3), np.array([2.0, 10.0, 3.3]))
    span = float(np.ptp(fit.row.pieces[0].inputs[0]))
    coarse = tuple(Valve(backlash=share * span) for share in np.geomspace(0.005, 0.08, 20))
    falls = [
        held.deviance - behind(held, {0: Valve(backlash=w * span)}).deviance for w in np.geomspace(5e-3, 0.08, 280)
    ]
    gained = gain({0: fit}, {0: Tries((coarse,), (0.0, span))}, 0, held)
    assert gained == pytest.approx(max(falls), abs=0.3) and gained > 5
    assert gain({0: fit}, {0: Tries(((Valve(stick=span),),), (0.0, span))}, 0, held) == 0.0


def test_a_band_is_the_same_to_all_outputs_that_its_valve_moves():
    """One that another output rules out explains nothing of this one."""
    shown = identify_matrix([record(1, 0.02)[0]], PLANT, specs_of(PLANT))[0].fit
    other = identify_matrix([record(2, 0.05)[0]], PLANT, specs_of(PLANT))[0].fit
    span = float(np.ptp(shown.row.pieces[0].inputs[0]))
    bands = {0: Tries((tuple(Valve(backlash=share * span) for share in (0.02, 0.05)),), (0.0, span))}
    alone = [gain({0: fit}, bands, 0, fit) for fit in (shown, other)]
    every = {0: shown, 1: other}
    valve = likeliest(OutputByOutput.of(every), bands)
    both = sum(fit.deviance - behind(fit, valve).deviance for fit in (shown, other))
    assert min(alone) > 20
    assert gain(every, bands, 0, shown) == gain(every, bands, 1, other) == pytest.approx(both)
    assert both < sum(alone) - 20


def test_valves_of_several_inputs_are_placed_beside_each_other():
    """One output, two inputs, a band in each (simulated, open loop): both are found, and gain what the true ones do."""
    rng, samples = np.random.default_rng(3), 2000
    plant = TransferMatrix.of([["2 exp(-3.3 s)/(10 s + 1)", "-1.2 exp(-2 s)/(6 s + 1)"]], "min")
    walks = np.cumsum(rng.normal(size=(samples, 2)), axis=0) * 0.1
    op = walks - lfilter([0.02], [1, -0.98], walks, axis=0)
    true = {j: Valve(backlash=share * float(np.ptp(op[:, j]))) for j, share in enumerate((0.02, 0.03))}
    stems = np.column_stack([valve.positions(op[:, j]) for j, valve in true.items()])
    y = sampled_response(plant, stems, 1.0) + coloured(rng, samples, 1, [1, -0.8], [1], 0.02)
    whole, nothing = np.ones((samples, 1), dtype=bool), np.zeros((samples, 0))
    segment = Segment(0, 1.0, np.arange(samples) * 1.0, y, op, y, nothing, whole, ("zoh", "zoh"), closed=False)
    fit = identify_matrix([segment], plant, specs_of(plant))[0].fit
    bands = {j: tries_of(fit, j) for j in (0, 1)}
    found = likeliest(OutputByOutput.of({0: fit}), bands)
    assert {j: valve.backlash for j, valve in found.items()} == pytest.approx(
        {j: valve.backlash for j, valve in true.items()}, rel=0.2
    )
    least = fit.deviance - behind(fit, true).deviance
    alone = [fit.deviance - behind(fit, {j: true[j]}).deviance for j in (0, 1)]
    assert 20 < max(alone) < least - 20
    assert least - 1 < gain({0: fit}, bands, 0, fit) < least + 12


def related_record():
    """Two loops whose disturbances are correlated 0.95, each valve with backlash of 1 % (simulated), and the stems."""
    rng = np.random.default_rng(7)
    white = np.sqrt(0.95) * rng.normal(size=(2000, 1)) + np.sqrt(0.05) * rng.normal(size=(2000, 2))
    v = 0.03 * lfilter([1], [1, -0.8], white, axis=0)
    r, law = random_switching(rng, 2000, 2, 40.0), Controller.diagonal([PID(Kc=0.5, Ti=10.0, sample_time=1.0)] * 2)
    spans = np.ptp(simulate(TWO, law, r, 1.0, v=v).u, axis=0)
    true = {j: Valve(backlash=0.01 * float(span)) for j, span in enumerate(spans)}
    return segment_of(simulate(TWO, law, r, 1.0, v=v, valves=[*true.values()])), true


TWO = TransferMatrix.of(
    [["2 exp(-3 s)/(10 s + 1)", "0.6 exp(-4 s)/(8 s + 1)"], ["-0.5 exp(-5 s)/(12 s + 1)", "1.5 exp(-2 s)/(9 s + 1)"]],
    "min",
)


@pytest.fixture(scope="module")
def related():
    segment, true = related_record()
    return identify_matrix([segment], TWO, specs_of(TWO)), true


def test_valves_are_seen_by_the_likelihood_of_all_outputs_where_these_are_estimated_together(related):
    """What the others see of the disturbance no valve has to stand out from: the true bands gain several times as much,
    to first order as far as the fit behind them, and are found."""
    estimates, true = related
    end = estimates[0].rise.end
    gained = end.deviance - end.behind(true).deviance
    one_by_one = sum(e.fit.deviance - behind(e.fit, true).deviance for e in estimates.values())
    assert gained > 2 * one_by_one and gained > 30
    for column, valve in true.items():
        (promised,) = end.promised(column, [valve])
        assert promised == pytest.approx(end.deviance - end.behind({column: valve}).deviance, rel=0.1, abs=0.5)
    fit = estimates[0].fit
    bands = {j: tries_of(fit, j) for j in true}
    found = likeliest(end, bands)
    assert {j: valve.backlash for j, valve in found.items()} == pytest.approx(
        {j: valve.backlash for j, valve in true.items()}, rel=0.4
    )
    assert gained - 1 < gain({0: fit}, bands, 0, end) < gained + 12


def test_an_unchanged_plant_behind_valves_is_not_rejected_where_outputs_are_estimated_together(related):
    """Where OP is taken at its word one of four elements is, at 1e-6; with valves open none is. A gain 20 % off is."""
    estimates, _ = related
    there = with_open_valves(estimates, {0: (), 1: ()}, {})
    plain, doubting = [], []
    for i, estimate in there.items():
        for j, part in enumerate(estimate.row.slices):
            index, model = np.arange(part.start, part.stop), np.array(structure_of(TWO[i, j])[1])
            plain.append(estimate.likelihood_ratio_p(index, model))
            doubting.append(estimate.likelihood_ratio_p(index, model, doubting=True))
    assert min(plain) < 1e-4
    assert min(doubting) > 0.05
    index = np.arange(there[0].row.slices[0].stop)
    assert there[0].likelihood_ratio_p(index, np.array([2.4, 10.0, 3.0]), doubting=True) < 0.001


@pytest.mark.slow
def test_a_likelihood_ratio_with_open_valves_rejects_the_model_as_often_as_it_says():
    """40 simulated records each of an unchanged plant, of backlash and stick-slip of 1 % and of no valve: 5 % are 2."""
    model, index = np.array([2.0, 10.0, 3.3]), np.arange(3)
    for kind, share in (("backlash", 0.01), ("stick", 0.01), ("backlash", 0.0)):
        p = []
        for seed in range(40):
            estimates = identify_matrix([record(seed, share, kind)[0]], PLANT, specs_of(PLANT))
            p.append(with_open_valves(estimates, {0: ()}, {})[0].likelihood_ratio_p(index, model, doubting=True))
        assert np.sum(np.less(p, 0.05)) <= 5, (kind, share)
        assert np.sum(np.less(p, 0.5)) >= 8, (kind, share)
