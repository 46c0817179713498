"""Controllers as faceplates show them. What each has to be is worked out here by hand."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant import Project
from trueplant.errors import LoopError, ProjectError
from trueplant.tune.vendors import VENDORS, vendor_of

W = np.geomspace(1e-3, 10, 30)
PV_SPAN, OP_SPAN = (50.0, 250.0), (0.0, 80.0)
RATIO = 80 / 200
"""OP units for a PV unit where OP moves by as many per cent as PV."""


def project(time_unit: str = "min", spans: bool = True, **law: object) -> Project:
    span = {"span": list(PV_SPAN)} if spans else {}
    return Project(
        time_unit=time_unit,
        output=[{"name": "y", "pv": "pv", "sp": "sp", "limits": [0, 1000], **span}],
        input=[{"name": "u", "op": "op", "limits": [0, 100], **({"span": list(OP_SPAN)} if spans else {})}],
        model=[{"output": "y", "input": "u", "tf": "1.2 exp(-2 s)/(9 s + 1)"}],
        controller=[{"input": "u", "output": "y", **law}],
    )


def response(**said: object) -> np.ndarray:
    return project(**said).controller()(1j * W)[:, 0, 0]


def ideal(kc: float, ti: float, td: float = 0.0, alpha: float = 0.1) -> np.ndarray:
    s = 1j * W
    return kc * (1 + 1 / (ti * s) + td * s / (alpha * td * s + 1))


@pytest.mark.parametrize(
    ("law", "wanted"),
    [
        ({"PB": 50, "repeats_per_minute": 2}, (2 * RATIO, 0.5)),
        ({"PB": 150, "reset_seconds": 90}, (RATIO / 1.5, 1.5)),
        ({"gain": 2, "reset_minutes": 3}, (2, 3)),
        ({"gain": 2, "gain_unit": "percent of span", "reset_minutes": 3}, (2 * RATIO, 3)),
        ({"gain": 2, "reset_minutes": 3, "rate_seconds": 30}, (2, 3, 0.5)),
        ({"vendor": "DeltaV", "gain": 2, "reset_seconds": 120, "rate_seconds": 30}, (2 * RATIO, 2, 0.5, 0.125)),
        ({"vendor": "Rockwell PIDE", "gain": 1.5, "reset_minutes": 4, "rate_minutes": 1}, (1.5 * RATIO, 4, 1)),
        ({"vendor": "centum", "PB": 80, "reset_seconds": 60}, (RATIO / 0.8, 1)),
    ],
)
def test_settings_are_the_law_that_they_mean(law, wanted):
    np.testing.assert_allclose(response(**law), ideal(*wanted), rtol=1e-12)


def test_times_follow_the_unit_of_the_project():
    law = {"gain": 2.0, "repeats_per_minute": 0.5, "rate_minutes": 0.5}
    np.testing.assert_allclose(response(time_unit="s", **law), ideal(2.0, 120.0, 30.0), rtol=1e-12)


def test_an_interacting_controller_is_a_product():
    s = 1j * W
    law = {"vendor": "Foxboro I/A", "PB": 200, "reset_minutes": 5, "rate_minutes": 1, "alpha": 0.1}
    wanted = 0.5 * RATIO * (1 + 1 / (5 * s)) * (s + 1) / (0.1 * s + 1)
    np.testing.assert_allclose(response(**law), wanted, rtol=1e-12)


def test_independent_gains_are_those_of_the_faceplate():
    """Integral gain in 1/min and derivative gain in min, in a project that counts in seconds."""
    law = {"vendor": "Rockwell PIDE independent", "Kp": 1.2, "Ki": 0.6, "Kd": 0.3, "Tf": 0.05}
    s = 1j * W
    wanted = RATIO * (1.2 + 0.6 / 60 / s + 0.3 * 60 * s / (0.05 * 60 * s + 1))
    np.testing.assert_allclose(response(time_unit="s", **law), wanted, rtol=1e-12)


def test_action_gives_the_sign():
    law = {"PB": 50, "repeats_per_minute": 2, "action": "direct"}
    said = project(**law)
    np.testing.assert_allclose(said.controller()(1j * W)[:, 0, 0], -ideal(2 * RATIO, 0.5), rtol=1e-12)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ({"PB": 50, "gain": 2}, r"PB: says what gain says|gain: says what|PB: says"),
        ({"gain": 2, "Ti": 3, "reset_minutes": 3}, "reset_minutes: says what Ti says"),
        ({"vendor": "CENTUM", "gain": 2}, r"gain: is not what Yokogawa CENTUM shows: give PB"),
        ({"vendor": "DeltaV", "PB": 50}, r"PB: is not what Emerson DeltaV shows: give gain"),
        ({"vendor": "DeltaV", "Kc": 2}, r"Kc: is in the project's units: give gain, as Emerson DeltaV"),
        ({"vendor": "DeltaV", "gain": 2, "Ti": 2}, r"Ti: is in the project's units: give reset_seconds"),
        ({"vendor": "DeltaV", "gain": 2, "form": "series"}, r'shows the form "ideal": leave form out'),
        ({"vendor": "Deltav5", "gain": 2}, r"vendor: 'Deltav5' is no system .* did you mean 'Emerson DeltaV'"),
        ({"form": "parallel", "PB": 50}, "PB: is no key of an independent"),
        ({"tf": "1/s", "PB": 50}, "PB: is no key of a controller given by tf"),
        ({"PB": 50, "gain_unit": "engineering"}, "gain_unit: a proportional band is in per cent of span"),
        ({"PB": -50}, "PB"),
        ({"reset_minutes": 2}, r"Kc: is needed .* gain or PB"),
        ({"PB": 150, "spans": False}, r'PB: a proportional band is in per cent of span: add span = .* "y"'),
        ({"vendor": "DeltaV", "gain": 2, "spans": False}, r"vendor: this gain is in per cent of span: add span"),
    ],
)
def test_what_cannot_be_meant_is_one_message(law, words):
    with pytest.raises(ProjectError, match=words) as error:
        project(**law)
    assert "Kp" not in str(error.value) or law.get("form") == "parallel"


def test_limits_are_not_taken_for_spans():
    """OP's limits of 100 and PV's of 1000 would give another gain."""
    np.testing.assert_allclose(response(Kc=1.0, Ti=5.0, gain_unit="percent of span"), ideal(RATIO, 5.0), rtol=1e-12)


def test_systems_are_found_by_their_words():
    assert [vendor_of(v.name) for v in VENDORS] == list(VENDORS)
    assert vendor_of("experion").name == "Honeywell Experion"
    assert vendor_of("PIDE independent").form == "parallel"
    with pytest.raises(LoopError, match="may be one of several"):
        vendor_of("honeywell")
    with pytest.raises(LoopError, match="no system that is known: there are Emerson DeltaV, "):
        vendor_of("")
