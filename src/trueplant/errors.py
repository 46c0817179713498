"""Exceptions. Each message says what is wrong, where, and what to do about it.

Each with its exit status:

    TrueplantError                     70 unless a subclass says otherwise
    |-- UsageError                     2: wrong usage, or an input that cannot be used as it is
    |   |-- ProjectError               the project file (or a Project built in code)
    |   |-- FormulaError               a transfer function or PV transform written as text
    |   |-- DataError                  a data file or frame: missing, unreadable, malformed
    |   |-- OutputError                the place where results should go
    |   `-- LoopError                  a loop that cannot be what it is declared to be
    |       |-- UnstableLoop
    |       |-- IllPosedLoop
    |       `-- SignConflict           the controller's action fights the sign of the gain
    |-- Refused                        3: the data cannot answer
    `-- SourceError                    4: a data source does not answer
"""

from __future__ import annotations


class TrueplantError(Exception):
    """Base of all errors raised on purpose by trueplant."""

    exit_status = 70


class UsageError(TrueplantError):
    """An input that cannot be used as it is."""

    exit_status = 2


class ProjectError(UsageError):
    """The project is malformed; the message names file, line or key."""


class FormulaError(UsageError):
    """A formula that is not in the grammar, or has no meaning as a transfer function."""


class DataError(UsageError):
    """A data file or frame that is missing, unreadable or malformed."""


class OutputError(UsageError):
    """Results cannot be written where they were asked for."""


class LoopError(UsageError):
    """A loop that cannot be what it is declared to be."""


class UnstableLoop(LoopError):
    """The closed loop is unstable."""


class IllPosedLoop(LoopError):
    """The algebraic loop has no unique solution."""


class SignConflict(LoopError):
    """The controller's action fights the sign of the plant's gain, in the loop of `place`: (input, output)."""

    def __init__(self, message: str, place: tuple[int, int] = (0, 0)) -> None:
        super().__init__(message)
        self.place = place


class Refused(TrueplantError):
    """The data cannot answer the question; the message says why."""

    exit_status = 3


class SourceError(TrueplantError):
    """A data source does not answer."""

    exit_status = 4
