"""What an analysis works on: the records after screening, the model, what is to be estimated, and what limits it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from trueplant.arrays import BoolArray
from trueplant.identify import Spec, WhyUnanswered
from trueplant.loop import Controller, LinearLoop
from trueplant.lti import TransferMatrix
from trueplant.project import Project
from trueplant.record import Kind, Screened, Segment
from trueplant.result import Reason

Progress = Callable[[str], None]
"""Is told what is being done, in a few words, as each step begins."""
Place = tuple[int, int]
"""(output, column) of an element; columns are the inputs, then the measured disturbances."""


def quiet(_: str) -> None:
    """Progress that nobody looks at."""
    return None


@dataclass(frozen=True, eq=False)
class Records:
    """The experiments of a project after screening, one entry each, and the controllers that ran in them."""

    project: Project
    screened: tuple[Screened, ...]
    declared: tuple[Controller | None, ...]
    """The controllers as the project declares them."""
    linear: tuple[Controller | None, ...]
    """The same for small changes about the mean PV of the record."""

    @classmethod
    def of(cls, project: Project, screened: tuple[Screened, ...]) -> Records:
        """With the controllers that the project declares for each experiment."""
        declared = tuple(project.controller(k) for k in range(len(screened)))
        linear = tuple(
            None if law is None else law.linearised(s.record.mean_pv) for law, s in zip(declared, screened, strict=True)
        )
        return cls(project, screened, declared, linear)

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Every stretch that can be used."""
        return tuple(segment for s in self.screened if s.refusal is None for segment in s.segments)

    @property
    def loop_experiment(self) -> int | None:
        """The experiment whose controller stands for today's loop: the last usable closed one that declares it."""
        usable = [
            k
            for k, (plan, s) in enumerate(zip(self.project.experiments, self.screened, strict=True))
            if plan.closed and s.refusal is None and self.declared[k] is not None
        ]
        return usable[-1] if usable else None


@dataclass(frozen=True, eq=False)
class Study:
    """What the analysis works on; whole when it is made (`prepare`)."""

    records: Records
    model: TransferMatrix
    """(n_y, n_u + n_d): the inputs, then the measured disturbances."""
    specs: Mapping[Place, Spec]
    """The elements that the project asks for."""
    computed: BoolArray
    """(n_y,) True for a set-point that the whole of the data shows to be computed from PV."""
    computed_alone: tuple[BoolArray, ...]
    """The same by each segment alone."""
    hidden: Mapping[int, WhyUnanswered]
    """The outputs of which the record cannot tell dynamics, and why (`scan`)."""
    between: bool
    """Is OP written between the recorded samples (`scan`)?"""
    notes: tuple[Reason, ...] = ()

    @property
    def project(self) -> Project:
        return self.records.project

    @property
    def screened(self) -> tuple[Screened, ...]:
        return self.records.screened

    @property
    def segments(self) -> tuple[Segment, ...]:
        return self.records.segments

    @property
    def n_u(self) -> int:
        """Inputs, without measured disturbances."""
        return len(self.project.inputs)

    @property
    def undeclared_holds(self) -> tuple[int, ...]:
        """The measured disturbances of which the project does not say how they run between samples."""
        return tuple(k for k, entry in enumerate(self.project.disturbances) if entry.hold is None)

    @property
    def holds_to_find(self) -> tuple[int, ...]:
        """Columns of these; none between samples at odd instants, which were put on the grid along straight lines."""
        if any(any(segment.d_timing) for segment in self.segments):
            return ()
        return tuple(self.n_u + k for k in self.undeclared_holds)

    @cached_property
    def wanted(self) -> frozenset[Place]:
        """Elements of which the project does not say whether they are there."""
        return frozenset(place for place in np.ndindex(*self.model.shape) if self.project.wanted(*place))

    @property
    def spikes_kept(self) -> frozenset[int]:
        """Outputs of which the project says that their spikes are real."""
        return frozenset(i for i, entry in enumerate(self.project.outputs) if Kind.SPIKE in entry.keep)

    @property
    def passed_on(self) -> frozenset[Place]:
        """From what moves the PV of a slave loop to what its set-point moves, which is the OP of another input.

        That is one element. Where the slave is at its limit, its own OP tells more of it than its set-point does.
        """
        outputs, model = self.project.outputs, self.model
        slaves = [
            (i, j)
            for i, own in enumerate(outputs)
            for j, above in enumerate(self.project.inputs)
            if own.sp is not None and own.sp in (above.op, above.slave_sp)
        ]
        return frozenset(
            (row, column)
            for slave, master in slaves
            for row, column in np.ndindex(*model.shape)
            if column != master and not model[slave, column].is_zero and not model[row, master].is_zero
        )

    @property
    def modelled(self) -> BoolArray:
        """(n_y, n_u + n_d) False for the elements of which the project says nothing."""
        said: BoolArray = np.ones(self.model.shape, dtype=bool)
        for place in self.wanted:
            said[place] = False
        return said

    def with_segments(self, changed: Callable[[tuple[Segment, ...]], tuple[Segment, ...]]) -> Study:
        """With the segments of each experiment as `changed` makes them."""
        screened = tuple(replace(one, segments=changed(one.segments)) for one in self.screened)
        return replace(self, records=replace(self.records, screened=screened))

    def with_first_model(self, plant: TransferMatrix) -> Study:
        """For what follows an estimate: the plant (n_y, n_u + n_d) found is the model where the project has none."""
        if not self.wanted:
            return self
        both = enumerate(zip(self.model.elements, plant.elements, strict=True))
        rows = tuple(
            tuple(found if (i, j) in self.wanted else own for j, (own, found) in enumerate(zip(*row, strict=True)))
            for i, row in both
        )
        return replace(self, model=TransferMatrix(rows, self.model.time_unit))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the model's columns."""
        return (*self.project.input_names, *self.project.disturbance_names)

    def input_unit(self, j: int) -> str:
        """The unit of a column of the model."""
        inputs = self.project.inputs
        return inputs[j].unit if j < len(inputs) else self.project.disturbances[j - len(inputs)].unit

    @property
    def inputs_model(self) -> TransferMatrix:
        """(n_y, n_u) the model from the inputs alone."""
        return self.model.columns(0, self.n_u)

    def loop(self, plant: TransferMatrix) -> LinearLoop | None:
        """A plant (n_y, n_u + n_d) with today's controller; None where no usable closed experiment declares one."""
        k = self.records.loop_experiment
        law = None if k is None else self.records.linear[k]
        return None if law is None else LinearLoop(plant.columns(0, self.n_u), law)

    @property
    def loop_experiment(self) -> int | None:
        return self.records.loop_experiment
