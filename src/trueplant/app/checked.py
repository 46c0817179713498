"""What `check` says of a project's data, in short, and the screen that mends each thing."""

from __future__ import annotations

from typing import Any

from trueplant.calendar import duration
from trueplant.result import Check, Code, Status

SCREENS = {
    Code.RECORD: "trends",
    Code.NO_DATA: "trends",
    Code.NO_EXCITATION: "trends",
    Code.TOO_LARGE: "model",
    Code.NOTHING_TO_ESTIMATE: "model",
    Code.SETPOINT_COMPUTED: "tags",
    Code.SETPOINT_STILL: "trends",
    Code.SETPOINT_RANK: "trends",
    Code.MANUAL: "tags",
    Code.COMPRESSED: "start",
    Code.SCAN: "model",
    Code.HOLD: "tags",
    Code.UNSTABLE_MODEL: "model",
    Code.MODEL_CONVERTED: "model",
    Code.CASCADE: "tags",
}
"""Where what a reason is about can be mended; what is not named here is a matter of the record."""
MOST = 4
"""Findings of a record that are shown at once."""


def told_check(found: Check) -> dict[str, Any]:
    """For the page: a sentence, a line a record, and what to mend where."""
    unit = found.provenance.time_unit
    records = []
    for one in found.data:
        calendar = one.calendar(unit)
        kept = [f"{name} {100 * share:.0f} %" for name, share in one.usable_share.items() if share < 1]
        span, every = calendar.span(*one.span), duration(one.sample_time, unit)
        records.append(
            {
                "name": one.name,
                "said": f"{one.samples} samples, {span}, one every {every}",
                "refused": one.refused or "",
                "usable": f"Usable of PV: {', '.join(kept)}" if kept else "",
                "moves": [moves.message for moves in one.setpoints],
                "findings": [finding.message for finding in one.findings[:MOST]],
                "more": max(0, len(one.findings) - MOST),
            }
        )
    reasons = [
        {
            "message": "" if reason.message in found.headline else reason.message,
            "where": reason.where,
            "screen": SCREENS.get(reason.code, "trends"),
        }
        for reason in found.reasons
        if reason.code != Code.RECORD
    ]
    return {
        "usable": found.status == Status.OK,
        "headline": found.headline,
        "records": records,
        "reasons": reasons,
    }
