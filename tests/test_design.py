"""The newcomer's tour names what is there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "design.md").read_text()
PROSE = re.sub(r"```.*?```", "", TEXT, flags=re.DOTALL)
QUOTED = sorted(set(re.findall(r"`([^`\n]+)`", PROSE)))
FOLDERS = [ROOT / name for name in ("ahrs_sim", "estimators", "docs")]
PATHS = [*ROOT.glob("*.py"), *(p for folder in FOLDERS for p in [folder, *folder.rglob("*")])]
SOURCES = "\n".join(p.read_text() for folder in ("ahrs_sim", "estimators") for p in (ROOT / folder).rglob("*.py"))


@pytest.mark.parametrize("name", [q for q in QUOTED if re.fullmatch(r"[\w/]+\.(py|md)|[\w/]+/", q)])
def test_files_and_folders_are_there(name: str) -> None:
    whole = f"/{name.rstrip('/')}"
    assert any(path.as_posix().endswith(whole) for path in PATHS), name


@pytest.mark.parametrize("name", [q for q in QUOTED if re.fullmatch(r"(\w+\.)?\w+(\(\w*\))?", q)])
def test_names_are_there(name: str) -> None:
    """`Class.method` is defined in a file that defines the class; a bare name stands somewhere in the code."""
    owner, _, last = name.partition("(")[0].rpartition(".")
    assert re.search(rf"\b{last}\b", SOURCES), name
    if owner:
        assert re.search(rf"^class {owner}\b|\b{owner}\b", SOURCES, re.MULTILINE), name


@pytest.mark.parametrize("path", re.findall(r"^\+\+\+ (\S+)$", TEXT, re.MULTILINE))
def test_recipes_change_files_that_are_there(path: str) -> None:
    """Or make one in a folder that is."""
    made = {"mine.py", "level.py"}
    assert (ROOT / path).is_file() or (Path(path).name in made and (ROOT / path).parent.is_dir()), path


@pytest.mark.parametrize(
    ("file", "line"),
    [
        (file, line)
        for part in re.findall(r"^\+\+\+ .*?(?=^\+\+\+ |^```)", TEXT, re.DOTALL | re.MULTILINE)
        for file, *rest in [part.splitlines()]
        for line in rest
        if line.startswith((" ", "-"))
    ],
)
def test_recipes_begin_from_the_code_as_it_is(file: str, line: str) -> None:
    """What a recipe takes out, and the lines between, stand in the file, up to the dots."""
    source = (ROOT / file.removeprefix("+++ ")).read_text()
    for part in re.split(r"\.\.\.", line[1:].split("  #")[0]):
        assert part.strip(" ,)") in source, (file, line)
