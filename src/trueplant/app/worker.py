"""The process of an analysis: it loads the program, waits for one task on standard input, does it, and ends.

It speaks in lines of JSON: what stage it is at, and how it ended. When its input is closed it ends at once, so that
nothing is left of an app that was killed.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import warnings
from pathlib import Path
from typing import IO, Any

from trueplant.app import levels
from trueplant.details import write_details
from trueplant.errors import TrueplantError
from trueplant.threads import ask_for_one


def main() -> None:
    """Of ``python -m trueplant.app.worker``."""
    tell = _Teller()
    if hasattr(os, "nice"):
        os.nice(levels.NICE)
    ask_for_one()
    warnings.simplefilter("ignore")  # as the command line has it: what is to be known are findings
    _load()
    tell(ready=True)
    line = sys.stdin.readline()
    if not line:
        return
    task = json.loads(line)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        tell(**_done(task, tell))
    except TrueplantError as error:
        tell(failed=str(error))
    except BaseException as error:
        details = write_details()
        tell(failed=f"internal error ({type(error).__name__}); the details were written to {details}")
    os._exit(0)  # the files are written; what the libraries would tidy up takes a second


def _load() -> None:
    """What every analysis imports, so that the next begins at once."""
    import trueplant.notebook.saved
    import trueplant.report.page
    import trueplant.study.pipeline  # noqa: F401


def _done(task: dict[str, Any], tell: _Teller) -> dict[str, Any]:
    from trueplant.compiled import compiling
    from trueplant.notebook.saved import analyse_into
    from trueplant.output import claim_results, prepare_output
    from trueplant.project import Project

    os.chdir(task["folder"])
    project = Project.load(Path(task["project"]))
    folder = prepare_output(task["out"])
    claim_results(folder, project, bool(task.get("force")))
    with compiling(lambda begun: tell(compiling=begun)):
        result, _ = analyse_into(project, folder, lambda stage: tell(stage=stage))
    return {"done": str(result.status), "headline": result.headline}


class _Teller:
    """Lines to the app on what was standard output; whatever else prints goes to standard error."""

    def __init__(self) -> None:
        self._out: IO[str] = os.fdopen(os.dup(1), "w", encoding="utf-8")
        os.dup2(2, 1)
        self._lock = threading.Lock()

    def __call__(self, **said: Any) -> None:
        with self._lock:
            try:
                self._out.write(json.dumps(said) + "\n")
                self._out.flush()
            except OSError:  # nobody listens any more
                os._exit(1)


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    main()
