"""What was measured: reading, screening, segments, excitation, and the way to the Laplace domain."""

from trueplant.record.excitation import Excitation, excitation
from trueplant.record.laplace import transform
from trueplant.record.layout import Channel, Layout
from trueplant.record.read import read_record
from trueplant.record.readers import FORMATS, Format, read_table
from trueplant.record.screening import screen
from trueplant.record.segments import with_held_disturbance, with_known_instants
from trueplant.record.source import Source
from trueplant.record.table import Table
from trueplant.record.types import Finding, Kind, Load, Record, Refusal, Screened, Segment, Unusable

__all__ = [
    "FORMATS",
    "Channel",
    "Excitation",
    "Finding",
    "Format",
    "Kind",
    "Layout",
    "Load",
    "Record",
    "Refusal",
    "Screened",
    "Segment",
    "Source",
    "Table",
    "Unusable",
    "excitation",
    "read_record",
    "read_table",
    "screen",
    "transform",
    "with_held_disturbance",
    "with_known_instants",
]
