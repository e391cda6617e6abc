"""Many sources: the coherent sum as a few nonuniform FFTs.

Around a source P0 in the middle of the source box and a point D0 in the middle of the target the path is split into

    V(P, D) = V(P0, D) + [V(P, D0) - V(P0, D0)] + W(P, D),    W(P, D) = q(D) + s(D) . x(P) + rest,

x in [-1, 1]^d the place in the box. The first belongs to the target alone, the second to the source alone. The slopes s
make a type-3 NUFFT (its exponent is linear in x). What is left, A(P, D) e^{ik rest}, varies slowly with both and has a
low rank:

    E(D) = e^{ik[V(P0, D) + q(D)]} sum_t b_t(D) sum_j [c_j a_t(P_j) e^{ik[V(P_j, D0) - V(P0, D0)]}] e^{iks(D) . x_j}.

It is sampled on Chebyshev nodes of box and target only, so that any smooth path will do, traced lenses included. The
NUFFT is FINUFFT (Barnett, Magland & af Klinteberg, SIAM J. Sci. Comput. 41 (2019), doi:10.1137/18M120885X).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.plane import PlaneGrid, PlanePoints
from ..machine.cores import equal_slices, on_all_cores, usable_cores
from ..machine.nufft import finufft
from .area import Area
from .chebyshev import TensorSeries, axis_tails, interpolation_matrix, tensor_coefficients, tensor_nodes
from .paths import Path
from .source_box import SourceBox, chunks, for_chunks

FIRST_ORDERS = (5, 5, 3)
"""Nodes tried first along the source box; target's two sides start from the first of them."""

LARGEST_TABLE = 1_500_000
"""Source-node x target-node pairs beyond which the expansion is given up: near field or a huge spot."""

SMALLEST_PART = 64
"""Sources that are not shared out further: their pairs cost less than NUFFTs."""

RANK_SHARE = 0.35
"""Share of the tolerance that the terms left out may take on average: a realisation's error scatters about that."""

LARGEST_RANK = 80
"""Rank beyond which the expansion is given up."""

SAMPLED_SOURCES = 256
"""Sources on which the rank is decided, with their own weights: what no source lights need not be expanded."""

SAMPLE_SEED = 6
"""Seed of that sample."""

SINGLE_TOLERANCE = 5e-5
"""Relative error down to which float32 NUFFTs and weights are used."""

PIECE = 1 << 18
"""Sources or places that one core takes at once: bounds the memory at 16 bytes x rank for each."""

SMALLEST_PIECE = 1 << 13
"""Sources or places below which a second core does not pay."""


@dataclass(frozen=True)
class LowRank:
    """The expansion for one geometry; see the module's docstring.

    middle: D0, (1, 3) [mm]; source_series: real parts of all a_t, then imaginary parts; target_series: the same of b_t,
    then slopes and q [turns]; linear: which box dimensions the NUFFT takes; reach [turns]: largest |slope| along each.
    """

    path: Path
    box: SourceBox
    rectangle: Area
    wavelength: float
    middle: np.ndarray
    target_series: TensorSeries
    source_series: TensorSeries
    rank: int
    linear: tuple[int, ...]
    reach: np.ndarray
    tolerance: float

    @property
    def double(self) -> bool:
        return self.tolerance < SINGLE_TOLERANCE or 2 * np.pi * self.reach.max(initial=0.0) * 1e-7 > self.tolerance / 4

    @property
    def cost_factor(self) -> float:
        """Time of a NUFFT point relative to two dimensions in float32."""
        return (1.5 if self.double else 1.0) * (6.0 if len(self.linear) == 3 else 1.0)


def expand(
    path: Path,
    sources: np.ndarray,
    weights: np.ndarray,
    target: PlaneGrid | PlanePoints,
    box: SourceBox,
    wavelength: float,
    tolerance: float,
    largest_table: int = LARGEST_TABLE,
) -> LowRank | None:
    """Expansion to relative L2 ``tolerance``, or None where it takes more node pairs than ``largest_table``."""
    rectangle = Area.around(target)
    middle = rectangle.points(target, np.zeros((1, 2))).points()
    orders = [FIRST_ORDERS[i] if box.half[i] > 0 else 1 for i in range(3)]
    orders += [FIRST_ORDERS[0] if side[1] > side[0] else 1 for side in rectangle.sides]
    while True:
        if np.prod(orders) > largest_table:
            return None
        source_orders, target_orders = tuple(orders[:3]), tuple(orders[3:])
        nodes, places = tensor_nodes(source_orders), tensor_nodes(target_orders)
        turns, kernel_amplitude = _mixed_path(path, box, target, rectangle, nodes, places, middle, wavelength)
        linear, slopes = _slopes(turns, source_orders)
        constant = tensor_coefficients(turns, source_orders)[0, 0, 0]
        rest = turns - constant - nodes[:, linear] @ slopes
        kernel = kernel_amplitude * np.exp(2j * np.pi * rest)
        tails = axis_tails(tensor_coefficients(kernel, source_orders).reshape(*source_orders, -1))
        target_tails = axis_tails(tensor_coefficients(kernel.T, target_orders))
        path_tails = _absolute_tails(np.concatenate([slopes, constant[None]]).T, target_orders) * 2 * np.pi
        tails = np.concatenate([tails, np.maximum(target_tails, path_tails)])
        failing = [i for i in range(5) if tails[i] > tolerance / 10]
        if not failing:
            break
        for i in failing:
            orders[i] = int(np.ceil(orders[i] * 1.4)) + 1
    found = _compress(kernel, _sampled_rows(kernel, box, source_orders, sources, weights), tolerance)
    if found is None:
        return None
    left, right = found
    source_values = np.concatenate([left.real, left.imag], axis=1)
    target_values = np.concatenate([right.real, right.imag, slopes, constant[None]]).T
    return LowRank(
        path=path,
        box=box,
        rectangle=rectangle,
        wavelength=wavelength,
        middle=middle,
        target_series=TensorSeries.pruned(tensor_coefficients(target_values, target_orders), 0.0),
        source_series=TensorSeries.pruned(tensor_coefficients(source_values, source_orders), tolerance / 4),
        rank=len(right),
        linear=tuple(linear),
        reach=np.abs(slopes).max(axis=1, initial=0.0),
        tolerance=tolerance,
    )


@dataclass(frozen=True)
class SpotPart:
    """An expansion and the sources that it is for: their indices or the slice of all, and how many."""

    expansion: LowRank
    members: np.ndarray | slice
    count: int


def expand_in_parts(
    path: Path,
    sources: np.ndarray,
    weights: np.ndarray,
    target: PlaneGrid | PlanePoints,
    box: SourceBox,
    wavelength: float,
    tolerance: float,
    largest_table: int,
    most_parts: int,
    most_looked_at: float = np.inf,
) -> list[SpotPart] | None:
    """Expansions of all sources, or of halves, quarters, ... of too large a spot; None beyond ``most_parts``.

    box: around all sources; most_looked_at: sources, each counted as often as it is, from which on the search has cost
    more than it can save.
    """
    whole = expand(path, sources, weights, target, box, wavelength, tolerance, largest_table)
    if whole is not None:
        return [SpotPart(whole, slice(None), len(sources))]
    if len(sources) < SMALLEST_PART:
        return None
    looked_at = 2.0 * len(sources)
    if looked_at > most_looked_at:
        return None
    waiting, parts = _halves(np.arange(len(sources)), sources, box), []
    while waiting:
        members = waiting.pop()
        looked_at += 2.0 * len(members)
        if len(waiting) + len(parts) >= most_parts or looked_at > most_looked_at:
            return None
        some = sources[members]
        box = SourceBox.around(some, target.u)
        expansion = expand(path, some, weights[members], target, box, wavelength, tolerance, largest_table)
        if expansion is not None:
            parts.append(SpotPart(expansion, members, len(members)))
            continue
        if len(members) < SMALLEST_PART:
            return None
        waiting += _halves(members, some, box)
    return parts


def _halves(members: np.ndarray, sources: np.ndarray, box: SourceBox) -> list[np.ndarray]:
    """The members on either side of the middle of their box's longest side."""
    upper = box.to_local(sources)[:, np.argmax(box.half)] > 0
    return [members[upper], members[~upper]]


def _absolute_tails(values: np.ndarray, orders: tuple[int, ...]) -> np.ndarray:
    """Largest absolute sum of the last two coefficient slices along each dimension of values (nodes, k)."""
    coefficients = np.abs(tensor_coefficients(values, orders))
    tails = []
    for axis, order in enumerate(orders):
        last = np.take(coefficients, range(max(1, order - 2), order), axis=axis)
        tails.append(float(last.sum(axis=(0, 1)).max(initial=0.0)) if order > 1 else 0.0)
    return np.array(tails)


def _mixed_path(
    path: Path,
    box: SourceBox,
    target: PlaneGrid | PlanePoints,
    rectangle: Area,
    nodes: np.ndarray,
    places: np.ndarray,
    middle: np.ndarray,
    wavelength: float,
) -> tuple[np.ndarray, np.ndarray]:
    """W/lambda and A on source nodes x target nodes (n, m)."""
    points = rectangle.points(target, places).points()
    length, amplitude = path(np.vstack([box.centre, box.to_world(nodes)]), np.vstack([middle, points]))
    mixed = (length[1:, 1:] - length[:1, 1:]) - (length[1:, :1] - length[:1, :1])
    return mixed / wavelength, amplitude[1:, 1:]


def _slopes(turns: np.ndarray, orders: tuple[int, ...]) -> tuple[list[int], np.ndarray]:
    """Box dimensions for the NUFFT and the linear Chebyshev coefficients (dimensions, m) along them [turns].

    The two steepest, and the third where it turns the phase by more than a radian.
    """
    coefficients = tensor_coefficients(turns, orders)
    candidates = []
    for axis in range(3):
        if orders[axis] > 1:
            pick = [0, 0, 0]
            pick[axis] = 1
            candidates.append((axis, coefficients[tuple(pick)]))
    candidates.sort(key=lambda item: -np.abs(item[1]).max())
    chosen = [item for rank, item in enumerate(candidates) if rank < 2 or np.abs(item[1]).max() > 0.15]
    chosen.sort(key=lambda item: item[0])
    return [axis for axis, _ in chosen], np.array([slope for _, slope in chosen]).reshape(len(chosen), turns.shape[1])


def _sampled_rows(
    kernel: np.ndarray, box: SourceBox, orders: tuple[int, ...], sources: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Rows of the kernel (nodes, m) at randomly drawn sources, times the modulus of their weights."""
    pick = np.random.default_rng(SAMPLE_SEED).integers(len(sources), size=SAMPLED_SOURCES)
    x = np.clip(box.to_local(sources[pick]), -1, 1)
    matrices = [interpolation_matrix(order, x[:, axis]) for axis, order in enumerate(orders)]
    rows = np.tensordot(matrices[0], kernel.reshape(orders[0], -1), axes=1)
    for matrix in matrices[1:]:
        rows = np.matmul(matrix[:, None, :], rows.reshape(len(pick), matrix.shape[1], -1))
    return rows.reshape(len(pick), -1) * np.abs(weights[pick])[:, None]


def _compress(kernel: np.ndarray, rows: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray] | None:
    """kernel (nodes, m) = left (nodes, rank) @ right (rank, m), rows of right orthonormal; None beyond LARGEST_RANK.

    The rank is decided on ``rows``, the kernel at sources with their own weights.
    """
    # The nodes join with a weight of a tenth of the tolerance: nothing in the box is left out altogether.
    floor = 0.1 * tolerance * np.linalg.norm(rows) / (np.linalg.norm(kernel) or 1.0)
    stacked = np.concatenate([rows, floor * kernel])
    if len(stacked) < stacked.shape[1]:
        # Fewer rows than targets: the Gram matrix of the rows has the same spectrum and is the smaller one.
        values, vectors = np.linalg.eigh(stacked @ stacked.conj().T)
        vectors = stacked.conj().T @ (vectors / np.sqrt(np.maximum(values, np.finfo(float).tiny)))
    else:
        values, vectors = np.linalg.eigh(stacked.conj().T @ stacked)
    left_out = np.sqrt(np.cumsum(np.maximum(values, 0.0)))
    rank = max(1, int(np.count_nonzero(left_out > RANK_SHARE * tolerance * left_out[-1])))
    if rank > LARGEST_RANK:
        return None
    right = vectors[:, ::-1][:, :rank].conj().T
    return kernel @ right.conj().T, right


def low_rank_sum(expansion: LowRank, sources: np.ndarray, weights: np.ndarray, places: PlanePoints) -> np.ndarray:
    """Field (m,) complex128 at the places, on the plane and within the rectangle of the expansion's target.

    The sources or the places, whichever are more, are shared out to the cores, each with NUFFTs of one thread: without
    barriers a busy machine costs a core's share, not a multiple.
    """
    rank = expansion.rank
    scale = float(np.abs(weights).max()) or 1.0
    at = expansion.rectangle.unit_places(places.a, places.b)
    on_target = np.concatenate(for_chunks(lambda chunk: expansion.target_series(at[chunk]), places.size))
    slopes = 2 * np.pi * on_target[:, 2 * rank : -1].T
    factors = (on_target[:, :rank] + 1j * on_target[:, rank : 2 * rank]).T

    if len(sources) >= places.size:

        def of_piece(piece: slice) -> np.ndarray:
            x, terms = _source_terms(expansion, sources[piece], weights[piece] / scale)
            return np.einsum("tm,tm->m", factors, _transform(x, terms, slopes, expansion))

        field = np.sum(on_all_cores(of_piece, _pieces(len(sources))), axis=0)
    else:
        x, terms = _source_terms(expansion, sources, weights / scale)

        def at_piece(piece: slice) -> np.ndarray:
            return np.einsum("tm,tm->m", factors[:, piece], _transform(x, terms, slopes[:, piece], expansion))

        field = np.concatenate(on_all_cores(at_piece, _pieces(places.size)))
    common = expansion.path(expansion.box.centre[None], places.points())[0][0] / expansion.wavelength
    common += on_target[:, -1]
    return field * (scale * np.exp(2j * np.pi * (common - np.round(common))))


def _pieces(count: int) -> list[slice]:
    """As many equal slices as cores, or a multiple where they would be larger than ``PIECE``."""
    cores = usable_cores()
    number = 1 if count < SMALLEST_PIECE * cores else cores * -(-count // (cores * PIECE))
    return equal_slices(count, number)


def _source_terms(expansion: LowRank, sources: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """NUFFT coordinates x (dimensions, n) and c_j a_t(P_j) e^{ik[V(P_j, D0) - V(P0, D0)]} (rank, n)."""
    rank, linear = expansion.rank, list(expansion.linear)
    real, complex_type = (np.float64, np.complex128) if expansion.double else (np.float32, np.complex64)
    x = np.empty((len(linear), len(sources)), dtype=real)
    terms = np.empty((rank, len(sources)), dtype=complex_type)
    reference = expansion.path(expansion.box.centre[None], expansion.middle)[0][0, 0]
    for chunk in chunks(len(sources)):
        local = expansion.box.to_local(sources[chunk])
        x[:, chunk] = local[:, linear].T
        turns = (expansion.path(sources[chunk], expansion.middle)[0][:, 0] - reference) / expansion.wavelength
        angle = (2 * np.pi * (turns - np.round(turns))).astype(real)
        phasor = np.empty(len(angle), dtype=complex_type)
        np.cos(angle, out=phasor.real)
        np.sin(angle, out=phasor.imag)
        phasor *= weights[chunk].astype(complex_type)
        series = expansion.source_series(local, real).T
        some = terms[:, chunk]
        some.real, some.imag = series[:rank], series[rank:]
        some *= phasor
    return x, terms


def _transform(x: np.ndarray, terms: np.ndarray, slopes: np.ndarray, expansion: LowRank) -> np.ndarray:
    """sum_j terms[t, j] e^{i slopes . x_j}, (t, m)."""
    if not len(x):
        return np.repeat(terms.sum(axis=1, dtype=np.complex128)[:, None], slopes.shape[1], axis=1)
    eps = max(expansion.tolerance / 5, 1e-14 if expansion.double else 1e-6)
    # FINUFFT's warnings about the last digit would only repeat what the measured error says.
    options = {"isign": 1, "dtype": terms.dtype.name, "nthreads": 1, "showwarn": 0}
    if not expansion.double:
        # Its own choice where points are many, 1.25, is slower here and in float32 ten times less exact.
        options["upsampfac"] = 2.0
    plan = finufft.Plan(3, len(x), n_trans=len(terms), eps=eps, **options)
    plan.setpts(*_padded(x), *_padded(slopes.astype(x.dtype)))
    return np.atleast_2d(plan.execute(terms if len(terms) > 1 else terms[0]))


def _padded(rows: np.ndarray) -> list[np.ndarray | None]:
    """Contiguous coordinate rows, None for the missing of three."""
    return [np.ascontiguousarray(row) for row in rows] + [None] * (3 - len(rows))
