"""How a project declares the signals of its data files."""

from __future__ import annotations

from dataclasses import dataclass

from trueplant.record import levels


@dataclass(frozen=True)
class Channel:
    """One output, input or measured disturbance.

    `column` is the PV of an output, the OP of an input, or the disturbance itself; `sp` the set-point of an output;
    `mode`, `slave_sp` and `slave_pv` belong to inputs. `hold` ("zoh" or "linear") says how OP or a disturbance runs
    between samples; None: "zoh" for OP, and to be found for a disturbance.
    """

    name: str
    column: str
    sp: str | None = None
    unit: str = ""
    limits: tuple[float, float] | None = None
    mode: str | None = None
    automatic_values: tuple[object, ...] | None = None
    """Of the mode; None: those that control systems use (`modes.AUTOMATIC`)."""
    keep: tuple[str, ...] = ()
    """Kinds of findings ("frozen", "spike") in spite of which samples of the PV of an output are used."""
    status: str | None = None
    """Column of the quality of the PV of an output, or the OP of an input."""
    hold: str | None = None
    slave_sp: str | None = None
    slave_pv: str | None = None


@dataclass(frozen=True)
class Layout:
    """Which columns to read, and how time is written. Tags stand for columns in long exports."""

    outputs: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    disturbances: tuple[Channel, ...] = ()
    time: str | None = None
    """None: a column with a usual name, else the first of increasing numbers or time stamps."""
    time_unit: str = "s"
    """Of numeric time in the file: ms, s, min, h or d."""
    time_unit_declared: bool = False
    """Did the project say so? If not, numbers that look like moments are taken for them."""
    time_format: str | None = None
    """One of `times.FORMATS`; None: to be found."""
    project_time_unit: str = "min"
    """Of `Record.t`."""
    time_zone: str | None = None
    """Of time stamps that bear no offset; None leaves them as they are."""
    separator: str | None = None
    encoding: str | None = None
    sheet: str | None = None
    tag: str = "tag"
    value: str = "value"
    quality: str = "quality"
    most: int = levels.MOST_CELLS
    """Cells of a file that are read."""
    sample_time: float | None = None
    """Of the even grid that a long export is put on, in `time_unit`; None: the stamps of its most recorded tag."""
    max_gap: float | None = None
    """Between two values of a PV, or after one of OP, in `time_unit`: beyond is missing. Goes with `sample_time`."""

    @property
    def continuous(self) -> tuple[str, ...]:
        """Columns that run on between samples (PV, disturbances)."""
        slaves = [c.slave_pv for c in self.inputs if c.slave_pv]
        return tuple(dict.fromkeys([*(c.column for c in (*self.outputs, *self.disturbances)), *slaves]))

    @property
    def held(self) -> tuple[str, ...]:
        """Columns that keep their value until the next one (OP, SP, mode)."""
        named = [c.column for c in self.inputs]
        named += [x for c in self.outputs for x in (c.sp,) if x]
        named += [x for c in self.inputs for x in (c.mode, c.slave_sp) if x]
        named += [c.status for c in (*self.outputs, *self.inputs) if c.status]
        return tuple(dict.fromkeys(named))
