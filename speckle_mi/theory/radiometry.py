"""How many photons of a laser's light reach a pixel, from its power.

A scatterer of amplitude c stands for |c|^2 of the light that falls on the target, and radiates it evenly into the half
space before the target, or by a BSDF f, as f cos(theta) per solid angle. Its field c e^{ikr}/r is then the square root
of the irradiance across the light's direction but for one factor for all.
"""

from __future__ import annotations

import numpy as np

PLANCK, LIGHT_SPEED = 6.62607015e-34, 299792458.0
"""[J s], [m/s], by which both units are defined."""

HALF_SPACE = 2 * np.pi
"""Solid angle of it [sr]."""


def photon_energy(wavelength: float) -> float:
    """[J], of a vacuum wavelength [mm]."""
    return PLANCK * LIGHT_SPEED / (1e-3 * wavelength)


def irradiance_per_intensity(power: float, scatterers: float, by_bsdf: bool = False) -> float:
    """Irradiance [W/mm^2] across the light's direction for a unit of |E|^2, E the sum of c e^{ikr}/r over scatterers.

    power: of a Gaussian beam [mW]; scatterers: N within its 1/e^2 radius, of amplitude exp(-r^2/w^2), so that sum |c|^2
    over all of them is N/2 in the mean; by_bsdf: whether they radiate by a BSDF and not evenly.
    """
    spread = 1.0 if by_bsdf else HALF_SPACE
    return 1e-3 * power / (spread * scatterers / 2)


def photoelectrons(irradiance: float, area: float, exposure: float, wavelength: float, efficiency: float) -> float:
    """Mean electrons that an irradiance [W/mm^2] frees in a sensitive area [mm^2].

    exposure: [s]; wavelength: in vacuum [mm]; efficiency: electrons a photon.
    """
    return efficiency * irradiance * area * exposure / photon_energy(wavelength)
