"""`python -m ahrs_sim`: the same as `ahrs-sim`."""

import sys

from ahrs_sim.cli import main

if __name__ == "__main__":  # workers of a pool import this module, too
    sys.exit(main())
