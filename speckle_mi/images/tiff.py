"""TIFF pages as cameras write them: any compression, bit depth, palette, polarity and arrangement of planes."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..machine.memory import excess
from .colours import cmyk_luminance, luminance
from .field_image import FieldImageError
from .pages import BYTES_WHILE_READING, damaged, oriented, page_number

_SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def is_tiff(start: bytes) -> bool:
    """Whether a file that begins so is a TIFF or BigTIFF."""
    return start[:4] in _SIGNATURES


@contextmanager
def _quiet() -> Iterator[None]:
    """Keeps the reader's log, which it writes besides raising an error, from standard error."""
    logger = logging.getLogger("tifffile")
    level, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = level


def read_tiff(path: Path, page: int | None) -> np.ndarray:
    """Intensity (rows, columns) of one page, in the file's unit. Raises FieldImageError."""
    import tifffile

    with _quiet():
        try:
            with tifffile.TiffFile(path) as file:
                pages = _all_pages(path, file)
                pages = [page for page in pages if not page.is_reduced] or pages
                chosen = pages[page_number(path, len(pages), page)]
                _check(path, chosen)
                return _intensity(path, chosen, _values(path, chosen))
        except FieldImageError:
            raise
        except Exception as error:  # the reader raises errors of its own, and of every codec
            raise damaged(path, error) from None


def _all_pages(path: Path, file) -> list:
    """Pages of a file, each of which says where the next one is. Raises FieldImageError where they go in a circle."""
    pages = {}
    for page in file.pages:
        if page.offset in pages:
            raise FieldImageError(
                f"{path}: is a damaged TIFF, its pages lead back to one another; must be a whole TIFF, PNG, JPEG or"
                " OpenEXR"
            )
        pages[page.offset] = page
    return list(pages.values())


def _check(path: Path, page) -> None:
    """FieldImageError for a page that the file cannot hold, or the memory."""
    if page.ndim == 0 or 0 in page.shape:
        raise FieldImageError(f"{path}: has a page without pixels, must be a picture")
    if too_much := excess(BYTES_WHILE_READING * float(np.prod(page.shape, dtype=float))):
        raise FieldImageError(f"{path}: its {page.imagewidth} x {page.imagelength} pixels {too_much}")
    size = path.stat().st_size
    if any(offset + count > size for offset, count in zip(page.dataoffsets, page.databytecounts)):
        raise FieldImageError(f"{path}: is a damaged TIFF, it is cut short; must be a whole TIFF, PNG, JPEG or OpenEXR")


def _values(path: Path, page) -> np.ndarray:
    try:
        return page.asarray()
    except (ValueError, ImportError) as error:
        if "imagecodecs" in str(error):
            compression = getattr(page.compression, "name", page.compression)
            raise FieldImageError(
                f"{path}: its compression {compression} needs the package imagecodecs (pip install imagecodecs),"
                " or save the image without compression"
            ) from None
        raise


def _intensity(path: Path, page, values: np.ndarray) -> np.ndarray:
    """Values of a page as intensity, by what its photometric tag says they are."""
    axes = page.axes
    if values.dtype.kind not in "biuf" or set(axes) - set("YXS"):
        raise FieldImageError(
            f"{path}: has values of type {values.dtype} and shape {values.shape},"
            " must be one picture, grey or in colours"
        )
    samples = np.moveaxis(values, axes.index("S"), -1) if "S" in axes else values[..., None]
    kind = getattr(page.photometric, "name", str(page.photometric))
    full = float(2**page.bitspersample - 1) if values.dtype.kind in "bu" else 1.0
    if kind == "PALETTE":
        if page.colormap is None:
            raise FieldImageError(f"{path}: has palette indices and no palette, must have a colour map")
        image = luminance(np.moveaxis(np.asarray(page.colormap, dtype=float), 0, -1))[samples[..., 0]]
    elif kind == "MINISWHITE":
        if values.dtype.kind == "f":
            raise FieldImageError(f"{path}: says that 0 is white in floating point, must be integers or 0 black")
        image = full - samples[..., 0].astype(float)
    elif kind == "SEPARATED" and samples.shape[-1] >= 4:
        image = cmyk_luminance(samples[..., :4], full)
    elif kind in ("MINISBLACK", "CFA", "LINEAR_RAW", "CIELAB", "ICCLAB", "LOGL") and (
        samples.shape[-1] < 3 or kind != "MINISBLACK"
    ):
        image = samples[..., 0]
    elif samples.shape[-1] in (3, 4) and kind in ("RGB", "YCBCR", "MINISBLACK"):
        image = luminance(samples[..., :3])
    else:
        raise FieldImageError(
            f"{path}: has {samples.shape[-1]} samples a pixel of kind {kind}, must be grey, RGB, CMYK or a palette"
        )
    tag = page.tags.get("Orientation")
    return oriented(image, int(tag.value) if tag is not None else 1)
