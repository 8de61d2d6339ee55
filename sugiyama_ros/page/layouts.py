"""Layout of panels for Lichtblick and Foxglove.

In these programs a path begins with the name of one topic, and no pattern may stand for several topics. So a layout
names the topics of all vehicles of a recording. In Lichtblick and Foxglove, ``/drivers.speed[:]`` stands for all
drivers of a recording that was made with ``--array``, however many there are.
"""

import json
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from sugiyama_ros.formats.truth import namespaces
from sugiyama_ros.page.panels.base import COLOURS, GREY

# Colours that tell vehicles apart; grey stands for all of them.
_COLOURS = COLOURS[1:]


class _Curve(NamedTuple):
    """A quantity of each driver: its panel, its topic and field, and its field in the topic of all drivers."""

    panel: str
    title: str
    unit: str
    topic: str
    field: str
    together: str = ""


_POSITION = "Measured positions of all vehicles [m]"
_SPEED = _Curve("speed", "Filtered speed", "m/s", "state", "speed", "speed")
_ERROR = _Curve("innovation", "One-step error", "m", "innovation", "innovation_m", "innovation_m")
_ACTION = _Curve("action", "Mean action", "m/s²", "state", "mean_action", "mean_action")
# the order of these parameters in the message is declared with the driver's parameters
_V_STAR = _Curve("parameters", "Desired speed v*", "m/s", "parameters", "value[2]")
_KAPPA_V = _Curve("premium", "Risk premium kappa_v", "s", "parameters", "value[3]")
# The camera of the 3D panel, which looks down on the road.
_CAMERA: dict[str, Any] = {
    "perspective": False, "distance": 120, "phi": 0, "thetaOffset": 0, "target": [0, 0, 0], "targetOffset": [0, 0, 0],
    "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.5, "far": 5000,
}  # fmt: skip


def lichtblick(vehicles: Iterable[int]) -> str:
    """Layout for Lichtblick and Foxglove."""
    spaces = namespaces(vehicles)
    curves = (_SPEED, _ERROR, _ACTION, _V_STAR, _KAPPA_V)
    plots = {
        f"Plot!{one.panel}": _plot(f"{one.title} of all drivers [{one.unit}]", _paths(one, spaces)) for one in curves
    }
    plots["Plot!position"] = _plot(_POSITION, [_path("/measured.position_m[:]", "all vehicles", GREY)])
    others: dict[str, Any] = {
        "3D!road": {
            "cameraState": _CAMERA,
            "followMode": "follow-none",
            "followTf": "road",
            "topics": {"/markers": {"visible": True}},
            **{name: {} for name in ("scene", "transforms", "layers", "publish", "imageMode")},
        },
        "RawMessages!verdict": {"topicPath": "/verdict", "diffEnabled": False, "diffMethod": "custom",
                                "diffTopicPath": "", "showFullMessageForDiff": False, "expansion": "all"},
        "DiagnosticSummary!all": {"minLevel": 0, "pinnedIds": [], "hardwareIdFilter": "",
                                  "topicToRender": "/diagnostics", "sortByLevel": True},
    }  # fmt: skip
    left = _split("column", "3D!road", _split("row", "RawMessages!verdict", "DiagnosticSummary!all"), 60)
    rows = [_split("row", f"Plot!{a}", f"Plot!{b}") for a, b in (("position", "speed"), ("innovation", "action"))]
    right = _split("column", rows[0], _split("column", rows[1], _split("row", "Plot!parameters", "Plot!premium")), 34)
    document = {
        "configById": {**others, **plots},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", left, right, 34),
    }
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"


def _paths(one: _Curve, spaces: Sequence[str]) -> list[dict[str, Any]]:
    together = [_path(f"/drivers.{one.together}[:]", "all drivers", GREY)] if one.together else []
    return together + [
        _path(f"{space}/{one.topic}.{one.field}", space.lstrip("/").replace("_", " "), _COLOURS[k % len(_COLOURS)])
        for k, space in enumerate(spaces)
    ]


def _path(value: str, label: str, colour: str) -> dict[str, Any]:
    return {"value": value, "enabled": True, "timestampMethod": "headerStamp", "label": label, "color": colour}


def _plot(title: str, paths: Sequence[dict[str, Any]]) -> dict[str, Any]:
    shown = {"showXAxisLabels": True, "showYAxisLabels": True, "showLegend": False, "legendDisplay": "floating"}
    rest = {"showPlotValuesInLegend": False, "isSynced": True, "xAxisVal": "timestamp", "sidebarDimension": 240}
    return {"title": title, "paths": paths, **shown, **rest}


def _split(direction: str, first: Any, second: Any, percent: int = 50) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percent}
