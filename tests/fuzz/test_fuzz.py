"""A few hundred mutations in CI, and those that once failed; ten thousand by hand: `python tests/fuzz/fuzz.py`."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
CORPUS = HERE / "corpus"
MUTATIONS = 520


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.long
def test_mutated_files_are_refused_in_one_line_or_read(capfd: pytest.CaptureFixture[str]) -> None:
    with capfd.disabled():  # the counts belong into the output
        command = [sys.executable, str(HERE / "fuzz.py"), "--mutations", str(MUTATIONS), "--seed", "7"]
        done = subprocess.run(
            command, stdout=subprocess.PIPE, text=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        )
        print(f"\n{done.stdout}", end="")
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("file", sorted(CORPUS.glob("*/*")), ids=lambda p: f"{p.parent.name}/{p.name}")
def test_what_once_failed(file: Path, tmp_path: Path) -> None:
    sys.path.insert(0, str(HERE))
    import fuzz
    import inputs

    kind = inputs.KINDS[file.parent.name]
    for action in range(len(kind.actions)):
        folder = tmp_path / str(action)
        folder.mkdir()
        copy = folder / kind.file
        copy.write_bytes(file.read_bytes())
        for name, text in inputs.BESIDE.items():
            (folder / name).write_text(text)
        assert fuzz.outcome(file.parent.name, copy, action, folder) in ("done", "refused")
