"""Grey images freed of brightness and contrast, and how precisely their texture tells motion."""

from __future__ import annotations

import numpy as np

from bubbleviz.colour.opencv import opencv

_WINDOW_PX = 31
"""Side of the neighbourhood that brightness and contrast are taken from: some speckles."""
_LEAST_CONTRAST = 4.0
"""Standard deviation, grey levels, of what is not taken for texture: the noise of a camera."""
_MIDDLE, _SCALE = 128.0, 42.0
"""Grey level of the mean, and levels of one standard deviation: ± 3 of them fit 8 bits."""


def normalised(grey: np.ndarray) -> np.ndarray:
    """Image (H, W) less its local mean over its local contrast, uint8 around 128.

    A membrane that tilts is lit anew: by that its texture must not seem to move.
    """
    cv2 = opencv()
    image = np.asarray(grey, np.float32)
    side = (_WINDOW_PX, _WINDOW_PX)
    mean = cv2.blur(image, side)
    contrast = cv2.sqrBoxFilter(image, -1, side)
    image = image - mean
    mean *= mean  # in place from here on: allocating takes as long as computing
    contrast -= mean
    np.maximum(contrast, 0.0, out=contrast)
    contrast += np.float32(_LEAST_CONTRAST**2)
    image /= np.sqrt(contrast, out=contrast)
    return np.asarray(cv2.convertScaleAbs(image, alpha=_SCALE, beta=_MIDDLE))


def motion_bound(image: np.ndarray, variance: np.ndarray, window: int) -> np.ndarray:
    """Cramér–Rao bound of the motion of a window around each pixel, (H, W), pixels.

    In the direction that the texture tells least about; inf where it tells nothing.

    Parameters
    ----------
    image : (H, W) array
    variance : (H, W) array
        Of the noise of a pixel of it, grey levels squared.
    window : int
        Side, pixels.
    """
    cv2 = opencv()
    image = np.asarray(image, np.float32)
    # Scharr's kernel has weights 3, 10, 3 on both sides: 1/32 makes it a slope a pixel
    gx = cv2.Scharr(image, cv2.CV_32F, 1, 0, scale=1.0 / 32.0)
    gy = cv2.Scharr(image, cv2.CV_32F, 0, 1, scale=1.0 / 32.0)

    def summed(values: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.boxFilter(values, -1, (window, window), normalize=False))

    xx, yy, xy = summed(gx * gx), summed(gy * gy), summed(gx * gy)
    least = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    noise = cv2.blur(np.asarray(variance, np.float32), (window, window))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(least > 0.0, np.sqrt(noise / least), np.inf)
