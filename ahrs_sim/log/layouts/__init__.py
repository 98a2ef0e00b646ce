"""Layouts of viewers that open our logs without editing.

`ahrs_sim.json` fits the shipped circuit; `ahrs-sim export LOG --to layout` makes one with the names of any log of ours.
Foxglove and Lichtblick take both (Layouts, Import from file). They have no Euler angles of their own: scripts inside
the layout make roll, pitch and heading of the truth and of every estimator, and the errors, all in deg.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from ahrs_sim.errors import InputError
from ahrs_sim.log.record import FlightReader

Node = str | dict[str, Any]

_AXES = ("roll", "pitch", "heading")

_COLORS = ("#2563eb", "#dc2626", "#059669", "#d97706", "#7c3aed", "#0891b2", "#be185d", "#4d7c0f", "#92400e", "#475569")

_EULER = """
function euler(q: { x: number; y: number; z: number; w: number }): [number, number, number] {
  const deg = 180 / Math.PI;
  return [
    deg * Math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x * q.x + q.y * q.y)),
    deg * Math.asin(Math.max(-1, Math.min(1, 2 * (q.w * q.y - q.x * q.z)))),
    deg * Math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z)),
  ];
}
"""

_TRUTH_SCRIPT = """import { Input } from "./types";

export const inputs = ["/truth/odometry"];
export const output = "/studio_script/truth";

type Output = { roll: number; pitch: number; heading: number };

export default function script(event: Input<"/truth/odometry">): Output {
  const [roll, pitch, heading] = euler(event.message.pose.pose.orientation);
  return { roll, pitch, heading: (heading + 360) % 360 };
}
"""

_ESTIMATE_SCRIPT = """import { Input } from "./types";

export const inputs = ["/truth/imu", "/est/@NAME@/imu"];
export const output = "/studio_script/@NAME@";

type Angles = { roll: number; pitch: number; heading: number };
type Output = Angles & { roll_error: number; pitch_error: number; heading_error: number };
type Attitude = { t: number; angles: [number, number, number] };

// An estimate waits for the next truth, so that its error is taken at its own time and not up to a sample late.
let before: Attitude | undefined;
let waiting: Attitude | undefined;
const wrap = (x: number): number => ((((x + 180) % 360) + 360) % 360) - 180;

export default function script(event: Input<"/truth/imu"> | Input<"/est/@NAME@/imu">): Output | undefined {
  const stamp = event.message.header.stamp;
  const now: Attitude = { t: stamp.sec + 1e-9 * stamp.nsec, angles: euler(event.message.orientation) };
  if (event.topic === "/est/@NAME@/imu") {
    waiting = now;
    return undefined;
  }
  const [left, estimate] = [before, waiting];
  before = now;
  if (!left || !estimate || estimate.t < left.t || estimate.t > now.t) {
    return undefined;
  }
  waiting = undefined;
  const part = now.t > left.t ? (estimate.t - left.t) / (now.t - left.t) : 0;
  const error = estimate.angles.map((angle, k) => {
    const from = left.angles[k] ?? 0;
    return wrap(angle - from - part * wrap((now.angles[k] ?? 0) - from));
  });
  return {
    roll: estimate.angles[0],
    pitch: estimate.angles[1],
    heading: (estimate.angles[2] + 360) % 360,
    roll_error: error[0] ?? 0,
    pitch_error: error[1] ?? 0,
    heading_error: error[2] ?? 0,
  };
}
"""


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
            "legendDisplay": "floating",
            "showPlotValuesInLegend": False,
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "sidebarDimension": 240,
        }
        return f"Plot!{key}"

    def vectors(topic: str, field: str) -> list[tuple[str, str]]:
        return [(f"{topic}.{field}.{axis}", axis) for axis in "xyz"]

    attitude = [
        plot(
            axis,
            f"{axis}, deg",
            [
                *((f"/studio_script/{name}.{axis}", name) for name in estimators),
                (f"/studio_script/truth.{axis}", "truth"),
            ],
            [*_COLORS[: len(estimators)], "#888888"],
        )
        for axis in _AXES
    ]
    errors = [
        plot(f"{a}_error", f"{a} error, deg", [(f"/studio_script/{n}.{a}_error", n) for n in estimators]) for a in _AXES
    ]
    tabs = [{"title": "Attitude", "layout": _stack(attitude)}, {"title": "Errors", "layout": _stack(errors)}]
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
    scripts = {"truth": _TRUTH_SCRIPT, **{name: _ESTIMATE_SCRIPT.replace("@NAME@", name) for name in estimators}}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {
            f"ahrs-sim-{name}": {"name": f"attitude of {name}", "sourceCode": text + _EULER}
            for name, text in scripts.items()
        },
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
        "transforms": {},
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
