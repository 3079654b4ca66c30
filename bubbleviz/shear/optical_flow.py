"""Motion of the texture of the membrane since rest, by optical flow of the colour images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from bubbleviz.camera import BLOCK_PX, FlowField
from bubbleviz.errors import InputError
from bubbleviz.plugins import library
from bubbleviz.recordings import MIN_FRAMES, mean_inflation, temporal_correlation
from bubbleviz.wording import width_by_height

# OpenCV, which only optical flow needs.


def opencv() -> Any:
    """The module `cv2`; InputError where it is not installed."""
    return library("cv2", "colour", "optical flow")


@contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV uses only the calling thread: its pool would compete with other computations."""
    cv2 = opencv()
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


# Normalised grey images, and the precision of motion by their texture.


_CONTRAST_WINDOW_PX = 31
"""Side of the neighbourhood for local mean and contrast: some speckles."""
_MIN_CONTRAST = 4.0
"""Standard deviation in grey levels below which contrast is not texture but camera noise."""
_MIDDLE, _SCALE = 128.0, 42.0
"""Grey level of the mean, and levels of one standard deviation: ± 3 of them fit 8 bits."""


def normalised(grey: np.ndarray) -> np.ndarray:
    """Image (H, W) minus its local mean, divided by its local contrast, uint8 around 128.

    The shading of a membrane changes as it tilts, which must not appear as motion.
    """
    cv2 = opencv()
    image = np.asarray(grey, np.float32)
    side = (_CONTRAST_WINDOW_PX, _CONTRAST_WINDOW_PX)
    mean = cv2.blur(image, side)
    contrast = cv2.sqrBoxFilter(image, -1, side)
    image = image - mean
    mean *= mean  # in place from here on: allocating takes as long as computing
    contrast -= mean
    np.maximum(contrast, 0.0, out=contrast)
    contrast += np.float32(_MIN_CONTRAST**2)
    image /= np.sqrt(contrast, out=contrast)
    return np.asarray(cv2.convertScaleAbs(image, alpha=_SCALE, beta=_MIDDLE))


def motion_bound(
    image: np.ndarray,  # (H, W)
    variance: np.ndarray,  # (H, W), of the noise of a pixel, grey levels squared
    window: int,  # side, pixels
) -> np.ndarray:
    """Cramér–Rao bound of the motion of a window around each pixel, (H, W), pixels.

    In the least certain direction; inf without texture.
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


_FINEST = 2
"""Finest level of the search's pyramid: force has the same error with 1, and with rounds of
variational refinement."""
_SMOOTHED_PX, _WINDOW_PX, _ROUNDS = 2 * BLOCK_PX + 1, 15, 2
"""Odd sides of the square over which a search is averaged (twice) and of the window whose motion is
measured; and number of searches, each for the motion left by the previous one. Of 9 to 25, 9 to 21,
and 1 and 2: the smallest errors on known motions among those with a correct σ."""
_SATURATED = 250  # grey level of a pixel that may be saturated
_LARGEST_SIGMA_PX = 0.1  # of motion at rest; chosen: less certain flow adds nothing to depth
_MEAN_TO_SIGMA = np.sqrt(0.5 * np.pi)  # of normal errors, from the mean of their sizes
_LARGEST_MISMATCH = 0.5 * _SCALE
"""Standard deviation of grey levels beyond which a match is false: half of that of the texture. For
known motions it is up to 6, and if another texture covers the membrane 19 or more."""
_MIN_BLOCK_SHARE = 0.01  # of blocks with texture; chosen
_MAX_IMAGES = 40  # for the noise: more cost time and do not improve it


class OpticalFlow:
    """Measures motion against contact-free images, by blocks of 8×8 pixels.

    Dense inverse search (Kroeger et al. 2016) of OpenCV, then a step of Lucas and Kanade's method,
    whose mismatch of grey levels estimates the error. Constructed by `of`.

    Attributes
    ----------
    shape : (int, int)
        Height and width of the images.
    pixel : (b,) int array
        Middle pixel of each block that has texture, flat index.
    noise_px : (b,) array
        Standard deviation of the motion of a membrane at rest: that of the contact-free images, at
        least the Cramér–Rao bound.
    problem : str
        Why the images cannot be used, one clause; empty if they can.
    """

    def __init__(
        self,
        reference: np.ndarray,
        pixel: np.ndarray,
        noise_px: np.ndarray,
        problem: str,
    ) -> None:
        self.shape = reference.shape
        self.pixel, self.noise_px = pixel, noise_px
        self.problem = problem
        self._reference = reference
        self._search = _search()
        levels = np.ones_like(reference)
        self._px_per_level = motion_bound(reference, levels, _WINDOW_PX).ravel()[pixel]

    @classmethod
    def of(
        cls,
        images: Iterable[np.ndarray],  # iterable of (H, W) uint8 arrays, grey, of at least 5 frames
        mask: np.ndarray | None = None,  # (H, W) bool, pixels that see the membrane
    ) -> OpticalFlow:
        """Learn the reference and the noise from contact-free images.

        Raises InputError: too few images, sizes that differ, or OpenCV is not installed.
        """
        stack = _stacked(images)
        mean = stack.mean(axis=0, dtype=np.float32)
        stack = stack[:: -(-len(stack) // _MAX_IMAGES)]
        reference = normalised(mean)
        frames = [normalised(image) for image in stack]
        bound = motion_bound(reference, _grey_variance(np.stack(frames)), _WINDOW_PX)
        search, middle = _search(), _block_centres(np.arange(mean.size).reshape(mean.shape))
        flows = [_motions(search, reference, each, middle.ravel())[0] for each in frames]
        variance = np.var(flows, axis=0, ddof=1).max(axis=-1).reshape(middle.shape)
        noise = np.maximum(_block_centres(bound), np.sqrt(variance))
        saturated = _block_centres(_dilated(mean >= _SATURATED))
        hidden = np.zeros_like(saturated) if mask is None else _block_centres(_dilated(~mask))
        good = (noise < _LARGEST_SIGMA_PX) & ~saturated & ~hidden
        return cls(
            reference,
            middle[good],
            noise[good],
            _reason_unusable(good, saturated & ~hidden, hidden),
        )

    def measure(self, grey: np.ndarray) -> FlowField:
        """Motion from rest to an image (H, W), uint8.

        Raises InputError: the image is of another size.
        """
        if grey.shape != self.shape:
            raise InputError(
                f"colour image: {width_by_height(grey.shape)} pixels, the contact-free ones have "
                f"{width_by_height(self.shape)}; use images of one resolution"
            )
        if self.problem:
            return self.nothing(self.problem)
        frame = normalised(grey)
        with one_thread():
            moved, mismatch = _motions(self._search, self._reference, frame, self.pixel)
        place = moved + _places(self.pixel, self.shape)
        saturated = _sampled(_dilated(grey >= _SATURATED).astype(np.float32), place) > 0.0
        inside = np.all((place >= 0) & (place <= np.array(self.shape[::-1]) - 1), axis=1)
        good = (mismatch < _LARGEST_MISMATCH) & inside & ~saturated
        sigma = np.hypot(self.noise_px, self._px_per_level * mismatch)[good]
        lost = "most of the texture seen without contact could not be matched in this frame"
        problem = "" if good.mean() > 0.5 else lost
        return FlowField(self.pixel[good], moved[good], sigma, self.shape, problem)

    def nothing(self, problem: str) -> FlowField:
        """Flow without any block, and the reason."""
        return FlowField(np.empty(0, int), np.empty((0, 2)), np.empty(0), self.shape, problem)


def _search() -> Any:
    cv2 = opencv()
    search = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    search.setFinestScale(_FINEST)
    search.setVariationalRefinementIterations(0)
    return search


def _motions(
    search: Any,
    reference: np.ndarray,  # (H, W) uint8
    frame: np.ndarray,  # (H, W) uint8
    pixel: np.ndarray,  # (b,), flat index
) -> tuple[np.ndarray, np.ndarray]:
    """Motion of windows around some pixels, (b, 2), and the mismatch of their grey levels, (b,).

    The mismatch is a standard deviation, inf for windows that were not found.
    A search finds the mean motion of patches that are 32 pixels wide, a fifth too little if a small
    contact is dragged. The frame is therefore moved back by the motion found, and the error of the
    remaining motion is of second order.
    """
    cv2, square = opencv(), (_SMOOTHED_PX, _SMOOTHED_PX)
    row, column = np.indices(reference.shape, np.float32)
    flow, back = np.zeros((*reference.shape, 2), np.float32), frame
    for _ in range(_ROUNDS):
        flow += cv2.blur(cv2.blur(search.calc(reference, back, None), square), square)
        x, y = column + flow[..., 0], row + flow[..., 1]
        back = cv2.remap(frame, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    place = _places(pixel, reference.shape).astype(np.float32)
    window = {"winSize": (_WINDOW_PX, _WINDOW_PX), "maxLevel": 0}
    to, found, size = cv2.calcOpticalFlowPyrLK(reference, back, place, None, **window)
    mismatch = np.where(found[:, 0] == 1, _MEAN_TO_SIGMA * size[:, 0], np.inf)
    return flow.reshape(-1, 2)[pixel] + to - place, mismatch


def _places(pixel: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Positions of flat indices (b,), x and y, (b, 2)."""
    return np.stack(np.divmod(pixel, shape[1])[::-1], axis=1)


def _stacked(images: Iterable[np.ndarray]) -> np.ndarray:
    """Images as one (F, H, W) uint8 array."""
    found = [np.asarray(image, np.uint8) for image in images]
    if len(found) < MIN_FRAMES:
        raise InputError(
            f"only {len(found)} contact-free colour images; give at least {MIN_FRAMES}"
        )
    if len({image.shape for image in found}) > 1:
        raise InputError(
            "contact-free colour images: sizes differ; give images of one camera and resolution"
        )
    return np.stack(found)


def _grey_variance(frames: np.ndarray) -> np.ndarray:
    """Variance of one frame's noise, (H, W)."""
    deviations = frames - frames.mean(axis=0, dtype=np.float32)
    sigma = np.sqrt(np.mean(deviations**2, axis=0))
    sparse = deviations[:, ::4, ::4]
    bias = mean_inflation(temporal_correlation(sparse, sigma[::4, ::4])) / len(frames)
    share = max(1.0 - bias, 1.0 / len(frames))
    return np.asarray(sigma**2 / share)


def _block_centres(image: np.ndarray) -> np.ndarray:
    """Values at the centre pixels of all whole blocks, (rows, columns, …)."""
    half = BLOCK_PX // 2
    rows, columns = (side // BLOCK_PX * BLOCK_PX for side in image.shape[:2])
    return image[half:rows:BLOCK_PX, half:columns:BLOCK_PX]


def _dilated(mask: np.ndarray) -> np.ndarray:
    """Mask (H, W) dilated by the measured window."""
    kernel = np.ones((_WINDOW_PX, _WINDOW_PX), np.uint8)
    return np.asarray(opencv().dilate(mask.astype(np.uint8), kernel)) > 0


def _sampled(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Values (k, …) of an image at positions (k, 2), x and y; outside, those of its edge."""
    cv2 = opencv()
    x, y = np.asarray(place, np.float32).T[:, :, None]
    found = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found)[:, 0]


def _reason_unusable(good: np.ndarray, saturated: np.ndarray, hidden: np.ndarray) -> str:
    """Why too few blocks can be tracked; empty if there are enough."""
    visible = max(int(np.count_nonzero(~hidden)), 1)
    if np.count_nonzero(good) > _MIN_BLOCK_SHARE * good.size:
        return ""
    if np.count_nonzero(saturated) > 0.5 * visible:
        return "the colour images without contact are over-exposed; shorten the exposure time"
    return (
        "the colour images without contact show almost no texture that can be tracked; print one "
        "on the membrane, or improve light, focus and exposure"
    )
