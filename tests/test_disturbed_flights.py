"""Whole flights that go wrong for an unprotected filter: a disturbed field, a start in the air."""

import tomllib
from typing import Any

import pytest

from ahrs_sim import pipeline, scenario
from ahrs_sim.review import compare

AIDED = 'method = "marg-ckf"\naiding = "airspeed"\n'


def flown(name: str, estimators: dict[str, str], worse: dict[str, Any] | None = None) -> compare.Judge:
    """Fly a shipped scenario with other estimators, its last fault changed by `worse`."""
    text = "".join(f"[estimator.{key}]\n{settings}\n" for key, settings in estimators.items())
    data = {**scenario.load(name).data, "estimator": tomllib.loads(text)["estimator"]}
    if worse:
        data["fault"] = [*data["fault"][:-1], data["fault"][-1] | worse]
    judge = compare.Judge(list(estimators))
    pipeline.fly(scenario.parse(data, name, name), None, judge=judge)
    return judge


@pytest.mark.parametrize("suite", ["chr", "sbg"])
def test_a_disturbed_field_is_refused(suite: str) -> None:
    """9 uT of iron from the side in flight: the norm changes by 2 %, the dip by 2 deg, the needle by 21 deg."""
    both = {"plain": AIDED, "ins": 'method = "ins21"\nheading_aid = false\n'}
    told = {k: f'{v}suite = "{suite}"\n' for k, v in both.items()}
    told |= {f"{k}-safe": f'{v}adaptation = "magnetic"\n' for k, v in told.items()}
    judge = flown("mag_disturbance", told, {"size_ut": [0.0, 9.0, 0.0], "for_s": 30.0})
    worst = {n: v["heading_max_deg"] for n, v in judge.result(low=110.0, high=142.0)["estimators"].items()}
    assert worst["plain"] > 15.0
    assert worst["plain-safe"] < 3.0
    assert worst["ins-safe"] < 3.0


def test_a_start_in_a_turn() -> None:
    methods = {
        "marg": AIDED, "air": 'method = "air-ins"\n', "ins": 'method = "ins21"\n', "paper": 'method = "marg-ckf"\n',
    }  # fmt: skip
    judge = flown("air_start", {k: f'{v}suite = "chr"\n' for k, v in methods.items()})
    begin = judge.result(low=6.5, high=9.0)["estimators"]
    after = judge.result(low=40.0)["estimators"]
    for name in ("marg", "air", "ins"):
        assert begin[name]["availability"] == 1.0, name
        assert begin[name]["tilt_rmse_deg"] < 6.0, name
        assert begin[name]["heading_rmse_deg"] < 12.0, name
        assert after[name]["tilt_rmse_deg"] < 3.0, name
    assert begin["paper"]["tilt_rmse_deg"] > 15.0
