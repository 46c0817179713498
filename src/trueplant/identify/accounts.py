"""What a record may be explained by besides its parameters: holds, loads, and structures that suffice.

What holds leave in the prediction errors would pass for loads or for dynamics that a structure lacks, so that they are
found first. Of loads and dynamics each may pass for the other: a step that nobody recorded explains what a structure
leaves after a move, and a slow tail how the controllers answered to one. So loads are looked for beside the structures
as they are said and beside those that suffice without loads, and the likeliest of these accounts is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from trueplant.identify.estimate import Options
from trueplant.identify.first import regulating_or_not, with_left_out
from trueplant.identify.holds import FoundHold, find_holds, held_fits, with_holds
from trueplant.identify.loads import Fits, criterion, find_loads, with_loads
from trueplant.identify.output import OutputEstimate
from trueplant.identify.row import Spec
from trueplant.identify.spikes import set_aside, without_spikes
from trueplant.identify.structures import Again, with_structures
from trueplant.lti.structure import Structure
from trueplant.lti.transfer import TransferMatrix
from trueplant.record.types import Segment


@dataclass(frozen=True)
class Open:
    """What the estimates are to find out besides the parameters."""

    holds: Sequence[int] = ()
    """Columns of measured disturbances of which nobody said how they run between samples."""
    pinned: Collection[tuple[int, int]] = ()
    """Elements that keep their structure, whatever the record says."""
    loads: bool = True
    """Steps that nobody recorded; not where a disturbance is declared that would do what they do."""
    wanted: Collection[tuple[int, int]] = ()
    """Elements of which nobody said whether they are there."""
    passed_on: Collection[tuple[int, int]] = ()
    """Elements that the model lacks and is right to, whatever the record shows: they are not looked for."""
    drawn: Collection[int] = ()
    """Outputs that a historian filled in between few samples: its lines would pass for a structure."""
    certain: Collection[int] = ()
    """Outputs of which every sample counts, whatever it looks like."""

    def may_have_spikes(self, output: int) -> bool:
        """Are its spikes to be taken off? Not where a historian drew lines, whose ends would pass for some."""
        return output not in self.certain and output not in self.drawn


Tell = Callable[[int, str], None]
"""Is told what is being done, such as "estimating", and with which output."""


Estimate = Callable[..., OutputEstimate | None]
"""`identify_output` of one output."""


@dataclass(frozen=True, eq=False)
class Account:
    """The record with all that is known of it by now."""

    segments: Sequence[Segment]
    """With loads and holds."""
    estimates: dict[int, OutputEstimate]
    holds: dict[int, FoundHold]
    """How measured disturbances run between their samples."""

    @property
    def fits(self) -> Fits:
        return {i: found.fit for i, found in self.estimates.items()}

    @property
    def structures(self) -> list[Structure]:
        return [spec.structure for found in self.estimates.values() for spec in found.row.specs]


@dataclass(frozen=True, eq=False)
class Rivals:
    """The accounts that a record may be given."""

    model: TransferMatrix
    asked: Open
    again: Mapping[int, Estimate]
    """By output."""
    tested: int
    """Elements of the whole matrix."""
    timely: bool
    """Does OP act at the instants recorded? What it did in between would pass for a structure, or for loads that step
    when set-points do."""
    confidence: float
    tell: Tell | None

    @property
    def looks_for_loads(self) -> bool:
        return self.asked.loads and self.timely

    def likeliest(self, segments: Sequence[Segment], estimates: Mapping[int, OutputEstimate]) -> Account:
        """The likeliest account that these estimates, without loads, lead to."""
        begun = self._with_holds(segments, estimates)
        loaded = find_loads(begun.fits) if self.looks_for_loads else {}
        if not self.asked.pinned:
            return self._likeliest(begun, loaded)
        # Whether these are loads is asked beside structures that suffice, whichever are kept.
        free = replace(self, asked=replace(self.asked, pinned=()))
        there = loaded and any(segment.loads for segment in free._likeliest(begun, loaded).segments)
        return self._with_structures(self._beside(begun, loaded) if there else begun)

    def _likeliest(self, begun: Account, loaded: Fits) -> Account:
        """Of structures without loads, structures beside these loads, and loads beside the former structures."""
        accounts = [self._with_structures(begun)]
        if loaded:
            accounts.append(self._with_structures(self._beside(begun, loaded)))
        looked_for = self.looks_for_loads and accounts[0].structures != begun.structures
        if looked_for and (others := find_loads(accounts[0].fits)):
            accounts.append(self._with_structures(self._beside(accounts[0], others)))
        return min(accounts, key=lambda one: criterion(one.fits)) if len(accounts) > 1 else accounts[0]

    def beside_spikes(self, account: Account) -> Account:
        """The account beside those spikes of PV that show beside its own plants, where these are others than before."""
        own = {i: fit for i, fit in account.fits.items() if self.asked.may_have_spikes(i)}
        fits = {i: other for i, fit in own.items() if (other := without_spikes(fit)) is not fit}
        segments = account.segments
        for i, fit in fits.items():
            segments = set_aside(segments, i, fit)
        estimates = dict(account.estimates)
        for i, found in self._from(fits, segments).items():
            begun = replace(found, rejected=estimates[i].rejected)
            estimates[i] = self._structured(begun, i, estimating(self.again[i], segments)) if self._asks(i) else begun
        return replace(account, segments=segments, estimates=estimates)

    def _asks(self, i: int) -> bool:
        """Are the structures of this output to be tested?"""
        return self.timely and i not in self.asked.drawn

    def _with_holds(self, segments: Sequence[Segment], estimates: Mapping[int, OutputEstimate]) -> Account:
        holds = find_holds(estimates, self.model, self.asked.holds)
        segments = with_holds(segments, holds)
        return Account(segments, {**estimates, **self._from(held_fits(holds), segments)}, holds)

    def _beside(self, account: Account, loaded: Fits) -> Account:
        segments = with_loads(account.segments, loaded)
        return replace(account, segments=segments, estimates={**account.estimates, **self._from(loaded, segments)})

    def _with_structures(self, account: Account) -> Account:
        estimates = dict(account.estimates)
        for i in filter(self._asks, account.estimates):
            if self.tell is not None:
                self.tell(i, "testing structures of")
            estimates[i] = self._structured(estimates[i], i, estimating(self.again[i], account.segments))
        return replace(account, estimates=estimates)

    def _structured(self, found: OutputEstimate, i: int, estimate: Again) -> OutputEstimate:
        """The estimate with structures that suffice: where nobody said one, whether it integrates is asked first."""
        pinned = [j for k, j in self.asked.pinned if k == i]
        for spec in found.row.specs:
            if (i, spec.column) in self.asked.wanted and spec.column not in pinned:
                found = regulating_or_not(found, spec.column, estimate, self.confidence)
        found = with_structures(found, estimate, self.tested, self.confidence, pinned)
        there = {spec.column for spec in found.row.specs}
        left_out = [j for k, j in self.asked.wanted if k == i and j not in there]
        return with_left_out(found, left_out, estimate, self.confidence)

    def _from(self, fits: Fits, segments: Sequence[Segment]) -> dict[int, OutputEstimate]:
        """Estimates from these fits on."""
        options = {i: Options(start=fit) for i, fit in fits.items()}
        every = {i: estimating(self.again[i], segments)(fit.row.specs, options[i]) for i, fit in fits.items()}
        return {i: found for i, found in every.items() if found is not None}


def first_estimate(
    segments: Sequence[Segment], output: int, specs: Sequence[Spec], again: Estimate, asked: Open
) -> tuple[Sequence[Segment], OutputEstimate | None]:
    """The segments without the spikes of this output, and the estimate from them."""
    found = again(segments, specs=specs)
    if found is None or not asked.may_have_spikes(output):
        return segments, found
    fit = without_spikes(found.fit)
    if fit is found.fit:
        return segments, found
    segments = set_aside(segments, output, fit)
    return segments, again(segments, specs=specs, options=Options(start=fit))


def estimating(again: Estimate, segments: Sequence[Segment]) -> Callable[..., OutputEstimate | None]:
    """Estimates one output from these segments, with other elements."""

    def estimate(specs: Sequence[Spec], options: Options | None = None) -> OutputEstimate | None:
        return again(segments, specs=specs, options=options)

    return estimate
