"""`ahrs-sim new estimator NAME --lang c|cpp|python`: write a project that builds, tests itself and flies."""

import argparse
import re
from pathlib import Path

from ahrs_sim.cli.common import Commands
from ahrs_sim.errors import InputError

_TEMPLATES = Path(__file__).parents[1] / "plugins" / "templates"
_INTERFACE = Path(__file__).parents[1] / "plugins" / "interface" / "ahrs_estimator.h"


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("new", help="write a small project to start from")
    command.add_argument("what", choices=["estimator"])
    command.add_argument("name", metavar="NAME", help="of the project and its folder: letters, digits, _")
    command.add_argument("--lang", choices=["c", "cpp", "python"], default="python", help="default: python")
    command.add_argument("-o", "--output", type=Path, metavar="DIR", help="default: a folder NAME here")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Write the project and print its files and what to type next."""
    name, folder = arguments.name, arguments.output or Path(arguments.name)
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise InputError(f"new: '{name}' is no name; letters, digits and _, a letter first")
    if folder.exists():
        raise InputError(f"{folder}: exists; choose another NAME or -o")
    for source in (_TEMPLATES / "common", _TEMPLATES / arguments.lang):
        for path in sorted(p for p in source.rglob("*") if p.is_file() and p.suffix != ".pyc"):
            target = folder / str(path.relative_to(source)).replace("NAME", name)
            target.parent.mkdir(parents=True, exist_ok=True)
            text = path.read_text(encoding="utf-8").replace("NAME", name)
            if arguments.lang == "python":
                text = text.replace(f"lib:./lib{name}.so", f"{name}:{name}")
            target.write_text(text, encoding="utf-8")
            print(target)
    if arguments.lang != "python":
        (folder / _INTERFACE.name).write_text(_INTERFACE.read_text(encoding="utf-8"), encoding="utf-8")
        print(folder / _INTERFACE.name)
    print(f"cd {folder} && make test fly")
