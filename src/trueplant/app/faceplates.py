"""The settings of a result as other control systems show them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from trueplant.errors import LoopError
from trueplant.loop import PID
from trueplant.project import Project
from trueplant.report.retuned import Retuned, retuned
from trueplant.result import ControllerSettings, FaceplateSettings, LoopRetuning, Result
from trueplant.result import Notation as ShownNotation
from trueplant.study.loops.candidates import BY_HAND
from trueplant.tune import Notation, settings_of
from trueplant.tune.vendors import VENDORS, Vendor, vendor_of

DECLARED = ""
"""The choice that leaves the settings as the project declares them."""


_BARE = PID(Kc=1.0)
"""What the laws of the settings are made of."""


@dataclass(frozen=True)
class Faceplate:
    """One loop: what to enter, or why it cannot be shown so."""

    shown: Retuned
    problem: str = ""
    note: str = ""
    own: bool = False
    """Are these the engineer's own settings, a candidate of the project, and not what is recommended?"""


def vendor_names() -> list[str]:
    """Those that can be chosen."""
    return [vendor.name for vendor in VENDORS]


def faceplates(result: Result, project: Project | None, vendor: str = DECLARED) -> list[Faceplate]:
    """Every loop that was retuned, and after it the candidate for it. `project` says the spans, without which no other
    system can be shown.

    Raises LoopError for an unknown system.
    """
    system = vendor_of(vendor) if vendor else None
    found = []
    for loop in result.controllers:
        found.append(_faceplate(result, loop, project, system))
        if tried := _candidate(loop):
            found.append(replace(_faceplate(result, tried, project, system), own=True))
    return found


def _candidate(loop: LoopRetuning) -> LoopRetuning | None:
    """The loop as if its candidate were recommended; None where it has none, keeps today's settings, or really is."""
    tried = next((one for one in loop.proposals if one.method == BY_HAND), None)
    if tried is None or loop.recommended == BY_HAND or tried.settings in (None, loop.current.settings):
        return None
    return replace(loop, recommended=BY_HAND, trade_off=None, price=None, reason=tried.note)


def _faceplate(result: Result, loop: LoopRetuning, project: Project | None, system: Vendor | None) -> Faceplate:
    curves = result.curves
    outputs = dict(zip(curves.outputs, curves.output_units, strict=True)) if curves else {}
    inputs = dict(zip(curves.inputs, curves.input_units, strict=True)) if curves else {}
    units = inputs.get(loop.input, ""), outputs.get(loop.output, "")
    own = retuned(loop, *units)
    if system is None:
        return Faceplate(own)
    try:
        found = shown_by(loop, system, _spans(loop, project))
    except LoopError as error:
        return Faceplate(own, problem=f"{system.name} cannot show these settings: {error}")
    note = ""
    if system.alpha is not None and any(_filter(one) not in (None, system.alpha) for one in _laws(loop)):
        note = f"{system.name} presets the derivative filter to {system.alpha:g}: set it as shown."
    return Faceplate(retuned(found, *units), note=note)


def shown_by(loop: LoopRetuning, system: Vendor, spans: tuple[float, float] | None) -> LoopRetuning:
    """The loop with its settings in the numbers of that system. Raises LoopError where they have no such form, and
    without the spans of OP and PV, by which these systems reckon gains."""
    if spans is None:
        raise LoopError(
            f"it reckons gains in per cent of span, and the spans of OP {loop.input} and PV {loop.output} are not "
            "declared: give them on the screen Tags"
        )
    notation = Notation(
        form=system.form,
        gain=system.gain,
        derivative_filter=system.derivative_filter,
        time_unit=system.time_unit,
        gain_unit="percent of span",
        op_span=spans[0],
        pv_span=spans[1],
    )

    def shown(settings: ControllerSettings | None) -> FaceplateSettings | None:
        law = None if settings is None else _law(settings, loop, spans)
        if law is None:
            return None
        given = settings_of(law, notation, loop.time_unit)
        return FaceplateSettings(given.gain, given.integral, given.derivative, given.derivative_filter, given.action)

    def in_form(settings: ControllerSettings | None) -> ControllerSettings | None:
        return settings if settings is None or settings.form is None else replace(settings, form=system.form)

    current = replace(loop.current, settings=in_form(loop.current.settings), shown=shown(loop.current.settings))
    proposals = tuple(
        replace(one, settings=in_form(one.settings), shown=shown(one.settings)) if one is loop.chosen else one
        for one in loop.proposals
    )
    return replace(
        loop,
        form=system.form,
        gain_unit="percent of span",
        notation=ShownNotation(notation.gain, notation.integral, notation.derivative_filter, notation.time_unit),
        current=current,
        proposals=proposals,
    )


def _laws(loop: LoopRetuning) -> list[ControllerSettings]:
    chosen = loop.chosen.settings if loop.chosen else None
    return [one for one in (loop.current.settings, chosen) if one is not None]


def _filter(settings: ControllerSettings) -> float | None:
    return settings.alpha if settings.Td else None


def _law(settings: ControllerSettings, loop: LoopRetuning, spans: tuple[float, float]) -> PID | None:
    """None for a law that is no PID."""
    if settings.form is None:
        return None
    if settings.form == "parallel":
        keys = replace(_BARE, form="parallel", Kc=None, Kp=settings.Kp or 0.0, Ki=settings.Ki or 0.0)
        law = replace(keys, Kd=settings.Kd or 0.0, Tf=settings.Tf or 0.0)
    else:
        law = replace(_BARE, form=settings.form, Kc=settings.Kc or 0.0, Ti=settings.Ti, Td=settings.Td or 0.0)
        law = replace(law, alpha=settings.alpha or 0.0)
    return replace(law, action=settings.action, gain_unit=loop.gain_unit, op_span=spans[0], pv_span=spans[1])


def _spans(loop: LoopRetuning, project: Project | None) -> tuple[float, float] | None:
    """Of OP and PV."""
    if project is None or loop.input not in project.input_names or loop.output not in project.output_names:
        return None
    op = project.inputs[project.input_names.index(loop.input)].span
    pv = project.outputs[project.output_names.index(loop.output)].span
    return None if op is None or pv is None else (op[1] - op[0], pv[1] - pv[0])
