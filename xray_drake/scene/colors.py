"""Colours of the things that are not searched for."""

import colorsys

import numpy as np


def distractor_color(
    rng: np.random.Generator,
) -> tuple[float, float, float, float]:
    """Draws a colour that no red detector takes for the target.

    One in six is grey. The hue of the others is 35° to 320°, so it keeps at
    least 35° from red on either side.

    Returns:
        Red, green, blue, alpha in [0, 1].
    """
    hue = rng.uniform(35, 320) / 360
    if rng.random() < 1 / 6:
        saturation, value = rng.uniform(0, 0.1), rng.uniform(0.3, 0.95)
    else:
        saturation, value = rng.uniform(0.35, 0.8), rng.uniform(0.5, 0.95)
    red, green, blue = colorsys.hsv_to_rgb(hue, saturation, value)
    return red, green, blue, 1.0
