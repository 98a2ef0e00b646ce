"""The reference part of `logs/README.md`: every topic, type, field, unit and frame, from what the code writes.

`python -m ahrs_sim.log.describe logs/README.md` renews it; a test fails when that is due.
"""

import re
import sys
from collections.abc import Iterable
from pathlib import Path

from ahrs_sim.log import messages, topics
from ahrs_sim.log.ros_axes import TWINS
from ahrs_sim.log.topics import Route

BEGIN, END = "<!-- from here on: python -m ahrs_sim.log.describe -->", "<!-- to here -->"


def reference() -> str:
    """Make tables of all topics and of our own types, in Markdown."""
    suite = [_behind("/<suite>", route) for _, route in topics.INSTRUMENTS.values()]
    suite += [_behind("/<suite>", route) for route in topics.STATUS.values()]
    suite.append(_behind("/<suite>", topics.TEMPERATURE))
    estimator = [_behind("/est/<name>", route) for route in topics.ESTIMATES]
    truth = (*topics.TRUTH, topics.TRUTH_ATTITUDE, topics.TRUTH_TURN, topics.TRUTH_FIX, topics.TF, topics.TF_STATIC)
    parts = ["## Topics", "", "### Truth", "", *_topics(truth)]
    parts += ["", "### Each sensor suite", "", *_topics(suite)]
    parts += ["", "### Each estimator", "", *_topics(estimator)]
    parts += ["", "### Pilot and events", "", *_topics((topics.SETPOINTS, topics.EVENTS)), ""]
    parts += [
        "### In the axes of ROS",
        "",
        "With `fly --ros-axes`, for consumers that do not look at frames (imu_tools,",
    ]
    parts += ["robot_localization): behind `/ros` the topics " + ", ".join(f"`.../{r.topic[1:]}`" for r in TWINS)]
    parts += ["again, vectors forward, left, up, attitude from `base_link` to `map` (REP-103, REP-145).", ""]
    parts += ["### Replay of a bag", "", *_topics((topics.REFERENCE,)), ""]
    parts += ["## Types of our own", ""]
    for name in messages.type_names():
        if name.startswith("ahrs_sim_msgs/"):
            parts += [f"### {name}", "", *_fields(name), ""]
    return "\n".join(parts).rstrip() + "\n"


def _behind(prefix: str, route: Route) -> Route:
    return Route(prefix + route.topic, route.type_name, route.frame, route.about)


def _topics(routes: Iterable[Route]) -> list[str]:
    rows = ["| topic | type | frame | |", "|---|---|---|---|"]
    for r in routes:
        frame = f"`{r.frame}`" if r.frame else ""
        rows.append(f"| `{r.topic}` | `{r.type_name}` | {frame} | {r.about} |")
    return rows


def _fields(name: str) -> list[str]:
    rows = ["| field | type | |", "|---|---|---|"]
    for line in messages.definition(name).splitlines():
        declared, _, about = line.partition("#")
        kind, field, *_ = declared.split()
        if "=" not in declared and field != "header":
            rows.append(f"| `{field}` | `{kind}` | {about.strip()} |")
    return rows


def renewed(text: str) -> str:
    """Replace the reference between the two marks in `text`."""
    pattern = re.compile(f"{re.escape(BEGIN)}.*{re.escape(END)}", re.DOTALL)
    if not pattern.search(text):
        raise ValueError("the marks around the reference are missing")
    return pattern.sub(lambda _: f"{BEGIN}\n\n{reference()}\n{END}", text)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        Path(name).write_text(renewed(Path(name).read_text()))
