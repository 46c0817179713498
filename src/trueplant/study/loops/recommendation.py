"""A controller's settings as the project file and the vendor write them, and why a proposal is recommended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from trueplant.errors import LoopError
from trueplant.loop import PID, Linear
from trueplant.lti import to_formula
from trueplant.project.project import Project
from trueplant.tune import CERTAIN, Notation, Proposal, settings_of
from trueplant.tune.state_space import DESIGNS

Place = tuple[int, int]

LOUD = 1.5
"""From this factor on it is said that noise moves OP more than today."""
WORTH = 0.9
"""A proposal has to bring the error of a load step below this part of today's to be worth a change."""


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
        tuning = project.tuning
        assert tuning is not None
        ranges = (project.inputs[i].limits, project.outputs[j].limits)
        spans = tuple(None if limit is None else limit[1] - limit[0] for limit in ranges)
        own = entry if isinstance(entry, PID) else None
        keys = ("gain", "integral", "derivative_filter", "time_unit")
        return cls(
            form=tuning.form or (own.form if own else "ideal"),
            gain_unit=tuning.gain_unit or (own.gain_unit if own else "engineering"),
            spans=(spans[0], spans[1]),
            with_action=own is not None and own.action is not None,
            time_unit=project.time_unit,
            vendor={key: getattr(tuning, key) for key in keys if getattr(tuning, key) is not None},
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
    def notation(self) -> dict[str, str]:
        """What the vendor's settings are written in."""
        found = self.in_notation(self.form, True)
        return {key: getattr(found, key) for key in ("gain", "integral", "derivative_filter", "time_unit")}


def _unlinearised(law: PID, slope: float) -> PID:
    """The gains in front of the pv_transform whose slope is in those of the law."""
    if slope == 1:
        return law
    if law.form == "parallel":
        return replace(law, Kp=(law.Kp or 0.0) / slope, Ki=law.Ki / slope, Kd=law.Kd / slope)
    return replace(law, Kc=(law.Kc or 0.0) / slope)


def law_settings(law: PID | Linear, shown: Shown, slope: float) -> dict[str, Any]:
    """The keys of a [[controller]] table. A form that cannot express the law is left for the law's own."""
    if isinstance(law, Linear):
        return {"tf": to_formula(law.tf)}
    pid = _unlinearised(law, slope)
    form, given = _converted(pid, shown, False)
    table: dict[str, Any] = {"form": form}
    if form == "parallel":
        table |= {"Kp": given.gain, "Ki": given.integral or 0.0, "Kd": given.derivative or 0.0}
        table |= {"Tf": given.derivative_filter or 0.0} if given.derivative else {}
    else:
        table |= {"Kc": given.gain, "Ti": given.integral, "Td": given.derivative}
        table |= {"alpha": given.derivative_filter} if given.derivative else {}
    return table | ({"action": given.action} if given.action else {})


def vendor_settings(law: PID | Linear, shown: Shown, slope: float) -> dict[str, Any] | None:
    """The numbers as the vendor shows them; None for a law that is no PID."""
    if isinstance(law, Linear):
        return None
    _, given = _converted(_unlinearised(law, slope), shown, True)
    keys = ("gain", "integral", "derivative", "derivative_filter", "action")
    return {key: getattr(given, key) for key in keys}


def _converted(pid: PID, shown: Shown, vendor: bool) -> tuple[str, Any]:
    bare = replace(pid, pv_transform=None)
    for form in (shown.form, pid.form):
        try:
            return form, settings_of(bare, shown.in_notation(form, vendor), shown.time_unit)
        except LoopError:
            continue
    # gains of different sign have the parallel form alone
    return "parallel", settings_of(bare, replace(shown.in_notation("parallel", vendor), gain="gain"), shown.time_unit)


def reason_of(
    proposals: Sequence[Proposal],
    judged: Mapping[str, Mapping[Place, Any]],
    today: Mapping[Place, Any],
    places: Sequence[Place],
    asked: Mapping[str, Any],
) -> tuple[str | None, str]:
    """The method to use for all loops, if any, and why (not).

    Ours where it holds the limits for the share of independently drawn plants, else the one of those that do which has
    the least load error. Nothing where today's settings hold as well and no load error would fall by a tenth.
    """
    share = asked["share"]
    named = f"Ms and Mt below {asked['Ms']:.3g} in all loops"
    good = [p.method for p in proposals if p.method in judged and all(p.answered) and _holds(judged[p.method], asked)]
    usual = [m for m in good if m not in DESIGNS] or good
    now = next(iter(today.values()))["drawn"]
    if not usual:
        if not judged:
            return None, "no method had an answer: " + "; ".join(f"{p.method}: {p.notes[0]}" for p in proposals)
        best = max(_share(found) for found in judged.values())
        text = (
            f"no proposal holds {named} for {_percent(share)} of the plants that the record leaves possible "
            f"(the best one: {_percent(best)})"
        )
        notes = [p.notes[0] for p in proposals if p.method == CERTAIN and p.controller is None]
        return None, "; ".join([text, *notes])
    method = CERTAIN if CERTAIN in usual else min(usual, key=lambda m: _worst_load(judged[m], today, places))
    change = _load_change(judged[method], today, places)
    calm = bool(now) and now["share_all"] >= share and (asked["mu"] is None or (now["mu_share"] or 0.0) >= share)
    if calm and change and min(change) > WORTH - 1:
        return None, (
            f"today's settings hold {named} for {_percent(now['share_all'])} of the plants that the record leaves "
            "possible, and no proposal that does brings the error of a load step down by a tenth: keep them"
        )
    text = (
        f"holds {named} for {_percent(_share(judged[method]))} of plants drawn anew from those that the record leaves "
        "possible"
    )
    text += f" (today's settings: for {_percent(now['share_all'])})" if now else ""
    if change:
        told = ", ".join(f"{100 * c:+.0f} %" for c in change)
        text += f"; the absolute error of a load step, loop by loop, changes by {told}"
        louder = _noise_change(judged[method], today, places)
        if louder and max(louder) > LOUD:
            text += f"; noise moves OP up to {max(louder):.2g} times as much as today: a PI would be calmer"
    else:
        text += "; today's loops are not stable on the plant as estimated"
    return method, text


def _holds(found: Mapping[Place, Any], asked: Mapping[str, Any]) -> bool:
    drawn = next(iter(found.values()))["drawn"]
    if drawn is None or drawn["share_all"] < asked["share"]:
        return False
    return asked["mu"] is None or (drawn["mu_share"] is not None and drawn["mu_share"] >= asked["share"])


def _share(found: Mapping[Place, Any]) -> float:
    drawn = next(iter(found.values()))["drawn"]
    return 0.0 if drawn is None else float(drawn["share_all"])


def _load_change(found: Mapping[Place, Any], today: Mapping[Place, Any], places: Sequence[Place]) -> list[float]:
    """Relative change of the load step's IAE on the plant, of each loop; empty where today's loops are unstable."""
    pairs = [(found[p]["metrics"]["plant"], today[p]["metrics"]["plant"]) for p in places]
    if not all(new["stable"] and old["stable"] for new, old in pairs):
        return []
    return [new["load"]["iae"] / old["load"]["iae"] - 1 for new, old in pairs if old["load"]["iae"] > 0]


def _noise_change(found: Mapping[Place, Any], today: Mapping[Place, Any], places: Sequence[Place]) -> list[float]:
    """How many times more noise moves OP on the plant, of each loop."""
    pairs = [(found[p]["metrics"]["plant"]["noise"], today[p]["metrics"]["plant"]["noise"]) for p in places]
    return [new["op_variation"] / old["op_variation"] for new, old in pairs if new and old and old["op_variation"] > 0]


def _worst_load(found: Mapping[Place, Any], today: Mapping[Place, Any], places: Sequence[Place]) -> float:
    change = _load_change(found, today, places)
    if change:
        return max(change)
    plant = [found[p]["metrics"]["plant"] for p in places]
    return sum(m["load"]["iae"] for m in plant) if all(m["stable"] for m in plant) else float("inf")


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
