"""The declared controllers and columns as the rooms `loop` and `record` take them."""

from __future__ import annotations

from collections.abc import Sequence

from trueplant import loop
from trueplant.calendar import unit_seconds
from trueplant.errors import LoopError, ProjectError, SignConflict
from trueplant.lti import TransferMatrix, parse_pv, tf, to_formula
from trueplant.project.declaration import Declaration
from trueplant.project.fields import Limits
from trueplant.project.law_table import Controller
from trueplant.record.layout import Channel, Layout


def controller_of(
    project: Declaration, laws: Sequence[Controller], limits: Sequence[Limits | None]
) -> loop.Controller | None:
    """The laws as one controller, (n_u, n_y); ``limits`` are those of OP, one for each input."""
    if not laws:
        return None
    entries = {}
    for law in laws:
        j, i = project.output_names.index(law.output), project.input_names.index(law.input)
        try:
            entries[i, j] = _entry(project, law, j, i, limits[i])
        except LoopError as error:
            raise ProjectError(f"{project.source}: controller from {law.output} to {law.input}: {error}") from error
    return loop.Controller(entries, len(project.inputs), len(project.outputs))


def check_signs(
    project: Declaration, laws: Sequence[Controller], plant: TransferMatrix, controller: loop.Controller
) -> None:
    """`check_loop`, whose SignConflict names the signals, their columns and the keys to change."""
    try:
        loop.check_loop(plant, controller)
    except SignConflict as error:
        i, j = error.place
        output, input_ = project.outputs[j], project.inputs[i]
        law = next(law for law in laws if (law.input, law.output) == (input_.name, output.name))
        own, its = ("positive", "negative") if controller.entries[i, j].sign > 0 else ("negative", "positive")
        key = next(key for key in ("tf", "Kc", "gain", "PB", "Kp", "Ki", "Kd") if getattr(law, key))
        change = 'remove its action = "direct"' if law.action == "direct" else 'set its action = "direct"'
        raise SignConflict(
            f"{project.source}: the loop of output {output.name} (PV {output.pv}) and input {input_.name} "
            f"(OP {input_.op}) feeds back positively: its [[controller]] has a {own} gain "
            f'({key} = {getattr(law, key)}, action = "{law.action or "reverse"}"), its [[model]] a {its} one '
            f"({to_formula(plant[j, i])}), and in u = Q (r - y) both need the same sign. If the model is right, "
            f"{change}, or change the sign of {key}; if it is not, change the sign in its tf",
            error.place,
        ) from None


def law_gains(law: Controller, time_unit: str) -> dict[str, float]:
    """Gains and times of a PID by the keys of `loop.PID`, times in the project's unit, whatever they were given in."""
    if law.kind == "parallel":
        unit = 1.0 if law.shown_by is None else unit_seconds(law.shown_by.time_unit) / unit_seconds(time_unit)
        filtering = {} if law.Tf is None else {"Tf": law.Tf * unit}
        return {"Kp": law.Kp or 0.0, "Ki": (law.Ki or 0.0) / unit, "Kd": (law.Kd or 0.0) * unit, **filtering}
    minute, second = (unit_seconds(one) / unit_seconds(time_unit) for one in ("min", "s"))
    preset = None if law.shown_by is None else law.shown_by.alpha
    said = {
        "Kc": (law.Kc, law.gain, None if law.PB is None else 100 / law.PB),
        "Ti": (
            law.Ti,
            None if law.repeats_per_minute is None else minute / law.repeats_per_minute,
            None if law.reset_minutes is None else law.reset_minutes * minute,
            None if law.reset_seconds is None else law.reset_seconds * second,
        ),
        "Td": (
            law.Td,
            None if law.rate_minutes is None else law.rate_minutes * minute,
            None if law.rate_seconds is None else law.rate_seconds * second,
        ),
        "alpha": (law.alpha, preset),
    }
    told = {key: next((value for value in values if value is not None), None) for key, values in said.items()}
    return {key: value for key, value in told.items() if value is not None}


def _entry(project: Declaration, law: Controller, j: int, i: int, limits: Limits | None) -> loop.PID | loop.Linear:
    ranges = (project.inputs[i].span, project.outputs[j].span)
    spans = [None if span is None else span[1] - span[0] for span in ranges]
    if law.tf is not None:
        factor = -1.0 if law.action == "direct" else 1.0
        if law.in_percent:
            factor *= (spans[0] or 0.0) / (spans[1] or 1.0)
        return loop.Linear(tf(law.tf) * factor, sample_time=law.sample_time, limits=limits)
    return loop.PID(
        form=law.kind,
        **law_gains(law, project.time_unit),
        action=law.action,
        gain_unit="percent of span" if law.in_percent else "engineering",
        op_span=spans[0],
        pv_span=spans[1],
        setpoint_weight=law.setpoint_weight,
        setpoint_filter=None if law.setpoint_filter is None else tf(law.setpoint_filter),
        derivative_on=law.derivative_on,
        sample_time=law.sample_time,
        anti_windup="none" if limits is None else law.anti_windup,
        limits=limits,
        pv_transform=None if law.pv_transform is None else parse_pv(law.pv_transform),
    )


def layout_of(project: Declaration) -> Layout:
    """Which column is what, and how time is written."""
    data = project.data
    return Layout(
        outputs=tuple(
            Channel(
                e.name, e.pv, sp=e.sp, unit=e.unit, limits=e.limits, status=e.status, keep=tuple(dict.fromkeys(e.keep))
            )
            for e in project.outputs
        ),
        inputs=tuple(
            Channel(
                e.name,
                e.op,
                unit=e.unit,
                limits=e.limits,
                mode=e.mode,
                hold=e.hold,
                slave_sp=e.slave_sp,
                slave_pv=e.slave_pv,
                automatic_values=tuple(e.automatic_values) or None,
                status=e.status,
            )
            for e in project.inputs
        ),
        disturbances=tuple(Channel(e.name, e.column, unit=e.unit, hold=e.hold) for e in project.disturbances),
        time=data.time if data.source is None else "time",
        time_unit=data.time_unit or project.time_unit,
        time_unit_declared=data.time_unit is not None,
        time_format=data.time_format,
        project_time_unit=project.time_unit,
        time_zone=data.time_zone,
        separator=data.separator,
        encoding=data.encoding,
        sheet=data.sheet,
        tag=data.tag,
        value=data.value,
        quality=data.quality,
        most=data.max_samples or Layout.most,
        sample_time=data.sample_time,
        max_gap=data.max_gap,
    )
