"""JSBSim under control: found models, silent, every property checked.

JSBSim answers 0.0 for a property that does not exist and creates one that is set, prints to the terminal, and is only
reproducible from a fresh instance; this module makes each of those an error or impossible.
"""

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import jsbsim

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.flight.model_files import check_model
from ahrs_sim.scenario.shipped import aircraft_dir
from ahrs_sim.scenario.table import is_file


class _LastWords(jsbsim.FGLogger):
    """A silent logger that keeps the last error: JSBSim's reason when a model does not load."""

    def __init__(self) -> None:
        super().__init__()
        self.level = jsbsim.LogLevel.BULK
        self.text = ""

    def set_level(self, level: jsbsim.LogLevel) -> None:
        self.level = level

    def message(self, message: str) -> None:
        if self.level in (jsbsim.LogLevel.ERROR, jsbsim.LogLevel.FATAL) and message.strip():
            self.text = " ".join(message.split())


class Fdm:
    """One JSBSim instance with a loaded model."""

    def __init__(self, dt: float) -> None:
        self.log = _LastWords()
        jsbsim.set_logger(self.log)
        jsbsim.FGJSBBase().debug_lvl = 0  # type: ignore[no-untyped-call]
        self.exec = jsbsim.FGFDMExec(None)
        self.exec.set_root_dir(str(library_dir()))
        self.exec.set_dt(dt)
        self.dt = dt
        self.sources: list[Path] = []
        self._roots: dict[Path, str] = {}  # of what is neither ours nor JSBSim's: where its attachments go
        self._properties = self.exec.get_property_manager()
        self._access: dict[str, str] = {}

    def load_aircraft(self, name: str, where: str) -> None:
        """Load a model: one of ours or of JSBSim's by its name, somebody's own by the path of its folder or XML file.

        A relative path starts at the folder of the file `where`.

        Raises:
            InputError: there is no such aircraft, or JSBSim cannot read it.
        """
        path = _own_model(name, where)
        if path is None:
            known = aircraft()
            if name not in known:
                raise InputError(f"{where}: aircraft: '{name}' is unknown{nearest(name, known)}")
            path = known[name] / f"{name}.xml"
        else:
            check_model(path, library_dir(), where)
            self._roots[path.parent] = f"aircraft/{path.parent.name}"
        inside = path.parent.name == path.stem
        self.exec.set_aircraft_path(str(path.parent.parent if inside else path.parent))
        try:
            loaded = self.exec.load_model(path.stem, inside)
        except RuntimeError as error:
            self.log.text = str(error)
            loaded = False
        if not loaded:
            raise InputError(f"{where}: aircraft: JSBSim cannot load '{name}': {self.log.text or 'no reason given'}")
        self._mute()
        self._collect(path.parent, path.name)

    def load_script(self, name: str, where: str, aircraft: str = "") -> float | None:
        """Load a script with its aircraft: one of JSBSim's by its name, somebody's own by its path; its end time (s).

        Args:
            name: of the script, or a path from the folder of `where` on.
            where: the file that names it.
            aircraft: path of somebody's own aircraft, of the name that the script has; empty: one of JSBSim's.

        Returns:
            None when it has no end.

        Raises:
            InputError: there is no such script or aircraft, one that may not be read, or JSBSim cannot read it.
        """
        path = script_path(name, where)
        own = _own_model(aircraft, where) if aircraft else None
        if path.parent != library_dir() / "scripts":
            check_model(path, library_dir(), where, "script")
            self._roots[path.parent] = "scripts"
        if own is not None:
            check_model(own, library_dir(), where)
            if own.parent.name != own.stem:
                raise InputError(
                    f"{where}: aircraft: {own.name} must lie in a folder '{own.stem}' for a script to find it"
                )
            self._roots[own.parent] = f"aircraft/{own.parent.name}"
            self.exec.set_aircraft_path(str(own.parent.parent))
        try:
            loaded = self.exec.load_script(str(path), self.dt)
        except RuntimeError as error:
            self.log.text = str(error)
            loaded = False
        if not loaded:
            raise InputError(f"{where}: script: JSBSim cannot load '{name}': {self.log.text or 'no reason given'}")
        self.exec.set_dt(self.dt)
        self._mute()
        self.sources.append(path)
        model = self.exec.get_model_name()
        self._collect(own.parent if own else library_dir() / "aircraft" / model, f"{model}.xml")
        run = ET.parse(path).getroot().find("run")
        end = run.get("end") if run is not None else None
        return float(end) if end else None

    def begin(self) -> None:
        """Put the aircraft where `ic/...` says; a property that only another simulator would provide is made, and is 0.

        Raises:
            RuntimeError: JSBSim gives up.
        """
        for _ in range(100):
            try:
                self.exec.run_ic()
                return
            except RuntimeError as error:
                missing = re.search(r"The property (\S+) does not exist", str(error))
                if missing is None:
                    raise
                self.exec.set_property_value(missing[1], 0.0)
                self.exec.resume_integration()  # which `run_ic` had suspended

    def has(self, name: str) -> bool:
        """Test whether the property exists."""
        return self._properties.get_node(name) is not None

    def getter(self, name: str, where: str = "JSBSim") -> Callable[[], float]:
        """Make a bound reader of a property: the fast way to read.

        Raises:
            InputError: no such property.
        """
        node = self._properties.get_node(name)
        if node is None:
            raise self._unknown(name, where)
        return node.get_double_value

    def setter(self, name: str, where: str = "JSBSim") -> Callable[[float], object]:
        """Make a bound writer of a property.

        Raises:
            InputError: no such property, or it cannot be written.
        """
        node = self._properties.get_node(name)
        if node is None:
            raise self._unknown(name, where)
        if self._catalogue().get(name) == "R":
            raise InputError(f"{where}: property '{name}' is read only; set one of the inputs it depends on")
        return node.set_double_value

    def __getitem__(self, name: str) -> float:
        return self.getter(name)()

    def __setitem__(self, name: str, value: float) -> None:
        self.setter(name)(value)

    def attachments(self) -> dict[str, bytes]:
        """Collect the XML files of the flight by path: `aircraft/...`, `engine/...`, `scripts/...`."""
        files = {}
        roots = {**self._roots, library_dir(): "", aircraft_dir().parent: ""}
        for path in self.sources:
            for root, folder in roots.items():
                if path.is_relative_to(root):
                    files[(Path(folder) / path.relative_to(root)).as_posix()] = path.read_bytes()
                    break
        return files

    def _catalogue(self) -> dict[str, str]:
        """Property -> "R", "W" or "RW"."""
        if not self._access:
            for line in self.exec.get_property_catalog():
                name, _, access = line.partition(" (")
                self._access[name] = access.rstrip(")")
        return self._access

    def _unknown(self, name: str, where: str) -> InputError:
        known = self._catalogue()
        hint = nearest(name, known)
        if not hint.startswith("; did"):  # thousands of properties are no help
            hint = f"; {self.exec.get_model_name()} has {len(known)}, none like it"
        return InputError(f"{where}: property '{name}' does not exist{hint}")

    def _mute(self) -> None:
        """Some aircraft and scripts write files into whatever folder one happens to be in: send them nowhere."""
        self.exec.disable_output()
        self.exec.set_output_path(os.devnull)  # state files: no file can be opened below it
        number = 0
        while self.exec.get_output_filename(number):
            self.exec.set_output_filename(number, os.devnull)
            number += 1

    def _collect(self, folder: Path, name: str) -> None:
        """Note `folder/name` and the files it refers to, where they are found."""
        path = folder / name
        places = [folder, folder / "Engines", folder / "Systems", library_dir() / "engine", library_dir() / "systems"]
        pending = [path]
        while pending:
            path = pending.pop()
            if path in self.sources:
                continue
            self.sources.append(path)
            for reference in re.findall(r'\bfile\s*=\s*"([^"]+)"', path.read_text(encoding="utf-8", errors="replace")):
                file = reference if reference.endswith(".xml") else f"{reference}.xml"
                found = [place / file for place in places if is_file(place / file)]
                pending.extend(found[:1])


def configure(fdm: Fdm, throttle: float, gear: float) -> None:
    """Set what a pilot sets once: rich mixture, fine pitch, wheels up or down, everything else clean; burn no fuel."""
    for name in ("gear/gear-cmd-norm", "gear/gear-pos-norm"):
        write(fdm, name, gear)
    write(
        fdm, "propulsion/fuel_freeze", 1.0
    )  # some models' feeding tanks are filled by the simulator they were made for
    for i in range(engines(fdm)):
        write(fdm, indexed("fcs/mixture-cmd-norm", i), 1.0)
        write(fdm, indexed("fcs/advance-cmd-norm", i), 1.0)
        write(fdm, indexed("fcs/throttle-cmd-norm", i), throttle)


def start_engines(fdm: Fdm) -> None:
    """Start every engine: fuel on, ignition on, starter pressed, and running at once where JSBSim can do that."""
    for name, value in (("cutoff_cmd", 0.0), ("magneto_cmd", 3.0), ("starter_cmd", 1.0), ("set-running", -1.0)):
        write(fdm, f"propulsion/{name}", value)


def stop_engines(fdm: Fdm) -> None:
    """Switch every engine off."""
    for name, value in (("starter_cmd", 0.0), ("magneto_cmd", 0.0), ("cutoff_cmd", 1.0)):
        write(fdm, f"propulsion/{name}", value)
    for i in range(engines(fdm)):
        write(fdm, indexed("propulsion/engine", i) + "/set-running", 0.0)


def indexed(name: str, i: int) -> str:
    """Make JSBSim's name of the i-th of several properties."""
    return f"{name}[{i}]" if i else name


def engines(fdm: Fdm) -> int:
    """Count the engines."""
    number = 0
    while fdm.has(indexed("propulsion/engine", number) + "/set-running"):
        number += 1
    return number


def write(fdm: Fdm, name: str, value: float) -> None:
    """Set a property where there is one."""
    if fdm.has(name):
        fdm[name] = value


def library_dir() -> Path:
    """Find the folder of the aircraft, engines, systems and scripts that come with JSBSim."""
    return Path(jsbsim.get_default_root_dir())


def aircraft() -> dict[str, Path]:
    """List every aircraft that can fly, ours first, and its folder."""
    found: dict[str, Path] = {}
    for root in (aircraft_dir(), library_dir() / "aircraft"):
        for folder in sorted(root.iterdir()) if root.is_dir() else ():
            if is_file(folder / f"{folder.name}.xml"):
                found.setdefault(folder.name, folder)
    return found


def _is_path(name: str) -> bool:
    return "/" in name or os.sep in name or name.endswith(".xml")


def _own_model(name: str, where: str) -> Path | None:
    """Find the XML file of an aircraft given as a path; None: it is a name."""
    if not _is_path(name):
        return None
    path = (Path(where).parent / Path(name).expanduser()).resolve()
    if is_file(path):
        return path
    if not path.is_dir():
        raise InputError(f"{where}: aircraft: '{name}': there is no file or folder {path}")
    models = sorted(path.glob("*.xml"))
    named = [x for x in models if x.stem == path.name] or [x for x in models if _is_model(x)]
    if len(named) != 1:
        found = ", ".join(x.name for x in named) or "none"
        raise InputError(
            f"{where}: aircraft: '{name}' should hold one JSBSim model, it holds {found}; name the XML file"
        )
    return named[0]


def _is_model(path: Path) -> bool:
    return "<fdm_config" in path.read_text(encoding="utf-8", errors="replace")


def script_path(name: str, where: str) -> Path:
    """Find the file of a script: of JSBSim's by its name, else a path from the folder of the file `where` on.

    Raises:
        InputError: there is none.
    """
    if not _is_path(name):
        known = scripts()
        if name not in known:
            raise InputError(f"{where}: script: '{name}' is unknown{nearest(name, known)}")
        return known[name]
    path = (Path(where).parent / Path(name).expanduser()).resolve()
    if not is_file(path):
        raise InputError(f"{where}: script: '{name}': there is no file {path}")
    return path


def trims(script: Path) -> bool:
    """Test whether a script trims, which puts the aircraft back to its start."""
    text = script.read_text(errors="replace")
    return "simulation/do_simple_trim" in text or "simulation/do_trim" in text


def scripts() -> dict[str, Path]:
    """List JSBSim's scripts by name."""
    return {path.stem: path for path in sorted((library_dir() / "scripts").glob("*.xml"))}
