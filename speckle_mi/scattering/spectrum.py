"""The line of a laser that has a width, as wavelengths whose intensities add up."""

from __future__ import annotations

import numpy as np

FWHM = 2 * np.sqrt(2 * np.log(2))
"""Full width at half maximum of a Gaussian over its standard deviation."""


def line_samples(wavelength: float, linewidth: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths (n,) of a line of Gaussian shape and their shares (n,) of its power, which add up to 1.

    wavelength: of the middle, which comes first; linewidth: full width at half maximum, in the same unit (of the
    wavelength, counted at the middle; the line is a Gaussian of the wavenumber); count: odd, how many. They lie evenly
    in wavenumber: the trapezoidal rule, which for a Gaussian converges faster than any power of the number. Their
    spacing is sqrt(2 pi/n) standard deviations, which keeps what is cut off and what repeats alike small. They stand
    for the line where paths differ by less than :func:`longest_path`.
    """
    if linewidth == 0:
        return np.array([wavelength]), np.ones(1)
    number = np.arange(1, (count + 1) // 2)
    steps = np.concatenate([[0], number, -number]) * np.sqrt(2 * np.pi / count)
    shares = np.exp(-0.5 * steps**2)
    deviation = linewidth / (FWHM * wavelength)  # of the wavenumber, relative
    return wavelength / (1 + deviation * steps), shares / shares.sum()


def longest_path(wavelength: float, linewidth: float, count: int) -> float:
    """Path difference [unit of the wavelength] up to which ``count`` samples add up as the whole line does.

    Evenly spaced wavenumbers are in step again after 1/spacing; half of that is left for what comes out of step.
    """
    return 0.5 * wavelength**2 * FWHM / (linewidth * np.sqrt(2 * np.pi / count))
