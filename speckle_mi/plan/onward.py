"""Which part of an opening sends its light on to the detector.

Behind an opening of many Fresnel zones each part of the light goes on as its rays do, and the detector sees what comes
from a part of the opening alone. Where in it a place's rays land is a smooth function of the place; around the detector
diffraction spreads over a zone's width, or over all that a small opening throws light at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..propagation.chebyshev import tensor_polynomials

_DEGREE = 5

ORDERS = np.array([(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)])
"""Of the polynomials in x and y of a place."""

_DRAWN, _MORE, FEWEST = 1 << 13, 1 << 17, 64
"""Places drawn to find those that send light on, drawn again where there are fewer than the last."""

_SEED = 4


@dataclass(frozen=True, eq=False)
class Onward:
    """Where light goes on to from an opening whose outline reaches to ``reach`` [mm].

    landing: (s, q, 2) coefficients of the places [mm] from the detector's middle, along u and v, at which the rays from
    s places of the spot land; half: (2,) of the detector with the width of diffraction around it [mm].
    """

    reach: float
    landing: np.ndarray
    half: np.ndarray

    def sends(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether light of any place of the spot goes on to the detector from places x, y (n,) [mm] of the opening."""
        polynomials = tensor_polynomials(ORDERS, np.column_stack([x, y]) / self.reach).T
        found = np.zeros(len(polynomials), dtype=bool)
        for coefficients in self.landing:
            found |= np.all(np.abs(polynomials @ coefficients) <= self.half, axis=1)
        return found

    def drawn(self, x: np.ndarray, y: np.ndarray, areas: np.ndarray) -> np.ndarray | None:
        """Indices of nodes x, y (n,) [mm] that send light to the detector, drawn as often as their ``areas`` count.

        None where there are too few: what reaches the detector is then diffracted light from all over the opening.
        """
        random, share = np.random.default_rng(_SEED), np.cumsum(areas)
        for count in (_DRAWN, _MORE):
            some = np.minimum(np.searchsorted(share, random.random(count) * share[-1]), len(areas) - 1)
            found = some[self.sends(x[some], y[some])]
            if len(found) >= FEWEST:
                return found
        return None
