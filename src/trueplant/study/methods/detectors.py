"""The published detectors on the records of a study, as in result.json; they run on request only."""

from __future__ import annotations

from trueplant import detect
from trueplant.detect import published
from trueplant.result import DetectedElement, Detection
from trueplant.study.study import Study


def published_detections(study: Study) -> tuple[Detection, ...]:
    """One entry for each detector asked for in [analysis]; empty where none was, or no data are left."""
    settings, segments = study.project.analysis, study.segments
    if not segments:
        return ()
    k = study.loop_experiment
    controller = None if k is None else study.records.linear[k]
    found = (
        (name, published(name, segments, study.model, controller, settings.confidence)) for name in settings.detectors
    )
    return tuple(Detection(name, one.refusal, one.note, _elements(study, one)) for name, one in found)


def _elements(study: Study, found: detect.Detection) -> tuple[DetectedElement, ...]:
    if found.refusal is not None:
        return ()
    return tuple(
        DetectedElement(
            output=output,
            input=study.project.input_names[j],
            statistic=float(found.statistic[i, j]),
            threshold=float(found.threshold[i, j]),
            flagged=bool(found.flagged[i, j]),
            kind=found.kinds[i][j] if found.kinds else "",
        )
        for i, output in enumerate(study.project.output_names)
        for j in range(found.statistic.shape[1])
    )
