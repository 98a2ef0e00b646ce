"""`python -m ahrs_sim.log.layouts`: write the shipped layout, that of the circuit scenario."""

import json
from pathlib import Path

from ahrs_sim.log.layouts import build

SUITES = dict.fromkeys(("chr", "sbg"), ("imu", "imu_errors", "mag", "velocity", "air"))
ESTIMATORS = (
    "ekf-chr", "ckf-chr", "cdkf-chr", "ekf-sbg", "ckf-air-chr", "air-ins-chr", "ins21-chr", "ins21-sbg",
)  # fmt: skip

if __name__ == "__main__":
    path = Path(__file__).with_name("ahrs_sim.json")
    path.write_text(json.dumps(build(SUITES, ESTIMATORS), indent=1) + "\n", encoding="utf-8")
