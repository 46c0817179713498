"""The process of an errand, a track or a bundle: it takes one task from standard input, does it, and ends.

It speaks in lines of JSON, as the process of an analysis does, and ends when its input is closed.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import warnings
from pathlib import Path
from typing import Any

from trueplant.app import levels
from trueplant.app.worker import _Teller as Teller
from trueplant.details import write_details
from trueplant.errors import TrueplantError
from trueplant.threads import ask_for_one


def main() -> None:
    """Of ``python -m trueplant.app.errand_worker``."""
    tell = Teller()
    if hasattr(os, "nice"):
        os.nice(levels.NICE)
    ask_for_one()
    warnings.simplefilter("ignore")
    line = sys.stdin.readline()
    if not line:
        return
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        tell(done=_done(json.loads(line), tell))
    except TrueplantError as error:
        tell(failed=str(error))
    except BaseException as error:
        tell(failed=f"internal error ({type(error).__name__}); the details were written to {write_details()}")
    os._exit(0)  # the files are written


def _done(task: dict[str, Any], tell: Teller) -> dict[str, Any]:
    from trueplant.notebook.errands import INSIDE, bundle_into, claim_track, track_into
    from trueplant.output import prepare_output
    from trueplant.project import Project

    os.chdir(task["folder"])
    project = Project.load(Path(task["project"]))
    out, force = Path(task["out"]), bool(task.get("force"))

    def say(stage: str) -> None:
        tell(stage=stage)

    if task["kind"] == "bundle":
        bundled = bundle_into(project, out, force, say)
        return {"names": bundled.names.name, "files": list(bundled.files), "said": list(INSIDE)}
    folder = prepare_output(out)
    claim_track(project, folder, force)
    found, _ = track_into(project, folder, float(task["precision"]) / 100, say)
    return {"headline": found.headline, "status": str(found.status)}


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    main()
