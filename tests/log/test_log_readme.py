"""The documentation of the topics says what is written."""

from pathlib import Path

from log_helpers import ESTIMATORS, SUITES, MadeUpFlight

from ahrs_sim.log import describe
from ahrs_sim.log.mcap.reader import LogReader

README = Path(__file__).parents[2] / "logs" / "README.md"


def test_reference_is_up_to_date() -> None:
    text = README.read_text()
    assert describe.renewed(text) == text, "run: python -m ahrs_sim.log.describe logs/README.md"


def test_every_topic_written_is_documented(tmp_path: Path) -> None:
    MadeUpFlight(0.1).write(tmp_path / "a.mcap")
    text = README.read_text()
    with LogReader(tmp_path / "a.mcap") as log:
        for topic, about in log.topics.items():
            for name in SUITES:
                topic = topic.replace(f"/{name}/", "/<suite>/")
            for name in ESTIMATORS:
                topic = topic.replace(f"/est/{name}/", "/est/<name>/")
            assert f"| `{topic}` | `{about.type_name}` |" in text
