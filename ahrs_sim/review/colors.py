"""Colours of estimators: the same in the report page and in the figures, distinct for any number of them."""

import colorsys

LIGHT = (
    "#2563eb", "#dc2626", "#059669", "#d97706", "#7c3aed", "#0891b2", "#be185d", "#4d7c0f", "#92400e", "#475569",
)  # fmt: skip
DARK = (
    "#60a5fa", "#f87171", "#34d399", "#fbbf24", "#a78bfa", "#22d3ee", "#f472b6", "#a3e635", "#fb923c", "#94a3b8",
)  # fmt: skip
_GOLDEN = 0.381966  # of a turn: hues of successive numbers lie far from each other


def pair(number: int) -> tuple[str, str]:
    """Return the colours of the estimator with this place in its log, on a light and on a dark ground."""
    if number < len(LIGHT):
        return LIGHT[number], DARK[number]
    hue = (0.05 + _GOLDEN * number) % 1.0
    level = 0.08 * ((number // 7) % 3)  # of lightness: neighbours in hue differ in it
    return _hex(hue, 0.34 + level, 0.75), _hex(hue, 0.62 + level, 0.75)


def _hex(hue: float, lightness: float, saturation: float) -> str:
    return "#" + "".join(f"{round(255 * x):02x}" for x in colorsys.hls_to_rgb(hue, lightness, saturation))
