"""Field names of result.json as words."""

from __future__ import annotations

WORDS = (
    "name samples sample_time start source used excluded findings excitation outputs inputs experiment output input "
    "validation whiteness independence residuals kind signal message reason from to spans value loop closed hold "
    "agreement controller_consistency consistent rms unit version time_spans seed settings method confidence "
    "confirmed relative note tolerance_percent lower upper frequency current form metrics before after used_spans "
    "excluded_spans update_interval time_unit refusal notes code where parameters standard_error interval verdict"
)
"""Field names of result.json that are shown as words; any other key may be the user's own name and stays as it is."""
LABELS = {word: word.replace("_", " ").capitalize() for word in WORDS.split()} | {
    "fit_percent_model": "Fit of the model (%)",
    "fit_percent_plant": "Fit of the plant (%)",
    "usable_share": "Share of PV that can be used",
    "saturated_share": "Share of OP at a limit",
    "worst_condition": "Largest condition number",
    "sentences": "What is not enough",
    "refused": "Refused",
    "excludes": "Left out",
    "of": "Of",
    "rank": "Directions that move apart",
    "signals": "Signals",
    "signal": "Signal",
    "changes": "Moves",
    "setpoints": "Set-points",
    "moves": "Moves",
    "smallest": "Smallest",
    "median": "Median",
    "largest": "Largest",
    "noise": "Noise",
    "always": "Changes all the time",
    "std": "Standard deviation",
    "band": "Band (rad per time unit)",
    "span": "Time span",
    "not_applied": "Methods that do not apply",
    "remarks": "What to know of each",
    "black_box": "Black box, a second opinion",
    "lags": "Lags",
    "remembers": "Remembers (time unit)",
    "states": "States of the subspace model",
    "states_reason": "Why so many",
    "p_values": "p, that the plant of each lies where the black box says",
    "noise_model_order": "Order of the noise model",
    "prediction_error": "Prediction error (rms)",
    "samples_per_error": "Samples from one error to the next",
    "project": "Project",
    "stable": "Stable",
    "model": "On the model",
    "plant": "On the plant as estimated",
    "parameter": "Parameter",
    "tf": "Formula in s",
    "now": "Now",
    "wanted": "For grade A",
    "as_modelled": "With the model's times",
    "then": "Then",
    "matters": "Matters",
    "size": "To each side",
    "every": "Every",
    "statistic": "Statistic",
    "threshold": "Threshold",
    "flagged": "Flagged",
    "elements": "Elements",
    "detectors": "Published detectors",
    "cascade": "Cascades",
    "precision_percent": "Standard error that windows are made long enough for (%)",
    "p_value": "p",
    "p_adjusted": "p, adjusted",
    "within": "Within",
    "worst_frequency": "Farthest at (rad per time unit)",
    "by": "Estimated by",
    "speaks": "The data speak (rad per time unit)",
    "follows": "Follows its set-point",
    "basis": "Basis",
    "deviation": "Largest deviation from 1",
    "disturbance": "Disturbances",
    "declared": "Declared",
    "found_std": "Standard deviation found",
    "jumps": "Jumps",
    "background": "Beside them",
    "assumed": "Assumed",
    "project_sha256": "SHA-256 of the project",
    "data_sha256": "SHA-256 of the data",
    "model_sha256": "SHA-256 of the model's files",
    "sha256": "SHA-256",
}


def label(key: str) -> str:
    """The words for a field name; a key that is not one of them may be the user's own name, and stays."""
    return LABELS.get(key, str(key))
