"""Verdicts: Holm against its definition, calibration by Monte Carlo, importance against its definition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, norm

from trueplant.detect import Evidence, grade, holm, importance_in_loop, judge


def test_holm_is_its_definition():
    p = np.array([0.01, 0.04, 0.03, 0.005])
    # sorted 0.005 0.01 0.03 0.04, times 4 3 2 1, made monotone
    assert np.allclose(holm(p), [0.03, 0.06, 0.06, 0.02])


def test_false_alarms_over_the_matrix_are_at_the_level_or_below():
    """2,000 matrices: passes with 0.9999 at the level of 5 %, with less than 1e-6 at 20 %."""
    rng = np.random.default_rng(11)
    root = np.tril(rng.standard_normal((3, 3))) + 2 * np.eye(3)
    covariance = root @ root.T
    alarms = 0
    for _ in range(2000):
        elements = [
            Evidence(
                (1.0, 2.0, 3.0), np.array([1.0, 2.0, 3.0]) + root @ rng.standard_normal(3), covariance, (True,) * 3
            )
            for _ in range(4)
        ]
        alarms += any(v.verdict == "changed" for v in judge(elements))
    # binomial, n = 2000, p = 0.05: 4 standard deviations are 0.02
    assert 0.03 < alarms / 2000 < 0.07


def test_only_the_changed_element_and_parameter_are_named():
    sigma = np.diag([0.01, 0.1, 0.1]) ** 2
    same = Evidence((1.0, 5.0, 2.0), np.array([1.005, 5.1, 2.0]), sigma, (True,) * 3)
    other = Evidence((1.0, 5.0, 2.0), np.array([1.2, 5.1, 2.0]), sigma, (True,) * 3)
    first, second = judge([same, other])
    assert first.verdict == "unchanged"
    assert second.verdict == "changed"
    assert [p.changed for p in second.parameters] == [True, False, False]


def test_changes_within_the_tolerance_do_not_count():
    evidence = Evidence((1.0,), np.array([1.08]), np.array([[1e-6]]), (True,))
    assert judge([evidence], tolerance_percent=10)[0].verdict == "unchanged"
    assert judge([evidence], tolerance_percent=5)[0].verdict == "changed"


def test_a_rejected_structure_is_a_change_and_has_a_fifth_of_the_level():
    """Parameters that are all as the model has them, and one that is so at 4.5 % only: 4 % is what is left to them."""
    same = Evidence((1.0,), np.array([1.0]), np.array([[0.01]]), (True,), structure_p=0.003)
    (verdict,) = judge([same])
    assert verdict.verdict == "changed" and verdict.p_adjusted == 0.003
    assert not any(p.changed for p in verdict.parameters)
    nothing = Evidence((None,), np.array([1.0]), np.array([[0.01]]), (True,), structure_p=0.003)
    assert judge([nothing])[0].verdict == "changed"
    for p, said in ((0.045, "unchanged"), (0.035, "changed")):
        moved = Evidence((1.0,), np.array([1.0 + 0.1 * norm.isf(p / 2)]), np.array([[0.01]]), (True,))
        assert judge([moved])[0].verdict == said


def test_nothing_answered_is_not_identifiable():
    evidence = Evidence((1.0, 2.0), np.array([1.0, 9.0]), np.eye(2), (False, False))
    assert judge([evidence])[0].verdict == "not identifiable"


@pytest.mark.holds("detect.WORTH_KNOWING")
def test_unchanged_needs_the_power_to_see_a_change_worth_knowing():
    """The same estimate, which could have missed a change of 25 %, of 35 %, and any."""
    model, covariance = (1.0, 5.0), np.diag([0.1, 0.4]) ** 2
    verdicts = [
        judge([Evidence(model, np.array([1.05, 5.1]), covariance, (True, True), detectable=share)])[0]
        for share in (0.25, 0.35, np.inf)
    ]
    assert [v.verdict for v in verdicts] == ["unchanged", "not identifiable", "not identifiable"]
    assert [v.lacks_power for v in verdicts] == [False, True, True]
    assert verdicts[1].p_adjusted == verdicts[0].p_adjusted and verdicts[1].detectable == 0.35
    moved = Evidence(model, np.array([2.0, 5.1]), covariance, (True, True), detectable=np.inf)
    assert judge([moved])[0].verdict == "changed"
    wide = Evidence(model, np.array([1.05, 5.1]), covariance, (True, True), detectable=0.35)
    assert judge([wide], worth_knowing=0.4)[0].verdict == "unchanged"


def test_a_change_of_the_whole_is_put_on_no_parameter_that_does_not_show_it():
    """Two gains that are known by their difference alone: it has moved by 12 standard errors, each gain by 0.85."""
    covariance = np.array([[1.0, 0.99], [0.99, 1.0]])
    verdict = judge([Evidence((0.0, 0.0), np.array([0.85, -0.85]), covariance, (True, True))])[0]
    assert verdict.verdict == "changed" and verdict.p_adjusted < 1e-6
    assert [p.changed for p in verdict.parameters] == [False, False]
    assert all(p.p_value > 0.3 for p in verdict.parameters)


def test_importance_is_the_largest_singular_value_of_one_element_alone():
    rng = np.random.default_rng(4)
    delta = rng.standard_normal((6, 2, 3)) + 1j * rng.standard_normal((6, 2, 3))
    q_s = rng.standard_normal((6, 3, 2)) + 1j * rng.standard_normal((6, 3, 2))
    alone = np.zeros_like(delta)
    alone[:, 1, 2] = delta[:, 1, 2]
    expected = max(np.linalg.norm(m, 2) for m in alone @ q_s)
    assert np.isclose(importance_in_loop(delta, q_s)[1, 2], expected, rtol=1e-12)


@pytest.mark.holds("detect.GRADE_A", "detect.GRADE_B")
def test_grades():
    assert grade([0.05, 0.08], [True, True], True) == "A"
    assert grade([0.05, 0.2], [True, True], True) == "B"
    assert grade([0.05, 0.2], [True, True], False) == "C"
    assert grade([0.05, 0.3], [True, True], True) == "C"
    assert grade([0.05], [False], True) == "D"


def test_the_whole_is_judged_by_its_own_covariance_and_parameters_by_theirs():
    """Two gains known by their sum far better than singly; one of them widened by its profile."""
    narrow = np.array([[1.0, -0.98], [-0.98, 1.0]])
    wide = np.diag([9.0, 1.0])
    moved = np.array([1.2, 1.2])
    verdict = judge([Evidence((0.0, 0.0), moved, wide, (True, True), None, narrow)])[0]
    # the sum has moved by 2.4 with a standard deviation of 0.2, the difference not at all
    assert verdict.verdict == "changed" and verdict.p_adjusted == pytest.approx(chi2.sf(144.0, 2))
    assert verdict.parameters[0].p_value == pytest.approx(2 * norm.sf(0.4))
    assert judge([Evidence((0.0, 0.0), moved, wide, (True, True))])[0].verdict == "unchanged"


def test_what_the_other_test_counts_by_itself_wald_does_not_count_again_but_still_knows_directions_by():
    """Two parameters, of which the second is known to 0.5 of what is worth knowing, and beside other minima to 2."""
    by_likelihood, elsewhere = np.diag([0.01, 0.25]), np.diag([0.005, 3.75])
    moved, worth = np.array([0.25, 3.0]), np.ones(2)

    def p_of(beside, joint):
        evidence = Evidence((0.0, 0.0), moved, joint, (True, True), 1e-9, joint, worth_knowing=worth, beside=beside)
        return judge([evidence])[0].p_adjusted

    both = by_likelihood + elsewhere
    assert p_of(by_likelihood, both) == pytest.approx(chi2.sf(0.25**2 / 0.01, 1))
    assert p_of(None, both) == pytest.approx(chi2.sf(0.25**2 / 0.015, 1))
    whole = np.sum(moved**2 / np.diag(by_likelihood))
    assert p_of(None, by_likelihood) == pytest.approx(max(chi2.sf(whole, 2), 1e-9))


def test_what_is_known_together_counts_as_moved_beyond_the_tolerance_or_not():
    """Two lags of which the sum is known to 1 % and neither by itself, and a gain that has not moved."""
    apart, together = 64.0, 0.02
    covariance = np.zeros((3, 3))
    covariance[0, 0] = 1e-4
    covariance[1:, 1:] = [[apart, together - apart], [together - apart, apart]]
    model, answered, worth = (1.0, 12.0, 8.0), (True, False, False), np.array([0.3, 9.0, 9.0])

    def said(plant: list[float], tolerance: float) -> str:
        one = Evidence(model, np.array(plant), covariance, answered, detectable=0.05, worth_knowing=worth)
        return judge([one], tolerance_percent=tolerance)[0].verdict

    assert said([1.0, 18.0, 12.0], 0) == said([1.0, 18.0, 12.0], 40) == "changed"  # the sum is up by half
    assert said([1.0, 18.0, 12.0], 60) == "unchanged"
    assert said([1.0, 13.0, 8.0], 0) == "changed" and said([1.0, 13.0, 8.0], 10) == "unchanged"
    assert said([1.0, 25.0, -5.0], 40) == "unchanged"  # the sum is what it was
