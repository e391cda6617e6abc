"""Results as named arrays in a NetCDF file (classic format, version 2), which xarray and most tools read.

SciPy writes it, so that neither pandas nor an HDF5 library has to be there: ``xarray.open_dataset(path,
engine="scipy")``, or any other engine.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.io import netcdf_file

from .files import replacing


@dataclass(frozen=True)
class NamedArray:
    """dims: names of the dimensions, in order; values: numbers, or texts; attributes: such as ``units``."""

    dims: tuple[str, ...]
    values: np.ndarray | Sequence
    attributes: Mapping[str, str] = field(default_factory=dict)


def write_netcdf(path: str | os.PathLike, arrays: Mapping[str, NamedArray], attributes: Mapping[str, str]) -> None:
    """Writes arrays by name, whole or not at all. One that is called as a dimension tells that dimension's places.

    Raises ValueError for arrays whose dimensions do not fit together.
    """
    sizes: dict[str, int] = {}
    for name, one in arrays.items():
        shape = np.shape(one.values)
        if len(shape) != len(one.dims) or any(
            sizes.setdefault(d, n) != n for d, n in zip(one.dims, shape, strict=True)
        ):
            raise ValueError(f"{name}: values {shape} do not fit dimensions {one.dims} of {sizes}")
    with replacing(path) as temporary, netcdf_file(str(temporary), "w", version=2) as file:
        for name, value in attributes.items():
            setattr(file, name, value.encode())
        for name, size in sizes.items():
            file.createDimension(name, size)
        for name, one in arrays.items():
            _add(file, name, one)


def _add(file: netcdf_file, name: str, one: NamedArray) -> None:
    values, dims = np.asarray(one.values), one.dims
    attributes = dict(one.attributes)
    if values.dtype.kind == "U":
        encoded = np.char.encode(values, "utf-8")
        width = max(encoded.dtype.itemsize, 1)
        length = f"{name}_length"
        file.createDimension(length, width)
        values = encoded.astype(f"S{width}").reshape(-1).view("S1").reshape(*values.shape, width)
        dims, attributes = (*dims, length), attributes | {"_Encoding": "utf-8"}
    elif values.dtype.kind in "iub":
        values = values.astype(np.int32)
    else:
        values = values.astype(np.float64)
    variable = file.createVariable(name, "c" if values.dtype.kind == "S" else values.dtype.newbyteorder("="), dims)
    variable[:] = values
    for key, text in attributes.items():
        setattr(variable, key, text.encode())
