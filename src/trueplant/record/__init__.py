"""What was measured: reading, screening, segments, excitation, and the way to the Laplace domain."""

from trueplant.record.laplace import transform
from trueplant.record.layout import Channel, Layout
from trueplant.record.read import read_record
from trueplant.record.table import Table, read_table
from trueplant.record.types import Finding, Record, Screened, Segment

__all__ = [
    "Channel",
    "Finding",
    "Layout",
    "Record",
    "Screened",
    "Segment",
    "Table",
    "read_record",
    "read_table",
    "transform",
]
