"""What the tables of a project must say together: every name refers to something, and nothing is said twice."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from trueplant.errors import DataError, FormulaError
from trueplant.lti import tf
from trueplant.lti.structure import structure_of
from trueplant.project.declaration import Declaration
from trueplant.project.fields import problem
from trueplant.project.law_table import Controller
from trueplant.project.model_table import ModelElement


def check_project(project: Declaration) -> None:
    """Raise the first contradiction found, with the path of its key."""
    _check_names(project)
    _check_references(project)
    _check_experiments(project)
    _check_controllers(project, project.controllers, ())
    _check_candidates(project)
    _check_simulation(project)
    _check_tuning(project)


def _check_tuning(project: Declaration) -> None:
    """Spans and notations that the answer is asked in must exist for every loop."""
    tuning = project.tuning
    if tuning is None:
        return
    weights = project.robustness
    if tuning.limits.mu is not None and (weights is None or weights.wI is None or weights.wP is None):
        raise problem(
            "needs the weights that it is a limit for: declare wI and wP in [robustness], or leave it out",
            "tuning",
            "limits",
            "mu",
        )
    for law in project.controllers:
        percent = law.in_percent if tuning.gain_unit is None else tuning.gain_unit == "percent of span"
        percent = percent or tuning.vendor is not None
        i, j = project.input_names.index(law.input), project.output_names.index(law.output)
        if percent and None in (project.inputs[i].span, project.outputs[j].span):
            text = f"percent of span needs a span of {law.input} and of {law.output}: add span = [low, high] to both"
            raise problem(text, "tuning", "gain_unit" if tuning.vendor is None else "vendor")
        if tuning.gain == "proportional band" and not percent:
            raise problem(
                'a proportional band is in percent of span: add gain_unit = "percent of span"', "tuning", "gain"
            )


def _check_names(project: Declaration) -> None:
    seen: set[str] = set()
    for table, names in (
        ("output", project.output_names),
        ("input", project.input_names),
        ("disturbance", project.disturbance_names),
    ):
        for k, name in enumerate(names):
            if name in seen:
                raise problem(f'"{name}" is there twice: every signal has a name of its own', table, k, "name")
            seen.add(name)
    for k, entry in enumerate(project.outputs):
        if entry.sp == entry.pv:
            raise problem(f'column "{entry.sp}" is the PV of this loop: name that of its set-point', "output", k, "sp")
    columns = [("output", k, "pv", entry.pv) for k, entry in enumerate(project.outputs)]
    columns += [("input", k, "op", entry.op) for k, entry in enumerate(project.inputs)]
    used: set[str] = set()
    for table, k, key, column in columns:
        if column in used:
            raise problem(f'column "{column}" is the PV or OP of another signal already', table, k, key)
        used.add(column)


def _check_references(project: Declaration) -> None:
    outputs, sources = project.output_names, (*project.input_names, *project.disturbance_names)
    seen: dict[tuple[str, str], int] = {}
    for k, element in enumerate(project.model):
        _known(element.output, outputs, "[[output]]", "model", k, "output")
        _known(element.input, sources, "[[input]] or [[disturbance]]", "model", k, "input")
        pair = (element.output, element.input)
        if pair in seen:
            text = f"{pair[1]} -> {pair[0]} is declared already as model[{seen[pair] + 1}]: keep one of them"
            raise problem(text, "model", k)
        seen[pair] = k
        _check_element(project, element, ("model", k))
    for k, entry in enumerate(project.unmeasured):
        _known(entry.output, outputs, "[[output]]", "unmeasured", k, "output")
    _check_errors(project)


def _check_errors(project: Declaration) -> None:
    """Real errors in [robustness] are of elements of the model, and there are some."""
    declared = None if project.robustness is None else project.robustness.elements
    if declared is None:
        return
    errors = declared if isinstance(declared, list) else [declared]
    if not any(error.gain_percent or error.dead_time for error in errors):
        text = "has no error: add gain_percent or dead_time above 0, or leave it out"
        raise problem(text, "robustness", "elements")
    there = {(element.output, element.input) for element in project.model}
    seen: set[tuple[str, str]] = set()
    for k, error in enumerate(declared if isinstance(declared, list) else ()):
        _known(error.output, project.output_names, "[[output]]", "robustness", "elements", k, "output")
        _known(error.input, project.input_names, "[[input]]", "robustness", "elements", k, "input")
        pair = (error.output, error.input)
        if pair in seen:
            text = f"{error.input} -> {error.output} is declared twice: keep one of them"
            raise problem(text, "robustness", "elements", k)
        if there and pair not in there:
            text = f"the model has no element {error.input} -> {error.output}: leave it out, or declare the element"
            raise problem(text, "robustness", "elements", k)
        seen.add(pair)


def _check_element(project: Declaration, element: ModelElement, where: tuple[str | int, ...]) -> None:
    """Gains in percent have spans, and an element that is to be estimated has a structure with parameters.

    What a file holds is checked when it is read.
    """
    _check_spans(project, element, where)
    if element.tf is None or not element.estimate or element.structure not in (None, "auto"):
        return
    system = tf(element.tf)
    if system.is_zero:
        return
    try:
        structure_of(system)
    except FormulaError as error:
        text = f"{error}; name the structure of the plant's element (structure = ...) or set estimate = false"
        raise problem(text, *where, "tf") from error


def _check_spans(project: Declaration, element: ModelElement, where: tuple[str | int, ...]) -> None:
    if element.gain_unit == "engineering":
        return
    if element.input in project.disturbance_names:
        text = "a measured disturbance has no span: give this element in engineering units"
        raise problem(text, *where, "gain_unit")
    for name, entries, table in (
        (element.output, project.outputs, "output"),
        (element.input, project.inputs, "input"),
    ):
        entry = next(one for one in entries if one.name == name)
        if entry.span is None:
            text = f'"percent of span" needs the span: add span = [low, high] to the {table} "{name}"'
            raise problem(text, *where, "gain_unit")


def _check_experiments(project: Declaration) -> None:
    if project.data.source is not None:
        _check_source(project)
    if project.data.files and project.declared_experiments:
        raise problem("files and [[experiment]] say the same in two ways: keep one of them", "data", "files")
    own = project.data.files if project.data.source is None else [project.snapshot]
    files = own or [entry.file for entry in project.declared_experiments]
    for k, exclude in enumerate(project.data.exclude):
        if exclude.file is not None:
            _known(exclude.file, files, "data.files or [[experiment]]", "data", "exclude", k, "file")
    for k, experiment in enumerate(project.declared_experiments):
        for name in experiment.limits:
            _known(name, project.input_names, "[[input]]", "experiment", k, "limits", name)
        where = ("experiment", k, "controllers")
        _check_controllers(project, project.overridden(experiment.controllers, where), where)


def _check_source(project: Declaration) -> None:
    if project.declared_experiments:
        text = (
            "and [data.source] say where the data are in two ways: take [data.source] out, and name the snapshot that "
            "was fetched as the file of each [[experiment]]"
        )
        raise problem(text, "experiment")
    try:
        _ = project.window
    except DataError as error:
        raise problem(str(error), "data", "from") from None


def _check_candidates(project: Declaration) -> None:
    """Settings to be judged stand for a controller that is there."""
    _check_controllers(project, project.candidates, (), "candidate")
    there = {(law.input, law.output) for law in project.controllers}
    for k, law in enumerate(project.candidates):
        if (law.input, law.output) not in there:
            text = f"there is no [[controller]] from {law.output} to {law.input} to be judged beside: declare it too"
            raise problem(text, "candidate", k)


def _check_controllers(
    project: Declaration, controllers: Iterable[Controller], where: tuple[str | int, ...], table: str = "controller"
) -> None:
    outputs = {entry.name: entry for entry in project.outputs}
    inputs = {entry.name: entry for entry in project.inputs}
    seen: set[tuple[str, str]] = set()
    for k, law in enumerate(controllers):
        place = where or (table, k)
        _known(law.input, inputs, "[[input]]", *place, "input")
        _known(law.output, outputs, "[[output]]", *place, "output")
        if (law.input, law.output) in seen:
            raise problem(f"a {table} from {law.output} to {law.input} is declared already", *place)
        seen.add((law.input, law.output))
        if "anti_windup" in law.model_fields_set and law.anti_windup != "none" and inputs[law.input].limits is None:
            text = f'needs the limits of OP: add limits to the input "{law.input}"'
            raise problem(text, *place, "anti_windup")
        if law.in_percent:
            key = "PB" if law.PB is not None else "gain_unit" if law.vendor is None else "vendor"
            for entry, table in ((outputs[law.output], "output"), (inputs[law.input], "input")):
                if entry.span is None:
                    what = "a proportional band is in" if key == "PB" else "this gain is in"
                    text = f'{what} per cent of span: add span = [low, high] to the {table} "{entry.name}"'
                    raise problem(text, *place, key)


def _check_simulation(project: Declaration) -> None:
    if project.simulate is None:
        return
    if project.simulate.plant == "model" and not project.model:
        raise problem("needs a plant: declare [[model]] elements, or name another plant", "simulate", "plant")
    for k, law in enumerate(project.controllers):
        for key, words in law.beyond.items():
            raise problem(f"{words} is not simulated: leave it out here", "controller", k, key)
    outputs = project.output_names
    for k, move in enumerate(project.simulate.setpoints):
        _known(move.output, outputs, "[[output]]", "simulate", "setpoints", k, "output")
        if move.time > project.simulate.duration:
            raise problem("comes after the end (simulate.duration)", "simulate", "setpoints", k, "time")
    sources = (*project.input_names, *project.disturbance_names)
    for name in project.simulate.start:
        _known(name, (*outputs, *sources), "[[output]], [[input]] or [[disturbance]]", "simulate", "start", name)
    _check_loads(project)
    for key in ("noise", "quantisation"):
        table = getattr(project.simulate, key)
        for name in table if isinstance(table, dict) else ():
            _known(name, outputs, "[[output]]", "simulate", key, name)
    if isinstance(project.simulate.plant, list):
        for k, element in enumerate(project.simulate.plant):
            _known(element.output, outputs, "[[output]]", "simulate", "plant", k, "output")
            _known(element.input, sources, "[[input]] or [[disturbance]]", "simulate", "plant", k, "input")
            if element.wanted:
                raise problem("is needed: a plant that is simulated has to be known", "simulate", "plant", k, "tf")
            _check_spans(project, element, ("simulate", "plant", k))


def _check_loads(project: Declaration) -> None:
    """Each load acts at signals that are there, all of one kind."""
    assert project.simulate is not None
    tables = (project.output_names, project.input_names, project.disturbance_names)
    names = [name for table in tables for name in table]
    for k, load in enumerate(project.simulate.loads):
        for name in load.places:
            _known(name, names, "[[output]], [[input]] or [[disturbance]]", "simulate", "loads", k, "at")
        if not any(set(load.places) <= set(table) for table in tables) or len(set(load.places)) < len(load.places):
            text = "must name signals of one kind, each once: outputs, inputs or measured disturbances"
            raise problem(text, "simulate", "loads", k, "at")


def _known(name: str, names: Iterable[str], table: str, *where: str | int) -> None:
    if name not in (known := list(names)):
        listed = ", ".join(known) if known else "none"
        near = difflib.get_close_matches(name, known, n=1)
        hint = f'; did you mean "{near[0]}"?' if near else ""
        raise problem(f'"{name}" is not declared in {table}, which has: {listed}{hint}', *where)
