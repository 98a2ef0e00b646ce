"""Build the documentation site: `python docs/site/build.py [OUTPUT]`, without a network.

The pages are those of the repository, put together with what the code says of itself: commands from the parsers,
grades, maps and estimators from their lists, classes and functions from their docstrings. `notebook.md` is executed. A
link to a page that is not there ends the build.
"""

import argparse
import re
import shutil
import sys
from pathlib import Path

from ahrs_sim.review import estimator_page

ROOT = Path(__file__).parents[2]

_PAGES = {
    "Tutorials": ["docs/tutorial-filter", "docs/tutorial-recording", "docs/tutorial-ci", "docs/notebook"],
    "Guides": [
        "docs/estimators", "docs/doors", "reference/try", "docs/replay", "docs/regression", "docs/viewers",
        "docs/sensors", "docs/aircraft", "docs/trainer", "docs/calibration",
    ],
    "Results": ["docs/accuracy", "docs/papers"],
    "Reference": [
        "docs/scenario", "reference/contract", "reference/python", "reference/commands", "reference/estimators",
        "reference/grades", "reference/maps", "logs/README", "docs/design",
    ],
    "Project": ["CHANGELOG", "CONTRIBUTING", "SECURITY"],
}  # fmt: skip

_NAMED = {page for pages in _PAGES.values() for page in pages}
_OTHERS = sorted({f"docs/{path.stem}" for path in (ROOT / "docs").glob("*.md")} - _NAMED)
PAGES = {title: [*pages, *(_OTHERS if title == "Guides" else [])] for title, pages in _PAGES.items()}

CONTRACT = """# The contract of an estimator

An estimator is a class. It is made with `site`, `sensors` and its settings as keyword arguments, and has one method
that must be there:

    process(samples: Samples) -> Estimates

A row of estimates for each row of samples, the same however the stream is cut into blocks. `reset()`, `state()` and
`restore()` may be there. Frames: navigation n is the local north-east-down, body b is forward-right-down, the
quaternion `q_nb` is scalar first and turns body into navigation. SI and radians. Missing data are NaN, never zero.
`help(estimators.Samples)` says the same.

A filter in another language has the same columns behind a C interface: [doors](../docs/doors.md).

```{eval-rst}
.. autoclass:: estimators.Samples
   :members: make
.. autoclass:: estimators.Estimates
   :no-members:
.. autoclass:: estimators.Status
   :members:
   :undoc-members:
.. autoclass:: estimators.Site
   :no-members:
.. autoclass:: estimators.SensorInfo
   :no-members:
```
"""

TRY = """# Try the estimators in this browser

<a href="../try.html">The page</a> runs them on a recording that you drop on it: a log of ours, a ULog or CSV.
Nothing is uploaded. What it reads and what it leaves out: [doors](../docs/doors.md#ours-in-a-browser).
"""

PYTHON = """# From Python

```{eval-rst}
.. automodule:: ahrs_sim
   :members:
.. automodule:: ahrs_sim.review.frames
   :members: LogFrames, AccuracyTable, CampaignFrames
```

## Estimators alone

```{eval-rst}
.. currentmodule:: estimators
.. autofunction:: estimators.create
.. autofunction:: estimators.describe
.. autofunction:: estimators.prepare
```

## In the tests of an estimator

```{eval-rst}
.. automodule:: ahrs_sim.testing
   :members: accuracy, assert_accuracy
```

## Errors

```{eval-rst}
.. automodule:: ahrs_sim.errors
   :members: AhrsSimError, InputError, FlightError, CheckError, LogError
```
"""


def main() -> None:
    """Put the sources together and build them."""
    output = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "build" / "docs"
    source = output.parent / f"{output.name}-source"
    shutil.rmtree(source, ignore_errors=True)
    write(source)
    from sphinx.cmd.build import build_main

    shutil.rmtree(output, ignore_errors=True)
    code = build_main(
        ["-W", "--keep-going", "-q", "-b", "html", "-d", str(source / "_build"), str(source), str(output)]
    )
    if code == 0:
        sys.stdout.write(f"{output / 'index.html'}\n")
    sys.exit(code)


def write(source: Path) -> None:
    """Write all pages into a folder."""
    source.mkdir(parents=True)
    shutil.copy(Path(__file__).with_name("conf.py"), source)
    for name in (
        "README.md",
        *(f"{page}.md" for pages in PAGES.values() for page in pages if "reference/" not in page),
    ):
        target = source / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(page(ROOT / name), encoding="utf-8")
    for picture in [*(ROOT / "docs").glob("*.png"), *(ROOT / "docs").glob("*.svg")]:
        shutil.copy(picture, source / "docs")
    (source / "README.md").rename(source / "index.md")
    with (source / "index.md").open("a", encoding="utf-8") as index:
        for title, pages in PAGES.items():
            index.write("\n".join(["", "```{toctree}", f":caption: {title}", ":hidden:", *pages, "```", ""]))
    made = {"contract": CONTRACT, "python": PYTHON, "commands": commands(), "estimators": methods()}
    made |= {"grades": grades(), "maps": maps(), "try": TRY}
    (source / "reference").mkdir()
    estimator_page.write(source / "extra" / "try.html", "circuit")
    for name, text in made.items():
        (source / "reference" / f"{name}.md").write_text(text, encoding="utf-8")


def page(path: Path) -> str:
    """A page of the repository as Sphinx takes it."""
    text = path.read_text(encoding="utf-8")
    text = re.sub(r"<!--.*?-->\n", "", text, flags=re.DOTALL)
    text = re.sub(r"\]\((?:\.\./)*README\.md", "](/index.md", text)
    if path.name == "notebook.md":
        head = "---\nfile_format: mystnb\nkernelspec:\n  name: python3\n---\n"
        return head + text.replace("```python\n", "```{code-cell} ipython3\n")
    return text


def commands() -> str:
    """Every command with its options, from the parsers."""
    from ahrs_sim.cli import parser

    made = parser()
    (group,) = (a for a in made._actions if isinstance(a, argparse._SubParsersAction))
    parts = ["# Commands", "Made from the parsers of `ahrs-sim`; `ahrs-sim COMMAND --help` prints the same."]
    about = {action.dest: action.help for action in group._choices_actions}
    for name, command in group.choices.items():
        command.formatter_class = lambda prog: argparse.HelpFormatter(prog, max_help_position=30, width=100)
        parts += [f"## {name}", f"{about[name]}.".capitalize(), f"```text\n{command.format_help().strip()}\n```"]
    return "\n\n".join(parts) + "\n"


def methods() -> str:
    """Every method of the catalogue with its settings."""
    import estimators

    parts = [
        "# Methods and settings",
        "`ahrs-sim list estimators`; which to take: [estimators](../docs/estimators.md).",
    ]
    for method in estimators.describe():
        rows = ["| setting | default | meaning | range |", "|---|---|---|---|"]
        for name, s in method.settings.items():
            rows.append(f"| `{name}` | `{_plain(s.default)}` | {_cell(s.text)} | {s.bounds()} |")
        settings = "\n".join(rows)
        package = "" if method.installed else f" Needs the package {method.package}."
        parts += [
            f"## {method.name}",
            f"{method.text}. {method.source}.{package}",
            settings if method.settings else "No settings.",
        ]
    return "\n\n".join(parts) + "\n"


def _plain(value: str | float | bool) -> str:
    """A default as TOML has it, numbers in few digits."""
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def grades() -> str:
    """Every figure of every grade with its source."""
    from ahrs_sim import sensors

    parts = ["# Grades", "Every figure with its source; how they are used: [sensors](../docs/sensors.md)."]
    for row in sensors.grades():
        if not row["mark"]:
            parts += ["", f"## {row['grade']}", "", f"{row['figure']}", "", "| figure | | source |", "|---|---|---|"]
        else:
            parts.append(f"| `{row['figure'].strip()}` | {row['mark'].strip()} | {_cell(row['source'])} |")
    return "\n".join(parts) + "\n"


def maps() -> str:
    """The ready-made maps of recordings."""
    from ahrs_sim.recordings import presets

    rows = [dict(row) for row in presets.describe()]
    names = list(rows[0])
    parts = [
        "# Ready-made maps",
        "",
        "`--map preset:NAME`; every key of a map: [replay](../docs/replay.md#the-map).",
        "",
    ]
    parts += [f"| {' | '.join(names)} |", "|" + "---|" * len(names)]
    parts += [f"| {' | '.join(_cell(str(row[name])) for name in names)} |" for row in rows]
    return "\n".join(parts) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")


if __name__ == "__main__":
    main()
