"""Analytic speckle, so that images after any motion are exact."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

Motion = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Motion (x, y) in pixels of the material points at x, y."""

HEIGHT, WIDTH = 240, 320
NOISE = 2.0
"""σ of grey levels, as that of the real camera."""


def texture(x, y):
    """Grey levels of material points: waves of 7 to 30 pixels, made into blots."""
    rng = np.random.default_rng(5)
    total = np.zeros_like(x)
    for _ in range(60):
        wave = 2.0 * np.pi / rng.uniform(7.0, 30.0)
        angle, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        total += np.cos(wave * (np.cos(angle) * x + np.sin(angle) * y) + phase)
    return 110.0 + 60.0 * np.tanh(total / 4.0)


def grid():
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    return x, y


def still(x, y):
    return np.zeros_like(x), np.zeros_like(y)


def clean_image(motion=still):
    """Brightness after a motion: each pixel shows the point that moved there."""
    return _clean_image(motion).copy()


@lru_cache(maxsize=8)
def _clean_image(motion):
    x, y = grid()
    from_x, from_y = x, y
    for _ in range(20):  # each a fifth of the error before it, or less
        moved = motion(from_x, from_y)
        from_x, from_y = x - moved[0], y - moved[1]
    return texture(from_x, from_y)


def camera(brightness, seed):
    """What a camera makes of it: noise, 8 bits."""
    noise = np.random.default_rng(seed).normal(0.0, NOISE, brightness.shape)
    return np.clip(np.rint(brightness + noise), 0, 255).astype(np.uint8)


def at_rest(count=12):
    clean = clean_image()
    return [camera(clean, seed) for seed in range(count)]


def dragged(x, y):
    """5 pixels in the middle, dying out."""
    near = np.exp(-((x - 150.0) ** 2 + (y - 120.0) ** 2) / (2.0 * 50.0**2))
    return 4.0 * near, -3.0 * near


def twisted(x, y):
    """A turn by 0.12 rad about the middle, up to 4.4 pixels."""
    u, v = x - 160.0, y - 110.0
    near = 0.12 * np.exp(-(u**2 + v**2) / (2.0 * 60.0**2))
    return -v * near, u * near
