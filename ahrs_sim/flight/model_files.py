"""The XML files of an aircraft of somebody's own, checked before JSBSim reads them."""

import xml.parsers.expat as expat
from collections.abc import Sequence
from pathlib import Path

from ahrs_sim.errors import InputError

_LARGEST = 16 << 20
_MOST = 200


def check_model(model: Path, library: Path, where: str, key: str = "aircraft") -> None:
    """Check a model, or a script, and all files that it refers to.

    Args:
        model: the XML file of the aircraft.
        library: JSBSim's own folder.
        where: the file that names it.
        key: of that file.

    Raises:
        InputError: XML that is none, with a document type (entities), larger or more than any model has; a file that
            is neither in the folder of the aircraft nor in JSBSim's engines and systems; a port to be opened.
    """
    folder = model.parent
    places = [folder, folder / "Engines", folder / "Systems", library / "engine", library / "systems"]
    roots = folder.resolve(), library.resolve()
    pending, seen = [model], {model.resolve()}
    while pending:
        path = pending.pop()
        for file in _references(path, where, key, path.resolve().is_relative_to(roots[1])):
            found = [place / file for place in places if (place / file).is_file()]
            for path in found[:1]:  # what is not found JSBSim reports
                if not any(path.resolve().is_relative_to(root) for root in roots):
                    raise InputError(f"{where}: {key}: {file} lies outside of {folder} and JSBSim's own files")
                if path.resolve() not in seen:
                    seen.add(path.resolve())
                    pending.append(path)
        if len(seen) > _MOST:
            raise InputError(f"{where}: {key}: {model} refers to more than {_MOST} files")


def _references(path: Path, where: str, key: str, of_jsbsim: bool) -> Sequence[str]:
    """Return the names of the files that an XML file refers to."""
    found: list[str] = []

    def refuse(reason: str) -> None:
        raise InputError(f"{where}: {key}: {path}: line {parser.CurrentLineNumber}: {reason}")

    def element(name: str, attributes: dict[str, str]) -> None:
        if name == "input" and "port" in attributes:
            refuse("<input port=...> would open a port; remove it")
        for used in ("aircraft", "initialize"):  # of a script: names of what lies in the aircraft's folder
            if name == "use" and {"/", "\\"} & set(attributes.get(used, "")):
                refuse(f"{used} '{attributes[used]}' must be a name")
        if file := attributes.get("file"):
            if Path(file).is_absolute() or ".." in Path(file).parts or "\\" in file:
                refuse(f"file '{file}' must be below the folder of the aircraft")
            found.append(file if file.endswith(".xml") else f"{file}.xml")

    parser = expat.ParserCreate()
    parser.StartElementHandler = element
    if not of_jsbsim:  # one of its own files has a document type
        parser.StartDoctypeDeclHandler = lambda *_: refuse("a document type or entity is not read; remove it")
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError(f"{where}: {key}: {path}: larger than {_LARGEST >> 20} MiB")
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        raise InputError(f"{where}: {key}: {path}: no XML: {error}") from None
    except OSError as error:
        raise InputError(f"{where}: {key}: {path}: cannot be read: {error.strerror or error}") from None
    return found
