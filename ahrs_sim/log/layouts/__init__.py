"""Layouts of viewers that open our logs without editing.

`ahrs_sim.json` fits the shipped circuit; `ahrs-sim export LOG --to layout` makes one with the names of any log of ours.
Foxglove and Lichtblick take both (Layouts, Import from file). Their plots know fields of messages and hardly anything
derived from them, and load whole messages of a whole flight (540 000 states of the circuit do not fit their cache): for
their sake our logs have angles, biases and errors as topics of their own, ten times a second.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from ahrs_sim.errors import InputError
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.topics import TRUTH_ATTITUDE

Node = str | dict[str, Any]

_COLORS = ("#2563eb", "#dc2626", "#059669", "#d97706", "#7c3aed", "#0891b2", "#be185d", "#4d7c0f", "#92400e", "#475569")


def describe() -> list[dict[str, Any]]:
    """List name and path of every shipped layout, and the viewers that import it."""
    folder = Path(str(resources.files(__name__)))
    return [
        {"name": path.stem, "path": str(path), "for": "Foxglove and Lichtblick: Layouts, Import from file"}
        for path in sorted(folder.glob("*.json"))
    ]


def of_log(path: Path, output: Path) -> Path:
    """Write the layout for a log of ours.

    Raises:
        InputError: not such a log, or an output that cannot be written.
    """
    with FlightReader(path) as log:
        if TRUTH_ATTITUDE.topic not in log.topics:
            raise InputError(f"{path}: no {TRUTH_ATTITUDE.topic} in it: only logs of our flights have a layout")
        text = json.dumps(build(log.suites, log.estimators), indent=1) + "\n"
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{output}: cannot be written: {error.strerror or error}") from None
    return output


def build(suites: Mapping[str, Sequence[str]], estimators: Sequence[str]) -> dict[str, Any]:
    """Make a layout, fit for JSON: 3-D and events beside attitude, errors, sensors and biases.

    Args:
        suites: instruments (keys of `topics.INSTRUMENTS`) by suite.
        estimators: their names.
    """
    panels: dict[str, Any] = {}

    def plot(
        key: str,
        title: str,
        paths: Iterable[tuple[str, str]],
        colors: Sequence[str] = _COLORS,
        limit: float | None = None,
    ) -> Node:
        panels[f"Plot!{key}"] = {
            "foxglovePanelTitle": title,
            "paths": [
                {"value": value, "label": label, "enabled": True, "timestampMethod": "receiveTime", "color": color}
                for (value, label), color in zip(paths, [*colors, *_COLORS, *_COLORS, *_COLORS], strict=False)
            ],
            "xAxisVal": "timestamp",
            "isSynced": True,
            "showLegend": True,
            "legendDisplay": "left",
            "showPlotValuesInLegend": False,
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "sidebarDimension": 100,
        } | ({"minYValue": -limit, "maxYValue": limit} if limit else {})
        return f"Plot!{key}"

    def vectors(topic: str, field: str) -> list[tuple[str, str]]:
        return [(f"{topic}.{field}.{axis}", axis) for axis in "xyz"]

    def angles(key: str, title: str, field: str, *more: tuple[str, str], topic: str = "errors") -> Node:
        paths = [(f"/est/{name}/{topic}.{field}.@rad2deg", name) for name in estimators]
        return plot(key, f"{title}, deg", [*paths, *more], [*_COLORS[: len(estimators)], "#888888"])

    axes = ("roll", "pitch", "heading")
    attitude = [
        angles(axis, axis, axis, (f"{TRUTH_ATTITUDE.topic}.{axis}.@rad2deg", "truth"), topic="attitude")
        for axis in axes
    ]
    tabs = [
        {"title": "Attitude", "layout": _stack(attitude)},
        {"title": "Errors", "layout": _stack([angles(f"{x}_error", f"{x} error", x) for x in (*axes, "tilt")])},
        {"title": "Claimed σ", "layout": _stack([angles(f"{x}_sigma", f"{x}, one sigma", f"{x}_sigma") for x in axes])},
    ]
    for suite, instruments in suites.items():
        sensors = {
            "imu": [
                ("gyro", "angular rate, rad/s", vectors(f"/{suite}/imu/data_raw", "angular_velocity")),
                ("accel", "specific force, m/s²", vectors(f"/{suite}/imu/data_raw", "linear_acceleration")),
            ],
            "mag": [("mag", "magnetic field, T", vectors(f"/{suite}/imu/mag", "magnetic_field"))],
            "velocity": [("velocity", "GNSS velocity (NED), m/s", vectors(f"/{suite}/gps/vel", "twist.linear"))],
            "air": [
                ("air", "airspeed, m/s", [(f"/{suite}/air/data.airspeed", suite), ("/truth/air.airspeed", "truth")])
            ],
        }
        nodes = [
            # Left alone, a plot in tesla shows a line of zeros.
            plot(f"{suite}_{key}", f"{suite}: {title}", paths, limit=7e-5 if instrument == "mag" else None)
            for instrument, plots in sensors.items()
            if instrument in instruments
            for key, title, paths in plots
        ]
        tabs.append({"title": f"Sensors {suite}", "layout": _stack(nodes)})
    biases = [
        plot(
            f"bias_{axis}",
            f"gyro bias {axis}, rad/s",
            [
                *((f"/est/{name}/biases.gyro_bias.{axis}", name) for name in estimators),
                *(
                    (f"/{s}/imu/errors.gyro_effective_bias.{axis}", f"{s} truth")
                    for s in suites
                    if "imu_errors" in suites[s]
                ),
            ],
            [*_COLORS[: len(estimators)], "#888888", "#bbbbbb"],
        )
        for axis in "xyz"
    ]
    tabs.append({"title": "Biases", "layout": _stack(biases)})
    panels["Tab!main"] = {"activeTabIdx": 0, "tabs": tabs}
    panels["RawMessages!events"] = {"foxglovePanelTitle": "Events", "topicPath": "/events", "diffEnabled": False}
    panels["3D!aircraft"] = _scene()
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": {
                "direction": "column",
                "first": "3D!aircraft",
                "second": "RawMessages!events",
                "splitPercentage": 75,
            },
            "second": "Tab!main",
            "splitPercentage": 38,
        },
    }


def _stack(nodes: list[Node]) -> Node:
    """Stack panels one above the other, all of the same height."""
    first, *rest = nodes
    if not rest:
        return first
    return {"direction": "column", "first": first, "second": _stack(rest), "splitPercentage": 100 / len(nodes)}


def _scene() -> dict[str, Any]:
    """Make the scene: the aircraft's frame over a grid, seen from behind, in axes that do not turn with it."""
    return {
        "foxglovePanelTitle": "Aircraft",
        "followTf": "base_link",
        "followMode": "follow-position",
        "cameraState": {
            "perspective": True,
            "distance": 14,
            "phi": 62,
            "thetaOffset": 60,
            "targetOffset": [0, 0, 0],
            "target": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.5,
            "far": 5000,
        },
        "scene": {"transforms": {"axisScale": 3, "labelSize": 0.3}},
        # Only the axes that point forward, left, up: those of FRD lie in the same place.
        "transforms": {"frame:base_link_frd": {"visible": False}, "frame:map_ned": {"visible": False}},
        "topics": {},
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid",
                "instanceId": "grid",
                "label": "Grid",
                "visible": True,
                "frameId": "map",
                "size": 2000,
                "divisions": 100,
                "lineWidth": 1,
                "color": "#88888866",
                "position": [0, 0, 0],
                "rotation": [0, 0, 0],
                "order": 1,
            }
        },
        "publish": {},
        "imageMode": {},
    }
