"""What was measured: reading, screening, segments, excitation, and the way to the Laplace domain."""

from trueplant.record.excitation import Excitation, excitation
from trueplant.record.laplace import transform
from trueplant.record.layout import Channel, Layout
from trueplant.record.read import read_record
from trueplant.record.screening import screen
from trueplant.record.table import Table, read_table
from trueplant.record.types import Finding, Record, Screened, Segment

__all__ = [
    "Channel",
    "Excitation",
    "Finding",
    "Layout",
    "Record",
    "Screened",
    "Segment",
    "Table",
    "excitation",
    "read_record",
    "read_table",
    "screen",
    "transform",
]
