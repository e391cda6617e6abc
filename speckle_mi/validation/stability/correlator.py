"""Extremes of images: constant, saturated, a single bright pixel, shifted out of sight, periodic, not a number."""

from __future__ import annotations

import numpy as np

from ...measurement.correlator import correlate
from ...measurement.speckle_statistics import contrast
from .case import BROKEN, LIMIT, Case, Check, compared, declined


def _speckle(seed: int, shape: tuple[int, int] = (256, 256), size: float = 4.0) -> np.ndarray:
    """Fully developed speckle, periodic in both directions, of about ``size`` pixels."""
    random = np.random.default_rng(seed)
    v, u = (np.fft.fftfreq(n)[:, None] if axis == 0 else np.fft.fftfreq(n) for axis, n in enumerate(shape))
    band = np.exp(-(v**2 + u**2) * size**2 * 2)
    return np.abs(np.fft.ifft2(band * (random.normal(size=shape) + 1j * random.normal(size=shape)))) ** 2


def _no_shift(quantity: str, reference: np.ndarray, moved: np.ndarray, status: str) -> Check:
    shift = correlate(reference, moved)
    declines = shift.status == status and np.isnan(shift.u_px) and bool(shift.message)
    return Check("correlator", quantity, shift.status, status, 0.0, 0.0, LIMIT if declines else BROKEN, shift.message)


def images_without_a_pattern(quick: bool):
    image = _speckle(0)
    yield _no_shift("constant image", np.ones((64, 64)), np.ones((64, 64)), "no contrast")
    yield _no_shift("black image", image, np.zeros_like(image), "no contrast")
    pixel = np.zeros((128, 128))
    pixel[60, 60] = 1.0
    yield _no_shift("one bright pixel", pixel, np.roll(pixel, (3, 5), (0, 1)), "not significant")
    yield _no_shift("unrelated images", image, _speckle(1), "not significant")
    yield _no_shift("image of one pixel", np.ones((1, 1)), np.ones((1, 1)), "no contrast")


def saturated_images(quick: bool):
    """Half of the pixels cut off at the camera's maximum: the shift stays; all of them: no pattern."""
    image = _speckle(2)
    for share in (0.5, 0.9):
        limit = np.quantile(image, 1 - share)
        clipped = np.minimum(image, limit)
        shift = correlate(clipped, np.roll(clipped, (7, -11), (0, 1)))
        yield compared("correlator", f"shift with {share:.0%} of the pixels saturated [px]", shift.u_px, -11.0, 0.02)
    yield _no_shift("all pixels saturated", np.minimum(image, 0), np.minimum(image, 0), "no contrast")


def shifts_beyond_the_image(quick: bool):
    wide = _speckle(3, (256, 1024))
    moved = correlate(wide[:, :256], wide[:, 100:356])
    yield compared("correlator", "shift by 100 of 256 px", moved.u_px, -100.0, 0.02)
    yield _no_shift("shift by 300 of 256 px", wide[:, :256], wide[:, 300:556], "not significant")
    yield _no_shift("shift by 245 of 256 px", wide[:, :256], wide[:, 245:501], "left the detector")


def periodic_patterns(quick: bool):
    u = np.arange(256)
    stripes = np.tile(1 + np.cos(2 * np.pi * u / 16), (256, 1))
    yield _no_shift("stripes of 16 px", stripes, np.roll(stripes, 4, 1), "ambiguous")
    tile = np.tile(_speckle(4, (32, 32)), (8, 8))
    yield _no_shift("speckle repeated every 32 px", tile, np.roll(tile, (3, 5), (0, 1)), "ambiguous")


def images_that_are_not_finite(quick: bool):
    image = _speckle(5, (64, 64))
    for name, value in (("NaN", np.nan), ("infinite", np.inf)):
        broken = image.copy()
        broken[3, 4] = value
        yield declined(
            "correlator", f"a pixel that is {name}", lambda: correlate(image, broken), "moved image", "finite"
        )
    yield declined("correlator", "images of two sizes", lambda: correlate(image, image[:32]), "shape")
    yield declined("correlator", "window larger than the image", lambda: correlate(image, image, 100), "window = 100")


def very_dim_and_very_bright_images(quick: bool):
    """Shift and contrast do not know the unit of the intensity."""
    image = _speckle(6, (128, 128))
    for scale in (1e-300, 1e-30, 1e30, 1e290):
        shift = correlate(image * scale, np.roll(image * scale, (2, -3), (0, 1)))
        yield compared("correlator", f"shift of an image times {scale:g} [px]", shift.u_px, -3.0, 1e-3)
        yield compared(
            "correlator", f"contrast of an image times {scale:g}", contrast(image * scale), contrast(image), 1e-9
        )


CASES = tuple(
    Case(run)
    for run in (
        images_without_a_pattern,
        saturated_images,
        shifts_beyond_the_image,
        periodic_patterns,
        images_that_are_not_finite,
        very_dim_and_very_bright_images,
    )
)
