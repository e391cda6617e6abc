"""What files of pictures have in common: memory, several pages, what is damaged, a camera that was held upright."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .field_image import FieldImageError

BYTES_WHILE_READING = 16
"""Memory of one value while it is read: as it comes, in double precision and as it is kept."""

LONGEST_REASON = 120
"""Letters of a reader's message that are passed on."""


def first_line(error: Exception) -> str:
    """What a reader says is wrong, or the name of its error."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def reason(error: Exception) -> str:
    """What a reader says is wrong, in one short line."""
    line = first_line(error)
    return line if len(line) <= LONGEST_REASON else line[:LONGEST_REASON] + " ..."


def damaged(path: Path, error: Exception) -> FieldImageError:
    """The error for a file that no reader can make sense of."""
    return FieldImageError(
        f"{path}: is no image or a damaged one, must be OpenEXR, PNG, TIFF or JPEG ({reason(error)})"
    )


def page_number(path: Path, count: int, page: int | None) -> int:
    """Index of the page asked for, from 0.

    Raises FieldImageError where there is none such, or several and none asked for.
    """
    if page is None:
        if count != 1:
            raise FieldImageError(f"{path}: has {count} pages, say which by --page 1 to {count}")
        return 0
    if not 1 <= page <= count:
        raise FieldImageError(f"{path}: has {count} page{'s' * (count != 1)}, --page {page} must be 1 to {count}")
    return page - 1


def oriented(image: np.ndarray, orientation: int) -> np.ndarray:
    """An image (rows, columns) turned as the EXIF and TIFF tag 274 says it is to be seen."""
    if orientation in (2, 3, 6, 7):
        image = image[:, ::-1] if orientation in (2, 3) else image[::-1]
    if orientation in (3, 4):
        image = image[::-1]
    if orientation in (5, 6):
        image = image.T
    if orientation == 7:
        image = image[:, ::-1].T
    if orientation == 8:
        image = image.T[::-1]
    return image
