"""A controller's settings as the project file and the vendor write them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from trueplant import result
from trueplant.errors import LoopError
from trueplant.loop import PID, Linear
from trueplant.lti import to_formula
from trueplant.project import Project
from trueplant.project.tables import Tuning
from trueplant.result import ControllerSettings, FaceplateSettings
from trueplant.tune import Notation, Settings, pid_of, settings_of
from trueplant.tune.levels import ALPHA
from trueplant.tune.vendors import vendor_of


@dataclass(frozen=True)
class Shown:
    """How one loop's settings are to be written."""

    form: str
    gain_unit: str
    spans: tuple[float | None, float | None]
    """Of OP and PV."""
    with_action: bool
    time_unit: str
    vendor: Mapping[str, str]
    """gain, integral, derivative_filter and time_unit, where the project states them."""

    @classmethod
    def of(cls, project: Project, entry: PID | Linear, i: int, j: int) -> Shown:
        """As [tuning] says, else as the controller is declared."""
        tuning = project.tuning or Tuning()
        ranges = (project.inputs[i].span, project.outputs[j].span)
        spans = tuple(None if span is None else span[1] - span[0] for span in ranges)
        own = entry if isinstance(entry, PID) else None
        system = None if tuning.vendor is None else vendor_of(tuning.vendor)
        keys = ("gain", "integral", "derivative_filter", "time_unit")
        shown = {} if system is None else {key: getattr(system, key) for key in keys if key != "integral"}
        return cls(
            form=tuning.form or (system.form if system else own.form if own else "ideal"),
            gain_unit=tuning.gain_unit or ("percent of span" if system else own.gain_unit if own else "engineering"),
            spans=(spans[0], spans[1]),
            with_action=own is not None and own.action is not None,
            time_unit=project.time_unit,
            vendor=shown | {key: getattr(tuning, key) for key in keys if getattr(tuning, key) is not None},
        )

    def in_notation(self, form: str, vendor: bool) -> Notation:
        """Of the project file, or of the vendor; `form` is that of the law."""
        given = dict(self.vendor) if vendor else {}
        filtering = "time" if form == "parallel" else given.get("derivative_filter", "ratio")
        return Notation(
            form=form,
            gain=given.get("gain", "gain"),
            integral=given.get("integral", "time"),
            derivative_filter=filtering,
            time_unit=given.get("time_unit", self.time_unit),
            shows_action=self.with_action,
            gain_unit=self.gain_unit,
            op_span=self.spans[0],
            pv_span=self.spans[1],
        )

    @property
    def notation(self) -> result.Notation:
        """What the vendor's settings are written in."""
        found = self.in_notation(self.form, True)
        return result.Notation(found.gain, found.integral, found.derivative_filter, found.time_unit)


def _unlinearised(law: PID, slope: float) -> PID:
    """The gains in front of the pv_transform whose slope is in those of the law."""
    if slope == 1:
        return law
    if law.form == "parallel":
        return replace(law, Kp=(law.Kp or 0.0) / slope, Ki=law.Ki / slope, Kd=law.Kd / slope)
    return replace(law, Kc=(law.Kc or 0.0) / slope)


def slope_of(declared: PID | Linear, linear: PID | Linear) -> float:
    """Of the declared law's pv_transform, from the law linearised at the mean PV; 1 without one."""
    if not (isinstance(declared, PID) and isinstance(linear, PID)) or declared.pv_transform is None:
        return 1.0
    return next(a / b for a, b in zip(linear.parallel, declared.parallel, strict=True) if b)


def law_of_settings(given: ControllerSettings, like: PID, shown: Shown, slope: float) -> PID:
    """`law_settings` backwards: the linearised law of these keys, all else as in `like`. Raises LoopError."""
    form = given.form or "ideal"
    notation = replace(shown.in_notation(form, False), shows_action=given.action is not None)
    if form == "parallel":
        kp, kd = given.Kp or 0.0, given.Kd or 0.0
        usual = ALPHA * abs(kd / kp) if kp else 0.0
        settings = Settings(kp, given.Ki, kd, usual if given.Tf is None else given.Tf, given.action)
    else:
        if not given.Kc:
            raise LoopError("Kc is needed and must not be 0")
        alpha = ALPHA if given.alpha is None else given.alpha
        settings = Settings(given.Kc, given.Ti, given.Td or 0.0, alpha, given.action)
    law = pid_of(settings, notation, shown.time_unit, like)
    factor = slope if slope else 1.0
    if form == "parallel":
        return replace(law, Kp=(law.Kp or 0.0) * factor, Ki=law.Ki * factor, Kd=law.Kd * factor)
    return replace(law, Kc=(law.Kc or 0.0) * factor)


def law_settings(law: PID | Linear, shown: Shown, slope: float) -> ControllerSettings:
    """The keys of a [[controller]] table. A form that cannot express the law is left for the law's own."""
    if isinstance(law, Linear):
        return ControllerSettings(tf=to_formula(law.tf))
    form, given = _converted(_unlinearised(law, slope), shown, False)
    filtering = (given.derivative_filter or 0.0) if form == "parallel" else given.derivative_filter
    filtered = filtering if given.derivative else None
    if form == "parallel":
        return ControllerSettings(
            form=form,
            Kp=given.gain,
            Ki=given.integral or 0.0,
            Kd=given.derivative or 0.0,
            Tf=filtered,
            action=given.action,
        )
    return ControllerSettings(
        form=form, Kc=given.gain, Ti=given.integral, Td=given.derivative, alpha=filtered, action=given.action
    )


def vendor_settings(law: PID | Linear, shown: Shown, slope: float) -> FaceplateSettings | None:
    """The numbers as the vendor shows them; None for a law that is no PID."""
    if isinstance(law, Linear):
        return None
    _, given = _converted(_unlinearised(law, slope), shown, True)
    return FaceplateSettings(given.gain, given.integral, given.derivative, given.derivative_filter, given.action)


def _converted(pid: PID, shown: Shown, vendor: bool) -> tuple[str, Settings]:
    bare = replace(pid, pv_transform=None)
    for form in (shown.form, pid.form):
        try:
            return form, settings_of(bare, shown.in_notation(form, vendor), shown.time_unit)
        except LoopError:
            continue
    # gains of different sign have the parallel form alone
    return "parallel", settings_of(bare, replace(shown.in_notation("parallel", vendor), gain="gain"), shown.time_unit)
