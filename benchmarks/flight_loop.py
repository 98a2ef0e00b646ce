"""What the truth costs: a flight with every column recorded at the step, against the bare JSBSim loop, in one run.

python benchmarks/flight_loop.py [--rows 20000] [--repeat 10]
"""

import argparse
import statistics
import time

from ahrs_sim import scenario
from ahrs_sim.flight.jsbsim_flight import JsbsimFlight

SCENE = {
    "start": {"on_ground": False, "height_m": 100.0},
    "wind": {"speed_mps": 4.0, "turbulence": "light"},
    "step": [{"do": "turn", "bank_deg": 30.0, "for_s": 1e5}],
}


def main() -> None:
    """Print the time of a step bare and recorded, and the median of their ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=20000)
    parser.add_argument("--repeat", type=int, default=10)
    options = parser.parse_args()
    scene = scenario.parse(SCENE, "benchmark", "benchmark")
    bare, recorded = JsbsimFlight(scene), JsbsimFlight(scene)
    run = bare._fdm.exec.run
    pairs = []
    for _ in range(options.repeat):
        start = time.process_time()
        for _ in range(options.rows):
            run()
        middle = time.process_time()
        for _ in range(options.rows // 1000):
            recorded.fly(1000)
        pairs.append((middle - start, time.process_time() - middle))
        recorded.take_setpoints()
    scale = 1e6 / options.rows
    print(f"bare JSBSim loop     {scale * min(a for a, _ in pairs):6.2f} us a step")
    print(f"truth and pilot      {scale * min(b for _, b in pairs):6.2f} us a step")
    print(f"ratio                {statistics.median(b / a for a, b in pairs):6.2f}")


if __name__ == "__main__":
    main()
