"""What may vary, and how: tolerances on a scene's numbers, read from a TOML file.

A table a number, named as :mod:`.design` names them, with one of

    normal = sd              # standard deviation about the scene's value
    uniform = half width     # about the scene's value
    triangular = half width  # about the scene's value
    bounds = [a, b]          # evenly between two values

Besides, each may be there or not:

    [[correlated]]           # numbers that vary together
    parameters = ["laser_distance", "detector_distance"]
    coefficient = 0.8        # or matrix = [[1, 0.8], [0.8, 1]]

    [[compensator]]          # a number that assembly adjusts until theory has an entry at a value
    parameter = "detector_distance"
    bounds = [190, 210]
    condition = "ry.u"       # in focus a tilt does not move the image
    value = 0                # unless given, what the scene has without tolerances

    [allowed]                # standard uncertainties that are allowed of entries: how wide may tolerances be?
    "z.u" = 0.001
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import stats

from ..errors import InputError

KINDS = {"normal": "a standard deviation", "uniform": "a half width", "triangular": "a half width",
         "bounds": "two values [a, b]"}  # fmt: skip
CORRELATED, COMPENSATOR, ALLOWED = "correlated", "compensator", "allowed"


@dataclass(frozen=True)
class Tolerance:
    """How one number varies about ``middle``: size is the standard deviation of ``normal``, else the half width."""

    parameter: str
    kind: str
    middle: float
    size: float

    @property
    def deviation(self) -> float:
        """Standard deviation."""
        return self.size * {"normal": 1.0, "triangular": 6**-0.5}.get(self.kind, 3**-0.5)

    def values(self, probability: np.ndarray) -> np.ndarray:
        """The values below which the number lies with given probabilities, any shape."""
        if self.kind == "normal":
            return self.middle + self.size * stats.norm.ppf(probability)
        if self.kind == "triangular":
            below = np.sqrt(2 * probability) - 1
            above = 1 - np.sqrt(2 * (1 - probability))
            return self.middle + self.size * np.where(probability < 0.5, below, above)
        return self.middle + self.size * (2 * probability - 1)

    def scaled(self, factor: float) -> Tolerance:
        """The same, so many times as wide."""
        return replace(self, size=self.size * factor)

    def to_toml(self) -> str:
        """As it stands in a file."""
        if self.kind == "bounds":
            value = f"[{self.middle - self.size!r}, {self.middle + self.size!r}]"
        else:
            value = repr(self.size)
        return f'["{self.parameter}"]\n{self.kind} = {value}\n'


@dataclass(frozen=True)
class Factor:
    """Numbers that vary together and independently of all others, by the rank correlation of a Gaussian copula.

    correlation: (k, k) of the normal variables behind them.
    """

    tolerances: tuple[Tolerance, ...]
    correlation: np.ndarray

    @property
    def name(self) -> str:
        """Of one its own, of several with + between."""
        return " + ".join(one.parameter for one in self.tolerances)

    @property
    def size(self) -> int:
        """How many numbers."""
        return len(self.tolerances)

    @property
    def covariance(self) -> np.ndarray:
        """(k, k) of the numbers, exact for normal ones."""
        sizes = np.array([one.deviation for one in self.tolerances])
        return self.correlation * np.outer(sizes, sizes)

    def values(self, probability: np.ndarray) -> np.ndarray:
        """(n, k) values from (n, k) independent probabilities."""
        if self.size > 1:
            independent = stats.norm.ppf(probability)
            probability = stats.norm.cdf(independent @ np.linalg.cholesky(self.correlation).T)
        return np.stack(
            [one.values(column) for one, column in zip(self.tolerances, probability.T, strict=True)], axis=1
        )

    def scaled(self, factor: float) -> Factor:
        """The same, so many times as wide."""
        return replace(self, tolerances=tuple(one.scaled(factor) for one in self.tolerances))


@dataclass(frozen=True)
class Adjustment:
    """What a file says of a compensator; value: None for what the scene has without tolerances."""

    parameter: str
    bounds: tuple[float, float]
    condition: str
    value: float | None


@dataclass(frozen=True)
class Tolerances:
    """What a file says: independent factors, what is adjusted, and allowed standard uncertainties by entry."""

    factors: tuple[Factor, ...]
    adjustments: tuple[Adjustment, ...] = ()
    allowed: tuple[tuple[str, float], ...] = ()

    @property
    def parameters(self) -> list[str]:
        """The numbers that vary, in the factors' order."""
        return [one.parameter for factor in self.factors for one in factor.tolerances]

    def scaled(self, factor: float) -> Tolerances:
        """All of them so many times as wide."""
        return replace(self, factors=tuple(one.scaled(factor) for one in self.factors))

    def to_toml(self) -> str:
        """The tolerances and their correlations as a file, without what is adjusted and allowed."""
        parts = [one.to_toml() for factor in self.factors for one in factor.tolerances]
        for factor in self.factors:
            if factor.size > 1:
                names = ", ".join(f'"{one.parameter}"' for one in factor.tolerances)
                parts.append(f"[[{CORRELATED}]]\nparameters = [{names}]\nmatrix = {factor.correlation.tolist()}\n")
        return "\n".join(parts)


def read_tolerances(path: str, nominal: Mapping[str, float]) -> Tolerances:
    """The tolerances in a file on a scene whose numbers are ``nominal``. Raises InputError, OSError."""
    return tolerances_of(read_toml(path), nominal, path)


def tolerances_of(tables: Mapping, nominal: Mapping[str, float], path: str = "tolerances") -> Tolerances:
    """The same from what such a file holds; path: how messages call it."""
    content = dict(tables)
    correlated, adjusted = (content.pop(name, []) for name in (CORRELATED, COMPENSATOR))
    allowed = content.pop(ALLOWED, {})
    varying = {
        name: _tolerance(f"{path}: [{name}]", name, table, nominal)
        for name, table in flat(content, says_something).items()
    }
    if not varying:
        raise InputError(f"{path}: holds no tolerance, must have a table a number, such as [laser_angle] normal = 0.5")
    factors = _factors(path, varying, _tables(path, CORRELATED, correlated))
    adjustments = [_adjustment(path, table, nominal, varying) for table in _tables(path, COMPENSATOR, adjusted)]
    if not isinstance(allowed, dict):
        raise InputError(f"{path}: [{ALLOWED}] must be a table of entries and standard uncertainties")
    limits = flat(allowed, lambda table: False)
    for name, value in limits.items():
        if not (_is_number(value) and value > 0):
            raise InputError(f"{path}: [{ALLOWED}] {name} = {value!r}: must be a number above 0 (mm/mm or mm/deg)")
    return Tolerances(tuple(factors), tuple(adjustments), tuple((name, float(one)) for name, one in limits.items()))


def read_toml(path: str) -> dict:
    """What a TOML file holds. Raises InputError where it is none, OSError."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: there is no such file, must be a TOML file")
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no TOML file ({error})") from None


def flat(tables: Mapping, is_end, before: str = "") -> dict:
    """Tables within tables by their whole names, with points between, down to what ``is_end`` or is no table."""
    found = {}
    for name, value in tables.items():
        name = f"{before}{name}"
        if isinstance(value, dict) and value and not is_end(value):
            found |= flat(value, is_end, f"{name}.")
        else:
            found[name] = value
    return found


def says_something(table: Mapping) -> bool:
    """Whether a table holds more than tables."""
    return not all(isinstance(value, dict) for value in table.values())


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _tolerance(where: str, name: str, table: object, nominal: Mapping[str, float]) -> Tolerance:
    wanted = ", ".join(f"{kind} ({what})" for kind, what in KINDS.items())
    if not isinstance(table, dict) or len(table) != 1 or not KINDS.keys() >= table.keys():
        said = ", ".join(table) if isinstance(table, dict) and table else repr(table)
        raise InputError(f"{where}: says {said}, must say exactly one of {wanted}")
    ((kind, value),) = table.items()
    if kind == "bounds":
        if not (isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)) and value[0] < value[1]):
            raise InputError(f"{where}: bounds = {value!r}: must be two numbers [a, b], a below b")
        return Tolerance(name, kind, (value[0] + value[1]) / 2, (value[1] - value[0]) / 2)
    if not (_is_number(value) and value > 0):
        raise InputError(f"{where}: {kind} = {value!r}: must be a number above 0, {KINDS[kind]}")
    if name not in nominal:
        return Tolerance(name, kind, math.nan, float(value))  # reported with what there is, by whom knows the scene
    return Tolerance(name, kind, nominal[name], float(value))


def _tables(path: str, name: str, given: object) -> list[dict]:
    if not isinstance(given, list) or not all(isinstance(table, dict) for table in given):
        raise InputError(f"{path}: {name} must be tables, each under [[{name}]]")
    return given


def _factors(path: str, varying: Mapping[str, Tolerance], groups: Sequence[dict]) -> list[Factor]:
    """Numbers in a group are one factor, any other is one of its own; in the file's order."""
    of_group: dict[str, Factor] = {}
    for table in groups:
        names, where = table.get("parameters"), f"{path}: [[{CORRELATED}]]"
        if not (isinstance(names, list) and len(names) > 1 and len(set(map(str, names))) == len(names)):
            raise InputError(f"{where} parameters = {names!r}: must be two or more names of numbers with tolerances")
        for name in names:
            if name not in varying:
                raise InputError(f"{where} {name}: has no tolerance, must be one of {', '.join(varying)}")
            if name in of_group:
                raise InputError(f"{where} {name}: is in two groups, must be in one")
        correlation = _correlation(where, table, len(names))
        of_group |= dict.fromkeys(names, Factor(tuple(varying[name] for name in names), correlation))
    factors = []
    for name, one in varying.items():
        factor = of_group.get(name, Factor((one,), np.eye(1)))
        if not any(other is factor for other in factors):
            factors.append(factor)
    return factors


def _correlation(where: str, table: dict, count: int) -> np.ndarray:
    """(k, k). Raises InputError where it is none."""
    said = table.keys() - {"parameters"}
    if said == {"coefficient"} and _is_number(table["coefficient"]):
        matrix = np.full((count, count), float(table["coefficient"]))
        np.fill_diagonal(matrix, 1.0)
    elif said == {"matrix"}:
        try:
            matrix = np.array(table["matrix"], dtype=np.float64)
        except (TypeError, ValueError):
            matrix = np.empty(0)
    else:
        raise InputError(f"{where}: must say 'parameters' and one of 'coefficient' (a number) and 'matrix'")
    fits = matrix.shape == (count, count) and np.array_equal(matrix, matrix.T) and np.all(np.diag(matrix) == 1)
    if not fits or np.linalg.eigvalsh(matrix)[0] <= 1e-12:
        raise InputError(
            f"{where}: the correlation must be {count} x {count}, symmetric, 1 on its diagonal and positive definite"
        )
    return matrix


def _adjustment(path: str, table: dict, nominal: Mapping[str, float], varying: Mapping) -> Adjustment:
    where, needed = f"{path}: [[{COMPENSATOR}]]", {"parameter", "bounds", "condition"}
    if not needed <= table.keys() <= needed | {"value"}:
        raise InputError(
            f"{where}: says {', '.join(table) or 'nothing'}, must say parameter, bounds and condition (value)"
        )
    name, bounds, condition, value = table["parameter"], table["bounds"], table["condition"], table.get("value")
    if name not in nominal:
        raise InputError(f"{where} {name}: the scene has no such number, must be one of {', '.join(nominal)}")
    if name in varying:
        raise InputError(f"{where} {name}: has a tolerance as well, must be either adjusted or left to chance")
    if not (isinstance(bounds, list) and len(bounds) == 2 and all(map(_is_number, bounds)) and bounds[0] < bounds[1]):
        raise InputError(f"{where} bounds = {bounds!r}: must be two numbers [a, b], a below b")
    if not isinstance(condition, str):
        raise InputError(f'{where} condition = {condition!r}: must be an entry such as "ry.u"')
    if value is not None and not _is_number(value):
        raise InputError(f"{where} value = {value!r}: must be a number")
    return Adjustment(name, (float(bounds[0]), float(bounds[1])), condition, None if value is None else float(value))
