"""Aircraft of somebody else: what their XML may not ask for."""

import shutil
from pathlib import Path

import pytest
from flight_helpers import make

from ahrs_sim.errors import InputError
from ahrs_sim.flight import open_flight
from ahrs_sim.flight.fdm import library_dir
from ahrs_sim.flight.model_files import check_model

STEPS = [{"do": "straight", "for_s": 1.0}]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    folder = tmp_path / "mine"
    shutil.copytree(library_dir() / "aircraft" / "c172p", folder)
    return (folder / "c172p.xml").rename(folder / "mine.xml")


@pytest.mark.parametrize(
    ("inserted", "message"),
    [
        ('<system file="../outside"/>', "must be below the folder"),
        ('<system file="/etc/passwd"/>', "must be below the folder"),
        ('<system file="link"/>', "lies outside of"),
        ('<system file="entities"/>', "document type"),
        ('<system file="broken"/>', "no XML"),
        ('<input port="1137"/>', "would open a port"),
        ('<system file="large"/>', "larger than 16 MiB"),
        ('<system file="chain0"/>', "more than 200 files"),
    ],
)
def test_what_is_refused_in_one_line(inserted: str, message: str, model: Path) -> None:
    folder = model.parent
    (folder.parent / "outside.xml").write_text("<system name='x'/>")
    (folder / "link.xml").symlink_to(folder.parent / "outside.xml")
    (folder / "entities.xml").write_text('<!DOCTYPE s [<!ENTITY a SYSTEM "file:///etc/passwd">]><system name="&a;"/>')
    (folder / "broken.xml").write_text("<system")
    (folder / "large.xml").write_text(f"<system>{' ' * (17 << 20)}</system>")
    for k in range(300):
        (folder / f"chain{k}.xml").write_text(f'<system file="chain{k + 1}"/>')
    text = model.read_text()
    at = text.index("<metrics>")
    model.write_text(text[:at] + inserted + text[at:])
    made = make(aircraft=str(folder), step=STEPS)
    with pytest.raises(InputError, match=message) as caught:
        open_flight(made)
    assert "\n" not in str(caught.value)


def test_entities_of_the_model_itself_are_refused(model: Path) -> None:
    bomb = '<!DOCTYPE f [<!ENTITY a "xxxxxxxxxx"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    text = model.read_text()
    at = text.index("<fdm_config")
    model.write_text(text[:at] + bomb + text[at:])
    with pytest.raises(InputError, match="document type"):
        check_model(model, library_dir(), "here")


def test_what_jsbsim_brings_is_in_order(model: Path) -> None:
    check_model(model, library_dir(), "here")
    for folder in sorted((library_dir() / "aircraft").iterdir()):
        path = folder / f"{folder.name}.xml"
        if path.is_file() and "<input port" not in path.read_text(errors="replace"):
            check_model(path, library_dir(), "here")
