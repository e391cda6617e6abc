"""Closed forms that results are compared with: displacement, decorrelation, speckle statistics, paraxial optics."""

from .bundle import bundle_displacement
from .decorrelation import (
    beam_displacement_of_material,
    decorrelation_axial,
    decorrelation_circular_pupil,
    decorrelation_elliptical_beam,
    decorrelation_in_plane,
)
from .directions import astigmatic_wave
from .displacement import (
    centre_of_gravity_aperture,
    first_order_displacement,
    imaging_displacement,
    per_degree,
    project_on_target,
    spot_displacement,
    system_displacement,
    wavelength_displacement,
)
from .paraxial import CardinalPoints, cardinal_points, entrance_pupil, exit_pupil, paraxial_image, system_matrix
from .radiometry import irradiance_per_intensity, photoelectrons, photon_energy
from .speckle import (
    coherence_gaussian_beam,
    coherence_gaussian_line,
    contrast_of_equal_phasors,
    contrast_of_incoherent_patterns,
    intensity_pdf,
    shift_scatter,
    speckle_shape_gaussian_beam,
    speckle_size_gaussian_beam,
)

__all__ = [
    "CardinalPoints",
    "astigmatic_wave",
    "beam_displacement_of_material",
    "bundle_displacement",
    "cardinal_points",
    "centre_of_gravity_aperture",
    "coherence_gaussian_beam",
    "coherence_gaussian_line",
    "contrast_of_equal_phasors",
    "contrast_of_incoherent_patterns",
    "decorrelation_axial",
    "decorrelation_circular_pupil",
    "decorrelation_elliptical_beam",
    "decorrelation_in_plane",
    "entrance_pupil",
    "exit_pupil",
    "first_order_displacement",
    "imaging_displacement",
    "intensity_pdf",
    "irradiance_per_intensity",
    "paraxial_image",
    "per_degree",
    "photoelectrons",
    "photon_energy",
    "project_on_target",
    "shift_scatter",
    "speckle_shape_gaussian_beam",
    "speckle_size_gaussian_beam",
    "spot_displacement",
    "system_displacement",
    "system_matrix",
    "wavelength_displacement",
]
