"""The template of each kind of loop of the demo site: an ordinary project with the name of the loop left open."""

from __future__ import annotations

from trueplant.fleet import levels
from trueplant.fleet.demo.truth import Kind


def template_of(kind: Kind) -> str:
    """TOML text with ``{{name}}`` where the name of the loop goes."""
    n = len(kind.Kc)
    parts = [
        f"# A {kind.name} loop. The model is the one of the last step test.\n"
        f'time_unit = "min"\n\n[data]\nsample_time = {kind.sample_time}\n'
        f"max_gap = {levels.DEMO_GAP * kind.sample_time}\n\n"
        '[data.source]\nkind = "parquet"\npath = "lake/*/*.parquet"\n'
    ]
    parts += [_output(kind, j) + _input(kind, j) for j in range(n)]
    parts += [_element(kind, i, j) for i in range(n) for j in range(n)]
    parts += [
        f'[[controller]]\ninput = "{_name("op", kind, j)}"\noutput = "{_name("pv", kind, j)}"\nform = "ideal"\n'
        f"Kc = {kind.Kc[j]}\nTi = {kind.Ti[j]}\nsample_time = {kind.sample_time}\n"
        for j in range(n)
    ]
    return "\n".join(parts)


def _name(what: str, kind: Kind, j: int) -> str:
    return what if len(kind.Kc) == 1 else f"{what}_{'ab'[j]}"


def _tag(kind: Kind, j: int) -> str:
    return "{{name}}" if len(kind.Kc) == 1 else "{{name}}" + "AB"[j]


def _output(kind: Kind, j: int) -> str:
    tag = _tag(kind, j)
    known = f'kind = "{kind.name}"\n' if kind.name in ("flow", "pressure", "level", "temperature") else ""
    names = f'name = "{_name("pv", kind, j)}"\npv = "{tag}.PV"\nsp = "{tag}.SP"\n'
    return f'[[output]]\n{names}unit = "{kind.unit}"\n{known}\n'


def _input(kind: Kind, j: int) -> str:
    tag = _tag(kind, j)
    text = f'[[input]]\nname = "{_name("op", kind, j)}"\nop = "{tag}.OP"\nunit = "%"\nmode = "{tag}.MODE"\n'
    text += "automatic_values = [1]\n"
    return text + (f'slave_sp = "{tag}.SLAVE.SP"\nslave_pv = "{tag}.SLAVE.PV"\n' if kind.slave else "")


def _element(kind: Kind, i: int, j: int) -> str:
    gain, lag, dead_time = kind.gain[i][j], kind.lag[i][j], kind.dead_time[i][j]
    slave = f" ({kind.slave} s + 1)" if kind.slave else ""
    below = f"({lag} s + 1){slave}" if lag else "s"
    below = f"({below})" if slave else below
    tf = f"{gain} exp(-{dead_time} s)/{below}"
    return f'[[model]]\noutput = "{_name("pv", kind, i)}"\ninput = "{_name("op", kind, j)}"\ntf = "{tf}"\n'
