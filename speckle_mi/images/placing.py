"""Two images on one sensor: which pixels of both are the same, wherever each image was cut out."""

from __future__ import annotations

import numpy as np

from .field_image import FieldImage, FieldImageError

LEAST_SHARED = 0.5
"""Share of the smaller image that both must show for the rest to be left out."""

LARGEST_CANVAS = 4.0
"""Largest canvas on which images are completed with darkness, relative to the larger image."""


def on_common_pixels(reference: FieldImage, moved: FieldImage) -> tuple[np.ndarray, np.ndarray, str]:
    """Intensities (rows, columns) of the pixels that both images show, and a note where that is not all of them.

    Without an origin in the file the first pixels of both are the same. Images that were cut to what is lit, each at
    another place, are completed with darkness instead where they share too little. Raises FieldImageError for images
    that have too little in common for either.
    """
    boxes = [[(o, o + n) for o, n in zip(image.origin, image.intensity.shape)] for image in (reference, moved)]
    if boxes[0] == boxes[1]:
        return reference.intensity, moved.intensity, ""
    shared = [(max(a[0], b[0]), min(a[1], b[1])) for a, b in zip(*boxes)]
    sides = [last - first for first, last in shared]
    sizes = [image.intensity.size for image in (reference, moved)]
    if min(sides) > 0 and np.prod(sides) >= LEAST_SHARED * min(sizes):
        pieces = [
            image.intensity[tuple(slice(f - o, l - o) for (f, l), o in zip(shared, image.origin))]
            for image in (reference, moved)
        ]
        note = (
            f"the images show {_size(reference)} and {_size(moved)} of the sensor, of which {sides[1]} x {sides[0]} px"
            " are in both and compared"
        )
        return *pieces, note
    hull = [(min(a[0], b[0]), max(a[1], b[1])) for a, b in zip(*boxes)]
    canvas = tuple(last - first for first, last in hull)
    if not all(image.canvas for image in (reference, moved)) or np.prod(canvas) > LARGEST_CANVAS * max(sizes):
        raise FieldImageError(
            f"the images show {_size(reference)} and {_size(moved)} of the sensor, which have too little in common;"
            " must be two pictures by one camera, of one data window or of windows that overlap"
        )
    wholes = []
    for image in (reference, moved):
        whole = np.zeros(canvas, dtype=np.float32)
        whole[tuple(slice(o - f, o - f + n) for (f, _), o, n in zip(hull, image.origin, image.intensity.shape))] = (
            image.intensity
        )
        wholes.append(whole)
    note = (
        f"the images show {_size(reference)} and {_size(moved)} of the sensor; what one of them leaves out was taken"
        " for dark"
    )
    return *wholes, note


def _size(image: FieldImage) -> str:
    rows, columns = image.intensity.shape
    row, column = image.origin
    return f"{columns} x {rows} px from ({column}, {row})"


def middle_offset(image: FieldImage) -> tuple[float, float]:
    """Place (u, v) [px] of an image's middle from the middle of its canvas."""
    canvas = image.canvas or image.intensity.shape
    v, u = (o + (n - 1) / 2 - (c - 1) / 2 for o, n, c in zip(image.origin, image.intensity.shape, canvas))
    return u, v
