"""What the numbers of the inference decide: each level of identify, detect and study doubled and halved.

Every record of `level_records.py` (simulated) is analysed with all levels as they are, and then with one of them
changed at a time; answers are compared. For each level it prints the worst of what happened:

- said otherwise: a status, verdict, structure, grade, code of a note, a sentence (its numbers apart);
- numbers moved: an estimate, its standard error or an end of its interval by 0.1 standard errors or more, or another
  number of the result by more than 5 %, and nothing said otherwise;
- hardly moved: numbers, by less than that;
- nothing: the same to twelve digits;
- not read: by none of these records.

A share or chance is moved in odds, a whole number rounded, all members of a tuple are moved, the points of a grid
halved and filled up. Where it is not read nothing can change, so only the records that read it are run, cheapest
first, up to the seconds allowed for one value, or until something is said otherwise; how many is printed.

Every value is tried in a process of its own, forked from one that has everything loaded. A level that is read while
modules are imported (the default of an argument) is set before they are, and one that compiled code has frozen is set
where nothing compiled is loaded from the store.

    python benchmarks/bench_levels.py [--room identify] [--only NAME ...] [--seconds 5]
"""

from __future__ import annotations

import argparse
import ast
import gc
import importlib
import math
import os
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import _lru_cache_wrapper
from importlib.util import module_from_spec, spec_from_file_location
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from level_records import FIRST, RECORDS, WHOLE

import trueplant.compiled

ROOMS = ("identify", "detect", "study")
SOURCE = Path(trueplant.compiled.__file__).parent
IN_ODDS = re.compile(r"significance|chance|probab|share|part of|this part|p-value|power\b|that a fit", re.IGNORECASE)
NOTHING, HARDLY, MOVED, SAID, UNREAD = "nothing", "hardly moved", "numbers moved", "said otherwise", "not read"
CLASSES = (SAID, MOVED, HARDLY, NOTHING, UNREAD)
ERRORS, RELATIVE = 0.1, 0.05
PATIENCE = 240.0
"""Seconds after which a process that says nothing is ended."""


# -- the levels ------------------------------------------------------------------------------------------------------


def documented(room: str) -> dict[str, str]:
    """Docstrings of the levels of a room, by name."""
    body = ast.parse((SOURCE / room / "levels.py").read_text(encoding="utf-8")).body
    found = {}
    for statement, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(statement, ast.Assign):
            said = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
            names = [part.id for target in statement.targets for part in ast.walk(target) if isinstance(part, ast.Name)]
            found |= dict.fromkeys(names, str(said))
            used = {part.id for part in ast.walk(statement.value) if isinstance(part, ast.Name)} & found.keys()
            assert not used, f"{names} are made from {used}: change them together"
    return found


def loaded(room: str, kind: type[ModuleType] = ModuleType) -> ModuleType:
    """The levels of a room, in place before anything imports them."""
    name = f"trueplant.{room}.levels"
    spec = spec_from_file_location(name, SOURCE / room / "levels.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    module.__class__ = kind
    sys.modules[name] = module
    return module


def compiled_in(room: str) -> set[str]:
    """Levels that are read by functions of the room that are compiled: they are frozen in them."""
    found = set()
    for file in (SOURCE / room).rglob("*.py"):
        for function in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            marks = function.decorator_list if isinstance(function, ast.FunctionDef) else []
            if any("compiled" in ast.dump(mark) for mark in marks):
                found |= {
                    part.attr
                    for part in ast.walk(function)
                    if isinstance(part, ast.Attribute)
                    and isinstance(part.value, ast.Name)
                    and part.value.id == "levels"
                }
    return found


def moved(value: Any, factor: float, said: str) -> Any:
    """A level doubled (factor 2) or halved (0.5); None where that is nothing else."""
    if isinstance(value, np.ndarray):
        if factor < 1:
            return value[::2]
        return np.sort(np.concatenate([value, (value[1:] + value[:-1]) / 2]))
    if isinstance(value, tuple):
        if isinstance(value[0], tuple):
            return value[: max(len(value) // 2, 1)] if factor < 1 else None
        members = tuple(moved(member, factor, said) for member in value)
        changed = tuple(v if m is None else m for v, m in zip(value, members, strict=True))
        return None if changed == value else changed
    if isinstance(value, int):
        whole = max(round(factor * value), 1) if value > 0 else round(factor * value)
        return None if whole == value else whole
    if 0 < value < 1 and (value >= 0.4 or value < 0.01) and IN_ODDS.search(said):
        odds = factor * value / (1 - value)
        return odds / (1 + odds)
    return factor * value


# -- an answer, and how two differ -----------------------------------------------------------------------------------


def answer(name: str, whole: bool) -> dict[str, Any]:
    """The result of a record as a dictionary; without loops, settings, other methods and plans unless `whole`."""
    from trueplant.study import pipeline
    from trueplant.study.loops.retuning import Retuning
    from trueplant.study.loops.robustness import LoopToday
    from trueplant.study.methods.compare import Compared

    project, frames = RECORDS[name]()
    if whole:
        result = pipeline.analyse(project, frames=frames)
    else:
        nothing = Compared({}, {}, (), (), None)
        left_out = {
            "compare_methods": lambda *_: nothing,
            "robustness_of": lambda *_: LoopToday(),
            "retuning_of": lambda *_: Retuning(),
            "more_data": lambda *_: (),
        }
        with mock.patch.multiple(pipeline, **left_out):
            result = pipeline.analyse(project, frames=frames)
    said = result.to_dict()
    for table in ("curves", "provenance", "uncertainty"):
        said.pop(table, None)
    return said


def flat(value: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if parts is None:
        yield path, value
        return
    yield (*path, "#"), f"{len(value)} entries"
    for key, part in parts:
        yield from flat(part, (*path, str(key)))


NUMBER = re.compile(r"[-−+±]?\d[\d,.]*(e[-+]?\d+)?")
ASIDE = {
    "budget",
    "coherence",
    "p_value",
    "p_adjusted",
    "whiteness_p",
    "input_p",
    "further_p",
    "tf_plant",
    "tf_mismatch",
}
"""Which numbers a verdict is made from, or which stand elsewhere as well."""


def compared(before: dict[str, Any], after: dict[str, Any]) -> tuple[str, str]:
    """The class of a change, and where it is largest."""
    old, new = dict(flat(before)), dict(flat(after))
    worst, size, where, same = HARDLY, 0.0, "", True
    for path in old.keys() | new.keys():
        a, b = old.get(path), new.get(path)
        if isinstance(a, str):
            a = NUMBER.sub("", a)
        if isinstance(b, str):
            b = NUMBER.sub("", b)
        if a == b:
            continue
        if ASIDE & set(path):
            same = False
            continue
        numbers = [isinstance(x, (int, float)) and not isinstance(x, bool) for x in (a, b)]
        if not all(numbers):
            return SAID, f"{'.'.join(path)}: {str(old.get(path))[:60]!r} -> {str(new.get(path))[:60]!r}"
        by = far(path, a, b, old)
        same &= abs(a - b) <= 1e-12 * max(abs(a), abs(b))
        if by > size:
            size, where = by, f"{'.'.join(path)}: {a:.5g} -> {b:.5g}"
    if same:
        return NOTHING, ""
    return (MOVED if size >= 1 else worst), where


def far(path: tuple[str, ...], a: float, b: float, old: dict[tuple[str, ...], Any]) -> float:
    """A difference over what counts as moved."""
    if not (math.isfinite(a) and math.isfinite(b)):
        return 0.0 if a == b or (math.isnan(a) and math.isnan(b)) else math.inf
    error = next((old[p] for k in (1, 2) if (p := (*path[:-k], "std_error")) in old), None)
    if error:
        return abs(a - b) / error / ERRORS
    return abs(a - b) / max(abs(a), abs(b), 1e-6) / RELATIVE


# -- processes -------------------------------------------------------------------------------------------------------


def apart(work: Callable[[], Any]) -> Any:
    """What `work` returns in a process forked for it; an exception as one, None where it took too long."""
    context = get_context("fork")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(there, work))
    process.start()
    there.close()
    try:
        found = here.recv() if here.poll(PATIENCE) else None
    except EOFError:
        found = None
    if found is None:
        process.terminate()
    process.join()
    return found


def _send(there: Connection, work: Callable[[], Any]) -> None:
    try:
        there.send(work())
    except Exception as error:  # a level may well break something: that is an answer as well
        there.send(error)


class Recording(ModuleType):
    """Levels that remember which of them were read."""

    read: set[str] = set()  # noqa: RUF012

    def __getattribute__(self, name: str) -> Any:
        if name.isupper():
            Recording.read.add(f"{object.__getattribute__(self, '__name__').split('.')[1]}.{name}")
        return object.__getattribute__(self, name)


def everything() -> None:
    """Load all of an analysis."""
    importlib.import_module("trueplant.study.pipeline")


Read = dict[str, tuple[set[str], set[str], float]]


def reading() -> tuple[set[str], Read, dict]:
    """What is read and answered with all levels as they are.

    Levels read at import; by record those read up to the verdicts and in the whole, and CPU seconds of the former; the
    answers by record and whether it went through the whole.
    """
    for room in ROOMS:
        loaded(room, Recording)
    everything()
    at_import, found, base = set(Recording.read), {}, {}
    for name in RECORDS:
        sets = []
        for whole in sorted({name in WHOLE, True}):
            Recording.read.clear()
            begun = time.process_time()
            base[name, whole] = answer(name, whole)
            sets.append((set(Recording.read), time.process_time() - begun))
        found[name] = sets[0][0], sets[-1][0], sets[0][1]
        print(f"  {name:24} {sets[0][1]:5.2f} s, whole {sets[-1][1]:5.2f} s", flush=True)
    return at_import, found, base


def tried(level: str, value: Any, names: list[str], base: dict, early: bool, fresh: bool, seconds: float) -> tuple:
    """The worst that a value of a level does: class, record, where, records tried."""
    room, name = level.split(".")
    if early:
        if fresh:
            none = mock.Mock(load_overload=lambda *_: None, save_overload=lambda *_: None)
            mock.patch.object(trueplant.compiled, "_Forgiving", return_value=none).start()
        module = loaded(room)
        setattr(module, name, value)
        everything()
    else:
        setattr(sys.modules[f"trueplant.{room}.levels"], name, value)
        for cached in [o for o in gc.get_objects() if isinstance(o, _lru_cache_wrapper)]:
            cached.cache_clear()
    worst, count, spent = (NOTHING, "", ""), 0, 0.0
    for record in names:
        whole = room == "study" or record in WHOLE
        begun = time.process_time()
        try:
            kind, where = compared(base[record, whole], answer(record, whole))
        except Exception as error:
            kind, where = SAID, f"{type(error).__name__}: {error}"
        count += 1
        spent += (time.process_time() - begun) * (count > 1 or not early)
        if CLASSES.index(kind) < CLASSES.index(worst[0]):
            worst = kind, record, where
        if worst[0] == SAID or spent > seconds:
            break
    return *worst, count


# -- the table -------------------------------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--room", choices=ROOMS, action="append")
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument(
        "--frozen", action="store_true", help="those alone that compiled code has frozen (a minute each)"
    )
    parser.add_argument("--seconds", type=float, default=5.0, help="of CPU for one value of a level")
    options = parser.parse_args()
    wanted = [f"{room}.{name}" for room in options.room or ROOMS for name in documented(room)]
    wanted = [level for level in wanted if not options.only or level.split(".")[1] in options.only]
    frozen = {f"{room}.{name}" for room in ROOMS for name in compiled_in(room)}
    wanted = [level for level in wanted if (level in frozen) == options.frozen]
    print("records, CPU time up to the verdicts and in the whole", flush=True)
    found = apart(reading)
    if not isinstance(found, tuple):
        raise SystemExit(f"the records could not be analysed: {found}")
    early, read, base = found[0] | frozen, *found[1:]
    found = {
        level: judged(level, read, base, True, level in frozen, options.seconds) for level in wanted if level in early
    }
    everything()
    for name in (*WHOLE, *FIRST, "2 x 2, correlated", "two runs"):
        answer(name, whole=True)  # loads what is compiled
    for level in wanted:
        if level not in early:
            found[level] = judged(level, read, base, False, False, options.seconds)
    summary(wanted, found)


def judged(level: str, read: dict, base: dict, early: bool, fresh: bool, seconds: float) -> str:
    """The class of a level, printed with what its two values do."""
    room, name = level.split(".")
    value = getattr(module_of(room), name)
    part = 1 if room == "study" else 0
    names = sorted((r for r in read if level in read[r][part] or early), key=lambda r: (r not in FIRST, read[r][2]))
    worst = NOTHING if names else UNREAD
    lines = []
    for factor, word in ((2.0, "doubled"), (0.5, "halved")) if names else ():
        changed = moved(value, factor, documented(room)[name])
        if changed is None:
            continue
        got = apart(lambda changed=changed: tried(level, changed, names, base, early, fresh, seconds))
        kind, record, where, count = got if isinstance(got, tuple) else (SAID, "", f"ended: {got}", 0)
        worst = min(worst, kind, key=CLASSES.index)
        lines.append(f"    {word:8} {kind:15} {count:3} of {len(names)} records  {record}  {where}")
    print(f"{level:36} {worst}", *lines, sep="\n", flush=True)
    return worst


def module_of(room: str) -> ModuleType:
    """The levels as they are, without importing the room."""
    name = f"_levels_of_{room}"
    if name not in sys.modules:
        spec = spec_from_file_location(name, SOURCE / room / "levels.py")
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


def summary(wanted: list[str], found: dict[str, str]) -> None:
    for kind in CLASSES:
        names = [level for level in wanted if found[level] == kind]
        print(f"\n{kind}: {len(names)}")
        print("  " + ", ".join(names))
    print(f"\n{'room':10}" + "".join(f"{kind:>16}" for kind in CLASSES) + f"{'all':>8}")
    for room in ROOMS:
        counts = Counter(found[level] for level in wanted if level.startswith(room))
        print(f"{room:10}" + "".join(f"{counts[kind]:16}" for kind in CLASSES) + f"{sum(counts.values()):8}")


if __name__ == "__main__":
    main()
