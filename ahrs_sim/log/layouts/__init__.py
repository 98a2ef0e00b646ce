"""Layouts of viewers that open our logs without editing.

`ahrs_sim.json` fits the shipped circuit; `ahrs-sim export LOG --to layout` makes one with the names of any log of ours.
Foxglove and Lichtblick take both (Layouts, Import from file). Their plots know fields of messages and nothing derived
from them, so attitudes are shown as quaternions, and errors are left to the report: a script inside a layout could
make them, but is called for every message of a flight before anything is drawn, which takes minutes.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from ahrs_sim.errors import InputError
from ahrs_sim.log.record import FlightReader

Node = str | dict[str, Any]

_COLORS = ("#2563eb", "#dc2626", "#059669", "#d97706", "#7c3aed", "#0891b2", "#be185d", "#4d7c0f", "#92400e", "#475569")


def describe() -> list[dict[str, Any]]:
    """Name and path of every shipped layout, and which viewers import it."""
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
        if "/truth/odometry" not in log.topics:
            raise InputError(f"{path}: no /truth/odometry in it: only logs of ours have a layout")
        text = json.dumps(build(log.suites, log.estimators), indent=1) + "\n"
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{output}: cannot be written: {error.strerror or error}") from None
    return output


def build(suites: Mapping[str, Sequence[str]], estimators: Sequence[str]) -> dict[str, Any]:
    """A layout, fit for JSON: 3-D and events beside attitude, errors, sensors and biases.

    Args:
        suites: instruments (keys of `record.INSTRUMENTS`) by suite.
        estimators: their names.
    """
    panels: dict[str, Any] = {}

    def plot(key: str, title: str, paths: Iterable[tuple[str, str]], colors: Sequence[str] = _COLORS) -> Node:
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
        }
        return f"Plot!{key}"

    def vectors(topic: str, field: str) -> list[tuple[str, str]]:
        return [(f"{topic}.{field}.{axis}", axis) for axis in "xyz"]

    attitude = [
        plot(
            f"q_{part}",
            f"attitude, quaternion {part}",
            [
                *((f"/est/{n}/imu.orientation.{part}", n) for n in estimators),
                (f"/truth/imu.orientation.{part}", "truth"),
            ],
            [*_COLORS[: len(estimators)], "#888888"],
        )
        for part in "wxyz"
    ]
    sigmas = [
        plot(
            f"variance_{axis}",
            f"claimed attitude variance {axis}, rad²",
            [(f"/est/{n}/state.attitude_covariance[{4 * k}]", n) for n in estimators],
        )
        for k, axis in enumerate("xyz")
    ]
    tabs = [{"title": "Attitude", "layout": _stack(attitude)}, {"title": "Variance", "layout": _stack(sigmas)}]
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
            plot(f"{suite}_{key}", f"{suite}: {title}", paths)
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
                *((f"/est/{name}/state.gyro_bias.{axis}", name) for name in estimators),
                *((f"/{s}/imu/errors.gyro_bias.{axis}", f"{s} truth") for s in suites if "imu_errors" in suites[s]),
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
    """Panels one above the other, all of the same height."""
    first, *rest = nodes
    if not rest:
        return first
    return {"direction": "column", "first": first, "second": _stack(rest), "splitPercentage": 100 / len(nodes)}


def _scene() -> dict[str, Any]:
    """The aircraft's frame over a grid, seen from behind, in axes that do not turn with it."""
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
