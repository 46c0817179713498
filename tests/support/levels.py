"""Levels of identify, detect and study that are no thresholds, by what they are instead; tests hold all others."""

from __future__ import annotations

NO_THRESHOLDS = {
    "significance": """
        identify.DEAD_TIME_UNSEEN identify.NOT_WHITE identify.UNDERMODELLED identify.STRUCTURE_SHARE identify.NO_GAIN
        identify.RUNS_DISAGREE identify.VALVE identify.HOLD identify.UNEVEN identify.WORSE identify.MISSING_ELEMENT
        identify.MISSING_TRIED identify.SHARED_DISTURBANCE identify.SUBSPACE_INSIDE identify.LOAD_STEP identify.SPIKE
        detect.SCATTERED
        study.EXCITED study.REACHED study.OUTSIDE_BAND study.MISDESCRIBED study.CAUSES study.GRADED_WHITE
    """,
    "rounding": """
        identify.ROUNDING identify.LOST identify.EXACT identify.RIDGE identify.BETTER identify.FREE_RESPONSE_GONE
        identify.NO_INFORMATION identify.LARGEST_EXPONENT identify.SMALLEST identify.WINDOW_FLOOR
        identify.VARX_RESOLVED
        detect.DEGENERATE detect.SMALLEST_VARIANCE detect.COLLINEAR
        study.FAR_OFF
    """,
    "search": """
        identify.SETTLED identify.NEGLIGIBLE identify.FIRST_DAMPING identify.LEAST_DAMPING identify.LARGEST_DAMPING
        identify.MOST_DAMPINGS identify.REWEIGHTED identify.STRETCH identify.DEAD_TIME_REACH identify.TRIED_STEPS
        identify.SECOND_LAGS identify.CANCELLED_LAGS identify.PAIR_DAMPINGS identify.RICHER_LAGS
        identify.POLISHED_STEPS identify.FIRST_SCALES identify.GUESSED_ORDER identify.MEMORIES
        identify.RUN_SPREADS identify.BACKLASHES identify.STICK_BANDS identify.VALVE_FACTORS identify.VALVE_ROUNDS
        identify.BEYOND_ENDS identify.VALVES_PLACED
        identify.PROFILED_STEPS identify.PROFILE_PLACES identify.MINIMA_STARTS identify.MINIMA_SPREAD
        identify.MINIMA_SEED identify.MINIMA_ALIKE identify.MINIMA_POLISHED identify.TRIED_SETTLED
        identify.PROFILE_TOLERANCE identify.MISSING_LAGS_APART identify.MISSING_DEAD_TIMES
        identify.JOINT_ITERATIONS identify.ONE_STEP_ROUNDS identify.ONE_STEP_SETTLED
        identify.VARX_LAGS identify.PAPER_FILTERS identify.ORDERS identify.CLSRIVC_ROUNDS identify.LAG_GROWTH
        identify.FILTER_CUTOFFS identify.DEAD_TIME_GRID identify.DEAD_TIME_COARSE identify.SCAN_ROUNDS
        identify.MINIMA_KEPT identify.ARMA_ORDERS identify.NOISE_ROUNDS identify.NOISE_SETTLED
        identify.NEIGHBOUR_INTERVALS identify.INSTRUMENT_SETTLED identify.PSEUDOLINEAR_ROUNDS identify.ARX_LAGS
        identify.ARX_HORIZON identify.LOAD_ROUNDS identify.SPIKE_ROUNDS
        detect.FIRST_PASS detect.CLOSER_PASS detect.CHANGE_ROUNDS detect.CHANGE_SETTLED
        study.ANSWER_ROUNDS study.ANSWER_SETTLED study.GAIN_STEPS study.LOWEST_OF_SLOWEST study.CORRECTIONS
        study.CORRECTED
    """,
    "size": """
        identify.LEVEL_SAMPLES identify.GUESSED_FROM identify.WRITTEN_OUT identify.LARGEST_JACOBIAN
        identify.VARX_TESTED identify.PAPER_POINTS identify.ARX_MOST_SAMPLES
        detect.DRAWS detect.SHIFTS
        study.OTHER_TIMES study.ROUNDING_DRAWS study.COHERENCE_LISTED study.COHERENCE_DRAWN study.FREQUENCIES
        study.STABILITY_DRAWS study.NOISE_STEPS study.FINE_STEP study.MU_DRAWS study.MU_POINTS
        study.JUDGING_DRAWS study.BAND_DRAWS study.RESPONSE_POINTS study.TRIED_PLANTS study.TRIED_STEPS
        study.MOVED_POINTS study.PLAN_LENGTHS study.MATTERS_POINTS study.BURN_IN study.STEP_POINTS
        study.STEP_DRAWS
    """,
    "constant": """
        identify.NORMAL_MOVE
        study.BETWEEN study.MOVE_RATIO
    """,
}
"""By kind:

significance: the chance of error that a test may have;
rounding: what floating point leaves;
search: grids, starts, rounds, steps and tolerances of a search, whose optimum does not depend on them;
size: samples, draws, frequencies and points that are computed, kept or drawn, and memory;
constant: numbers of a formula.
"""


def no_thresholds() -> set[str]:
    return {level for levels in NO_THRESHOLDS.values() for level in levels.split()}
