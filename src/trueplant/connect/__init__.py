"""Historians: each is read into a snapshot on disk, which is a data file like any other from then on."""

from trueplant.connect.fetching import Fetched, ensure, fetch
from trueplant.connect.source import Lost, Quality, Source, TagInfo, Window

__all__ = ["Fetched", "Lost", "Quality", "Source", "TagInfo", "Window", "ensure", "fetch"]
