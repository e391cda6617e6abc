"""Light that a scene does not state: found by straight lines past screens and balls, and shut out by baffles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from reference_rays import Face, NoReference, chief, frame_along, trace

CLEAR = 0.8
"""Part of a face's half-width within which the light has to stay."""


def crosses(p, q, plane):
    """Whether the open segment p to q (3,) meets a screen (centre, axes, outer half, hole)."""
    centre, axes, outer, hole = plane
    a, b = (p - centre) @ axes, (q - centre) @ axes
    if a[2] * b[2] >= 0 or min(abs(a[2]), abs(b[2])) < 1e-6 * max(abs(a[2]), abs(b[2])):
        return False
    s = a[2] / (a[2] - b[2])
    x = (a + s * (b - a))[:2]
    inside = np.hypot(*x) < outer[0] if len(outer) == 1 else np.all(np.abs(x) < outer)
    if hole is not None:
        inside = inside and not (np.hypot(*x) < hole[0] if len(hole) == 1 else np.all(np.abs(x) < hole))
    return bool(inside)


def _through_ball(p, q, ball):
    centre, radius = ball
    along = q - p
    s = np.clip((centre - p) @ along / (along @ along), 0, 1)
    nearest = np.linalg.norm(p + s * along - centre)
    return nearest < 0.999 * radius


def blocked(bench, p, q, mirrors=()):
    """Whether anything on the bench but given mirrors, at which the light ends, stands between two places."""
    own = {id(face.axes) for face in mirrors}
    return any(crosses(p, q, plane) for plane in [*bench.planes, *bench.glass] if id(plane[1]) not in own) or any(
        _through_ball(p, q, ball) for ball in [*bench.balls, *bench.glass_balls])


def seen_through(bench, holes, places):
    """Whether each of places of a hole (n, 3) sees each of others (m, 3) that lie where its light goes, (n, m)."""
    centre, axes = next((c, a) for c, a, _, hole in bench.planes if hole is not None and np.allclose(c, holes[0]))
    side = float((bench.source - centre) @ axes[:, 2])
    behind = [float((place - centre) @ axes[:, 2]) * side < 0 for place in places]
    return np.array([[b and not blocked(bench, p, q) for q, b in zip(places, behind, strict=True)] for p in holes])


def require_free(bench):
    """NoReference where the chief ray, or one to an opening's edge, ends at something that it should pass."""
    whole = [plane for plane in bench.planes if plane[3] is None]
    for segments, planes in ((bench.path, bench.planes), (bench.rims, whole)):
        for p, q in segments:
            if any(crosses(p, q, plane) for plane in planes) or any(_through_ball(p, q, b) for b in bench.balls):
                raise NoReference("something stands in the light")


def _spread(targets):
    return np.max(np.linalg.norm(targets - targets.mean(0), axis=1))


def _shield(bench, targets, room):
    """A baffle between the source and places (m, 3) that it must not see, clear of the chief path by ``room``."""
    middle = targets.mean(0)
    for f in bench.rng.permutation(np.linspace(0.2, 0.85, 12)):
        centre = bench.source + f * (middle - bench.source)
        normal = middle - bench.source
        half = 1.3 * f * _spread(targets) + bench.between(1.0, 1.5) * room
        screen = (centre, frame_along(normal), (half + room, half + room), None)
        if any(crosses(p, q, screen) for p, q in bench.path if np.linalg.norm(q - p) > 0):
            continue
        if centre[2] < 1.5 * half * np.linalg.norm(normal[:2]) / np.linalg.norm(normal):
            continue
        bench.baffle(centre, normal, half)
        return
    raise NoReference("no room for a baffle")


def shade_over(bench, start, faces, place, room):
    """Shuts out the light that goes from one place over faces to another, if any does.

    By a baffle of half-width ``room``, clear of the chief path.
    """
    try:
        corners = _corners(start, faces, place)
    except NoReference as reason:
        if "several" in str(reason):
            raise
        return
    legs = [(p, q) for p, q in zip(corners, corners[1:], strict=False)]
    if any(blocked(bench, p, q, faces) for p, q in legs):
        return
    for f in bench.rng.permutation(np.linspace(0.05, 0.95, 19)):
        for p, q in legs:
            centre = p + f * (q - p)
            screen = (centre, frame_along(q - p), (room, room), None)
            if not any(crosses(a, b, screen) for a, b in bench.path if np.linalg.norm(b - a) > 0):
                bench.baffle(centre, q - p, room)
                return
    raise NoReference("no room for a baffle across a ray")


def shade(bench, targets, room):
    """Shields places from the source's direct light where nothing else does."""
    if not all(blocked(bench, bench.source, t) for t in targets):
        _shield(bench, targets, room)
        if not all(blocked(bench, bench.source, t) for t in targets):
            raise NoReference("direct light")


def _image_ray(source, faces, place):
    """Corners of the ray over plane mirrors from a source to a place, by images. NoReference: there is none."""
    images = [source]
    for face in faces:
        n = face.axes[:, 2]
        images.append(images[-1] - 2 * ((images[-1] - face.vertex) @ n) * n)
    corners, at = [place], place
    for face, image in zip(faces[::-1], images[:0:-1], strict=True):
        local, seen = (at - face.vertex) @ face.axes, (image - face.vertex) @ face.axes
        if local[2] * seen[2] >= 0:
            raise NoReference("no ray over these mirrors")
        hit = local + local[2] / (local[2] - seen[2]) * (seen - local)
        if np.max(np.abs(hit[:2])) > face.reach:
            raise NoReference("the ray misses a mirror")
        at = face.vertex + face.axes @ [*hit[:2], 0.0]
        corners.append(at)
    return [source, *corners[:0:-1], place] if faces else [source, place]


def _corners(source, faces, place):
    if all(face.curvature == 0 for face in faces):
        return _image_ray(source, faces, place)
    goal = Face(place, frame_along(place - source))
    d = chief(source, faces, goal)
    return [source, *(h[1][0] for h in trace(source[None], d[None], [*faces, goal])[3])]


def _sequences(mirrors):
    """Orders in which light can meet one or two mirrors, up to four times (a curved one: once)."""
    if len(mirrors) < 2:
        return [mirrors]
    one = mirrors[0]
    return [[*mirrors, *mirrors, one][i : i + n] for i in range(2) for n in range(1, 5)]


def refuse_other_ways(bench, mirrors, wanted, places):
    """NoReference where a sequence of mirror faces other than the ``wanted`` lights one of the places."""
    for faces in _sequences(mirrors):
        if len(faces) == len(wanted) and all(a is b for a, b in zip(faces, wanted, strict=True)):
            continue
        wide = [replace(f, reach=f.reach / CLEAR * 1.1) for f in faces]
        for place in places:
            try:
                corners = _corners(bench.source, wide, place)
            except NoReference as reason:
                if "several" in str(reason):
                    raise
                continue
            if not any(blocked(bench, p, q) for p, q in zip(corners, corners[1:], strict=False)):
                raise NoReference("another way")
