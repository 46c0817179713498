"""The project file: its tables and what they say together, and what it declares as other rooms take it."""

from trueplant.project.declaration import ExperimentPlan
from trueplant.project.project import Project, plant_project

__all__ = ["ExperimentPlan", "Project", "plant_project"]
