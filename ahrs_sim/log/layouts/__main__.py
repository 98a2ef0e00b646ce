"""`python -m ahrs_sim.log.layouts`: write the shipped layout, that of the circuit scenario."""

import json
from pathlib import Path

from ahrs_sim.log.layouts import build

SUITES = dict.fromkeys(("chr", "sbg"), ("imu", "imu_errors", "mag", "velocity", "air"))
ESTIMATORS = ("ekf-chr", "ckf-chr", "cdkf-chr", "ekf-sbg")

if __name__ == "__main__":
    path = Path(__file__).with_name("ahrs_sim.json")
    path.write_text(json.dumps(build(SUITES, ESTIMATORS), indent=1) + "\n", encoding="utf-8")
