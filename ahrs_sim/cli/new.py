"""`ahrs-sim new WHAT NAME`: write an estimator's project, a scenario, a grade or a suite of flights to start from."""

import argparse
import re
from collections.abc import Mapping
from pathlib import Path

from ahrs_sim.cli.common import Commands
from ahrs_sim.errors import InputError

_TEMPLATES = Path(__file__).parents[1] / "plugins" / "templates"
_INTERFACE = Path(__file__).parents[1] / "plugins" / "interface" / "ahrs_estimator.h"
_NEXT = {
    "scenario": "ahrs-sim fly {path}",
    "grade": 'in a scenario: [suite.{name}] with grade = "{path}"',
    "suite": 'ahrs-sim check {path} --renew --why "first baseline"',
}
"""What each file is for: printed once it is there."""
_LANGUAGES: dict[str, dict[str, str]] = {
    "python": {},
    "c": {"SUFFIX": "c", "COMPILER": "$(CC) $(CFLAGS) -std=c99"},
    "cpp": {"SUFFIX": "cpp", "COMPILER": "$(CXX) $(CXXFLAGS) -std=c++20"},
}
"""By language: words of the templates (in `native`, which C and C++ share) and what stands for them."""


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("new", help="write a first estimator project, scenario, grade or suite")
    command.add_argument("what", choices=["estimator", *_NEXT])
    command.add_argument("name", metavar="NAME", help="name of the project or file: letters, digits, _, a letter first")
    command.add_argument("--lang", choices=sorted(_LANGUAGES), help="language of an estimator (default: python)")
    command.add_argument("-o", "--output", type=Path, metavar="PATH", help="default: a folder NAME, a file NAME.toml")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Write it and print its files and what to type next."""
    name = arguments.name
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise InputError(f"new: '{name}' is no name; letters, digits and _, a letter first")
    if arguments.what != "estimator" and arguments.lang:
        raise InputError(f"new: --lang is for an estimator; a {arguments.what} is TOML")
    is_project = arguments.what == "estimator"
    path = arguments.output or Path(name if is_project else f"{name}.toml")
    if path.exists():
        raise InputError(f"{path}: exists; choose another NAME or -o")
    if is_project:
        _write_project(name, path, arguments.lang or "python")
        return
    text = (_TEMPLATES / "files" / f"{arguments.what}.toml").read_text(encoding="utf-8")
    path.parent.mkdir(parents=True, exist_ok=True)
    for ending in (".toml", ".json"):
        text = text.replace(f"NAME{ending}", str(path.with_suffix(ending)))
    path.write_text(text.replace("NAME", name), encoding="utf-8")
    print(path, _NEXT[arguments.what].format(path=path, name=name), sep="\n")


def _write_project(name: str, folder: Path, language: str) -> None:
    words = {**_LANGUAGES[language], "NAME": name}  # last: a name may hold one of the others
    sources = [_TEMPLATES / "common", _TEMPLATES / language]
    for source in sources if language == "python" else [*sources, _TEMPLATES / "native"]:
        for path in sorted(p for p in source.rglob("*") if p.is_file() and p.suffix != ".pyc"):
            target = folder / _replaced(str(path.relative_to(source)), words)
            target.parent.mkdir(parents=True, exist_ok=True)
            text = _replaced(path.read_text(encoding="utf-8"), words)
            if language == "python":
                text = text.replace(f"lib:./lib{name}.so", f"{name}:{name}")
            target.write_text(text, encoding="utf-8")
            print(target)
    if language != "python":
        (folder / _INTERFACE.name).write_text(_INTERFACE.read_text(encoding="utf-8"), encoding="utf-8")
        print(folder / _INTERFACE.name)
    print(f"cd {folder} && make test fly")


def _replaced(text: str, words: Mapping[str, str]) -> str:
    for word, value in words.items():
        text = text.replace(word, value)
    return text
