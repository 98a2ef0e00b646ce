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
    plots = _Plots(estimators)
    attitude = [
        plots.angles(axis, axis, axis, (f"{TRUTH_ATTITUDE.topic}.{axis}.@rad2deg", "truth"), topic="attitude")
        for axis in _AXES
    ]
    errors = [plots.angles(f"{x}_error", f"{x} error", x) for x in (*_AXES, "tilt")]
    sigmas = [plots.angles(f"{x}_sigma", f"{x}, one sigma", f"{x}_sigma") for x in _AXES]
    tabs = [{"title": "Attitude", "layout": _stack(attitude)}, {"title": "Errors", "layout": _stack(errors)}]
    tabs.append({"title": "Claimed σ", "layout": _stack(sigmas)})
    for suite, instruments in suites.items():
        tabs.append({"title": f"Sensors {suite}", "layout": _stack(plots.sensors(suite, instruments))})
    with_errors = [suite for suite, instruments in suites.items() if "imu_errors" in instruments]
    tabs.append({"title": "Biases", "layout": _stack([plots.biases(axis, with_errors) for axis in "xyz"])})
    panels = plots.panels
    panels["Tab!main"] = {"activeTabIdx": 0, "tabs": tabs}
    panels["RawMessages!events"] = {"foxglovePanelTitle": "Events", "topicPath": "/events", "diffEnabled": False}
    panels["3D!aircraft"] = _scene()
    left = {"direction": "column", "first": "3D!aircraft", "second": "RawMessages!events", "splitPercentage": 75}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "row", "first": left, "second": "Tab!main", "splitPercentage": 38},
    }


_AXES = ("roll", "pitch", "heading")


class _Plots:
    """Makes panels with plots; a method returns the name of the panel that it added."""

    def __init__(self, estimators: Sequence[str]) -> None:
        self.estimators = estimators
        self.colors = _COLORS[: len(estimators)]
        self.panels: dict[str, Any] = {}

    def plot(
        self,
        key: str,
        title: str,
        paths: Iterable[tuple[str, str]],
        colors: Sequence[str] = _COLORS,
        limit: float | None = None,
    ) -> Node:
        """Plot fields of messages: paths and labels."""
        self.panels[f"Plot!{key}"] = {
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

    def angles(self, key: str, title: str, field: str, *more: tuple[str, str], topic: str = "errors") -> Node:
        """Plot an angle of all estimators, and `more`."""
        paths = [(f"/est/{name}/{topic}.{field}.@rad2deg", name) for name in self.estimators]
        return self.plot(key, f"{title}, deg", [*paths, *more], [*self.colors, "#888888"])

    def sensors(self, suite: str, instruments: Sequence[str]) -> list[Node]:
        """Plot what the instruments of a suite measure."""
        imu = f"/{suite}/imu/data_raw"
        airspeed = [(f"/{suite}/air/data.airspeed", suite), ("/truth/air.airspeed", "truth")]
        known = [
            ("imu", "gyro", "angular rate, rad/s", _vectors(imu, "angular_velocity")),
            ("imu", "accel", "specific force, m/s²", _vectors(imu, "linear_acceleration")),
            ("mag", "mag", "magnetic field, T", _vectors(f"/{suite}/imu/mag", "magnetic_field")),
            ("velocity", "velocity", "GNSS velocity (NED), m/s", _vectors(f"/{suite}/gps/vel", "twist.linear")),
            ("air", "air", "airspeed, m/s", airspeed),
        ]
        return [
            # Left alone, a plot in tesla shows a line of zeros.
            self.plot(f"{suite}_{key}", f"{suite}: {title}", paths, limit=7e-5 if instrument == "mag" else None)
            for instrument, key, title, paths in known
            if instrument in instruments
        ]

    def biases(self, axis: str, suites: Iterable[str]) -> Node:
        """Plot the gyro bias of all estimators, and the true one of these suites."""
        paths = [(f"/est/{name}/biases.gyro_bias.{axis}", name) for name in self.estimators]
        paths += [(f"/{suite}/imu/errors.gyro_effective_bias.{axis}", f"{suite} truth") for suite in suites]
        return self.plot(f"bias_{axis}", f"gyro bias {axis}, rad/s", paths, [*self.colors, "#888888", "#bbbbbb"])


def _vectors(topic: str, field: str) -> list[tuple[str, str]]:
    return [(f"{topic}.{field}.{axis}", axis) for axis in "xyz"]


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
