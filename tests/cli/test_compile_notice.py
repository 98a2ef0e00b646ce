"""The line on stderr while a method is being compiled."""

import time

from ahrs_sim.cli.common import CompileNotice


def test_what_takes_longer_than_a_second_is_named(capsys):
    notice = CompileNotice()
    notice("marg-ekf", 1, 2)
    time.sleep(0.1)
    notice("marg-ckf", 2, 2)
    time.sleep(1.5)
    notice.end()
    assert capsys.readouterr().err == "ahrs-sim: compiling marg-ckf, 2 of 2\n"


def test_a_hidden_notice_prints_nothing(capsys):
    notice = CompileNotice(hidden=True)
    notice("marg-ekf", 1, 1)
    time.sleep(1.2)
    notice.end()
    assert capsys.readouterr().err == ""
