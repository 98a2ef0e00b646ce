"""What `ahrs-sim replay --find` says of fifty simulated flights, against what was planted in their sensors.

    python benchmarks/installation.py [SEEDS]

Prints for each quantity how often it was observable, the median sigma, the RMS and the largest error in sigmas, and how
many errors were beyond three. About two seconds a flight.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "recordings"))

import flights
import test_installation


def main() -> None:
    """Fly, find, compare."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    errors: dict[str, list[float]] = {}
    sigmas: dict[str, list[float]] = {}
    flown = 0
    for seed in range(seeds):
        planted = test_installation.planted(seed)
        out = test_installation.found_in(flights.Path(seed), planted, seed)
        flown += 1
        for name, value in test_installation.truth(planted).items():
            if (estimate := out.found.get(name)) is not None and estimate.seen:
                errors.setdefault(name, []).extend(np.abs(estimate.value - value) / estimate.sigma)
                sigmas.setdefault(name, []).extend(estimate.sigma)
    print(f"{flown} flights; errors in sigmas")
    print(f"{'':12s}{'seen':>6s}{'sigma':>9s}{'rms':>7s}{'max':>7s}{'> 3':>5s}")
    for name, values in errors.items():
        z = np.array(values)
        print(f"{name:12s}{len(z):6d}{np.median(sigmas[name]):9.4f}{np.sqrt(np.mean(z**2)):7.2f}{z.max():7.2f}"
              f"{int(np.sum(z > 3)):5d}")  # fmt: skip


if __name__ == "__main__":
    main()
