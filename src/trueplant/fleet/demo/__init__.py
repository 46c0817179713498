"""A site to try an audit on: sixty simulated loops in a Parquet lake, and what is wrong with each."""

from trueplant.fleet.demo.judge import Judged, judge
from trueplant.fleet.demo.site import END, SITE, START, write_site

__all__ = ["END", "SITE", "START", "Judged", "judge", "write_site"]
