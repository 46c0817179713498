"""Published plants: model, plant, controller and reference of each."""

from trueplant.plants.case import Case
from trueplant.plants.columns import shell_3x3, splitter, wood_berry
from trueplant.plants.mill import mill
from trueplant.plants.rao_garnier import rao_garnier

__all__ = ["Case", "mill", "rao_garnier", "shell_3x3", "splitter", "wood_berry"]
