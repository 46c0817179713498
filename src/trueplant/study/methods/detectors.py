"""The published detectors on the records of a study, as in result.json; they run on request only."""

from __future__ import annotations

from typing import Any

from trueplant.detect import published
from trueplant.study.study import Study


def published_detections(study: Study) -> list[dict[str, Any]]:
    """One entry for each detector asked for in [analysis]; empty where none was, or no data are left."""
    settings, segments = study.project.analysis, study.segments
    if not segments:
        return []
    k = study.loop_experiment
    controller = None if k is None else study.records.declared[k]
    entries = []
    for name in settings.detectors:
        found = published(name, segments, study.model, controller, settings.confidence)
        entry: dict[str, Any] = {"name": name, "refused": found.refusal, "note": found.note, "elements": []}
        if found.refusal is None:
            entry["elements"] = [
                {
                    "output": output,
                    "input": study.project.input_names[j],
                    "statistic": float(found.statistic[i, j]),
                    "threshold": float(found.threshold[i, j]),
                    "flagged": bool(found.flagged[i, j]),
                    "kind": found.kinds[i][j] if found.kinds else "",
                }
                for i, output in enumerate(study.project.output_names)
                for j in range(found.statistic.shape[1])
            ]
        entries.append(entry)
    return entries
