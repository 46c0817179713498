"""Published plants: model, plant, controller and reference of each."""

from trueplant.plants.case import Case
from trueplant.plants.columns import shell_3x3, skogestad_distillation, splitter, wardle_wood, wood_berry
from trueplant.plants.mill import mill
from trueplant.plants.rao_garnier import rao_garnier
from trueplant.plants.satellite import spinning_satellite
from trueplant.plants.tanks import quadruple_tank

__all__ = [
    "Case",
    "mill",
    "quadruple_tank",
    "rao_garnier",
    "shell_3x3",
    "skogestad_distillation",
    "spinning_satellite",
    "splitter",
    "wardle_wood",
    "wood_berry",
]
