"""Smoothing at the end of a replay, of estimators that can be smoothed; their samples are kept until then."""

from collections.abc import Iterator, Mapping

from ahrs_sim.chain import Chain
from ahrs_sim.errors import InputError
from estimators.navigator.navigator import Navigator
from estimators.navigator.smoother import smooth
from estimators.types import Estimates, Samples

SUFFIX = "_smoothed"


class Smoothing:
    """Samples of the chains whose estimators can be smoothed, some 20 MB for ten minutes at 100 Hz.

    Args:
        chains: by suite.

    Raises:
        InputError: none of the estimators can be smoothed.
    """

    def __init__(self, chains: Mapping[str, Chain]) -> None:
        self._navigators = {
            suite: {name: e for name, e in chain.estimators.items() if isinstance(e, Navigator)}
            for suite, chain in chains.items()
        }
        self._kept: dict[str, list[Samples]] = {suite: [] for suite, found in self._navigators.items() if found}
        if not self._kept:
            raise InputError("--smooth: none of the estimators can be smoothed; name one with --estimator ins-cal")

    @property
    def names(self) -> list[str]:
        """Names of the smoothed estimates."""
        return [name + SUFFIX for found in self._navigators.values() for name in found]

    def keep(self, suite: str, samples: Samples) -> None:
        """Keep a block that the chain of a suite has estimated."""
        if suite in self._kept:
            self._kept[suite].append(samples)

    def smoothed(self) -> Iterator[tuple[str, Estimates]]:
        """Smooth everything kept: name and estimates, one after the other."""
        for suite, blocks in self._kept.items():
            for name, navigator in self._navigators[suite].items():
                if blocks:
                    yield name + SUFFIX, smooth(navigator, Samples.concatenate(blocks))
