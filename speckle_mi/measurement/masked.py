"""Correlation of images of which a part says nothing: dust, a beam stop, the edge of the optics.

The normalised correlation over the pixels that both images show, at every displacement, is scikit-image's
(D. Padfield, DOI 10.1109/TIP.2011.2181402).
"""

from __future__ import annotations

import numpy as np
from skimage.registration import phase_cross_correlation

from .light import middle

OVERLAP = 0.3
"""Least share of the pixels that both images must show, of the most that they show at any displacement."""

SIDE = 512
"""Side of the middle piece that is searched [px]: the transforms are of twice that size."""


def masked_displacement(
    reference: np.ndarray, moved: np.ndarray, valid: np.ndarray, moved_valid: np.ndarray
) -> tuple[tuple[int, int], float, int]:
    """Whole displacement (v, u) [px] of ``moved``, the correlation there and the number of pixels that it rests on.

    All (rows, columns); valid: bool, False where an image says nothing.
    """
    reference, moved, valid, moved_valid = (middle(image, SIDE) for image in (reference, moved, valid, moved_valid))
    shift, _, _ = phase_cross_correlation(
        reference, moved, reference_mask=valid, moving_mask=moved_valid, overlap_ratio=OVERLAP
    )
    displacement = tuple(-int(round(float(s))) for s in shift)
    first, second = _overlap(reference.shape, displacement)
    both = valid[first] & moved_valid[second]
    count = int(np.count_nonzero(both))
    if count < 2:
        return displacement, 0.0, count
    a, b = reference[first][both], moved[second][both]
    a, b = a - a.mean(), b - b.mean()
    norm = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return displacement, float(np.sum(a * b)) / norm if norm > 0.0 else 0.0, count


def _overlap(shape: tuple[int, int], displacement: tuple[int, int]) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Pieces of the reference and of the moved image that show the same part of the pattern."""
    first = tuple(slice(max(0, -d), n - max(0, d)) for n, d in zip(shape, displacement))
    return first, tuple(slice(s.start + d, s.stop + d) for s, d in zip(first, displacement))
