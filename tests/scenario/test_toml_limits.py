"""Scenarios whose numbers and depths no file should have: one line each, whatever is made of them later."""

from pathlib import Path

import pytest

from ahrs_sim.errors import InputError
from ahrs_sim.scenario import load
from ahrs_sim.scenario.table import parse_toml

MOTION = '[motion]\nkind = "sway"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"seed = {'9' * 6000}", "too many digits"),
        (f"seed = 0x{'f' * 6000}", "does not fit into 64 bits"),
        ("seed = 9223372036854775808", "does not fit into 64 bits"),
        (f"seed = {'[' * 5000}{']' * 5000}", "nested deeper than 32"),
        (f"seed = {'{a=' * 5000}1{'}' * 5000}", "nested deeper than 32"),
        (".".join("a" * 5000) + " = 1", "nested deeper than 32"),
        (".".join("a" * 40) + " = 1", "nested deeper than 32"),
        ("epoch = 9999-12-31T23:59:59Z", "out of range"),
        ("epoch = 0001-01-01T00:00:00+14:00", "out of range"),
        ("epoch = 1969-12-31T23:59:59Z", "out of range"),
        ("epoch = 2026-06-01", "not a date and time"),
        ('title = "' + "x" * (5 << 20) + '"', "longer than 4 MiB"),
    ],
    ids=range(12),
)
def test_one_line(text: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text(f"{text}\n{MOTION}")
    with pytest.raises(InputError, match=words) as caught:
        load(str(file))
    assert str(caught.value).startswith(str(file))
    assert len(str(caught.value)) < 300


def test_what_fits_is_taken(tmp_path: Path) -> None:
    assert parse_toml(f"a = {2**63 - 1}\nb = {'[' * 30}{']' * 30}", "here")["a"] == 2**63 - 1
    file = tmp_path / "a.toml"
    file.write_text("epoch = 2037-12-31T23:59:59Z\n" + MOTION)
    assert load(str(file)).epoch_ns < 2**31 * 10**9


def test_a_chain_of_extends_has_an_end(tmp_path: Path) -> None:
    for k in range(100):
        (tmp_path / f"s{k}.toml").write_text(f'extends = "s{k + 1}"\n')
    (tmp_path / "s100.toml").write_text(MOTION)
    assert load(str(tmp_path / "s70.toml")).motion
    with pytest.raises(InputError, match="more than 32 files"):
        load(str(tmp_path / "s0.toml"))


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    import os

    if not hasattr(os, "mkfifo"):
        pytest.skip("no pipes here")
    os.mkfifo(tmp_path / "p.toml")
    with pytest.raises(InputError, match="not a file"):
        load(str(tmp_path / "p.toml"))
