"""What several tests share: simulated plants and records, projects made of them, pages taken apart."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
"""The folder of the whole project."""
