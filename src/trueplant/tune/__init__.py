"""Controllers for the updated plant: tuning rules, optimal and robust settings, before and after."""

from trueplant.tune.forms import Notation, Settings, converted, pid_of, settings_of
from trueplant.tune.reduce import Reduced, half_rule, matched, reduced
from trueplant.tune.response import frequencies, ultimate

__all__ = [
    "Notation",
    "Reduced",
    "Settings",
    "converted",
    "frequencies",
    "half_rule",
    "matched",
    "pid_of",
    "reduced",
    "settings_of",
    "ultimate",
]
