"""The process that answers what-ifs: it keeps what it needs of a result, and the newest slider position goes first.

It speaks in lines of JSON, as the process of an analysis does, and ends when its input is closed.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
import warnings
from typing import Any

from trueplant.app.mailbox import Mailbox
from trueplant.app.worker import _Teller as Teller
from trueplant.details import write_details
from trueplant.errors import TrueplantError
from trueplant.threads import ask_for_one

KINDS = ("curves", "open", "numbers", "plan")
"""The most urgent first: curves follow a slider, numbers come when it rests."""


def main() -> None:
    """Of ``python -m trueplant.app.whatif_worker``."""
    tell = Teller()
    ask_for_one()
    warnings.simplefilter("ignore")
    box = Mailbox(KINDS)
    threading.Thread(target=_listen, args=(box, tell), daemon=True).start()
    from trueplant.app import whatif_answers

    whatif_answers.warm_up()
    tell(ready=True)
    while (request := box.take()) is not None:
        tell(**_answered(request, box))
    os._exit(0)


def _listen(box: Mailbox, tell: Teller) -> None:
    for line in sys.stdin:
        overtaken = box.put(json.loads(line))
        if overtaken is not None:
            tell(id=overtaken["id"], overtaken=True)
    os._exit(0)  # the app has ended


def _answered(request: dict[str, Any], box: Mailbox) -> dict[str, Any]:
    """The answer, or what went wrong."""
    from trueplant.app import whatif_answers

    begun = time.perf_counter()
    try:
        answer = whatif_answers.answer(request, lambda: box.has("curves", request.get("page", "")))
    except whatif_answers.GivenUp:
        return {"id": request["id"], "overtaken": True}
    except TrueplantError as error:
        return {"id": request["id"], "error": str(error)}
    except Exception as error:
        details = write_details()
        return {"id": request["id"], "error": f"internal error ({type(error).__name__}); see {details}"}
    return {"id": request["id"], "answer": answer, "milliseconds": 1e3 * (time.perf_counter() - begun)}


if __name__ == "__main__":
    main()
