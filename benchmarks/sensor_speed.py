"""What the sensors cost: two suites with all instruments, against the bare JSBSim loop of the same flight, in one run.

python benchmarks/sensor_speed.py [--seconds 600] [--block 2.0] [--repeat 3]

Beside it gnss-ins-sim's 35 us per sample of one IMU, measured elsewhere on a like machine.
"""

import argparse
import resource
import statistics
import time

import numpy as np

from ahrs_sim import scenario
from ahrs_sim.flight.jsbsim_flight import JsbsimFlight
from ahrs_sim.flight.truth import Truth
from ahrs_sim.sensors import Assembler, Suite, make_suite

SCENE = {
    "start": {"on_ground": False, "height_m": 100.0},
    "wind": {"speed_mps": 4.0, "turbulence": "light"},
    "step": [{"do": "turn", "bank_deg": 30.0, "for_s": 1e5}],
    "suite": {"chr": {"grade": "chr_6dm"}, "sbg": {"grade": "sbg_ig500"}},
}
PEER_US = 35.0


def main() -> None:
    """Print seconds, ratios and us per sample, open and closed loop."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--block", type=float, default=2.0, help="s of truth at once")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    scene = scenario.parse(SCENE, "benchmark", "benchmark")
    started = time.perf_counter()
    suites(scene)[0].sense(JsbsimFlight(scene).fly(800))
    print(f"first block, compilation or its cache included {time.perf_counter() - started:6.2f} s")

    rows, block = round(options.seconds * scene.rate), round(options.block * scene.rate)
    ratios, bare, ours = [], [], []
    for _ in range(options.repeat):
        flight, loop, fitted = JsbsimFlight(scene), JsbsimFlight(scene)._fdm.exec.run, suites(scene)
        spent = spent_bare = 0.0
        for _ in range(rows // block):  # in turns, so that both meet the same machine
            begin = time.process_time()
            for _ in range(block):
                loop()
            middle = time.process_time()
            truth = flight.fly(block)
            ready = time.process_time()
            for suite in fitted:
                suite.sense(truth)
            spent += time.process_time() - ready
            spent_bare += middle - begin
        ratios.append(spent / spent_bare)
        bare.append(spent_bare)
        ours.append(spent)
    samples = 2 * options.seconds * 100.0
    print(f"bare JSBSim loop, {options.seconds:g} s of flight               {min(bare):6.2f} s")
    print(f"two suites, all instruments                    {min(ours):6.2f} s")
    print(f"ratio                                          {statistics.median(ratios):6.2f}   (limit 0.40)")
    each = 1e6 * min(ours) / samples
    print(f"per IMU sample of a suite, all instruments     {each:6.2f} us (gnss-ins-sim {PEER_US:g} us)")
    closed_loop(scene, truth)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory                                    {peak:6.0f} MB")


def closed_loop(scene: scenario.Scenario, truth: Truth) -> None:
    """One sample at a time, as when an estimator flies."""
    costs = []
    for suite in suites(scene):
        assembler = Assembler()
        spent = np.zeros(2)
        for i in range(0, len(truth) - 3, 4):
            begin = time.process_time()
            sent = suite.sense(truth[i : i + 4])
            middle = time.process_time()
            assembler.assemble(sent)
            spent += [middle - begin, time.process_time() - middle]
        costs.append(1e6 * spent / (len(truth) // 4))
    sensing, assembling = np.mean(costs, axis=0)
    print(f"one sample at a time: sense, assemble          {sensing:6.0f} us, {assembling:.0f} us")


def suites(scene: scenario.Scenario) -> list[Suite]:
    """Both suites, new."""
    lla = np.array([scene.start.latitude, scene.start.longitude, scene.start.altitude])
    return [
        make_suite(c, seed=1, dt=1.0 / scene.rate, epoch=scene.epoch, start_lla=lla, faults=[]) for c in scene.suites
    ]


if __name__ == "__main__":
    main()
