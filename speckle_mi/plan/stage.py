"""One step of what is done for a scene, as data; words are made of it where it is read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..propagation.coherent_sum import How

FREE_SPACE = "free space"
WAY = "way"
UNFOLDED = "unfolded"
TRACED = "traced"
DIFFRACTED = "diffracted"
NOT_DIFFRACTED = "not diffracted"
CLEAR = "clear"
SHADOWS = "geometric shadows"
LEFT_OUT = "left out"
RELAYED = "relayed"
BESIDE_WINDOW = "beside a window"
HIDDEN = "hidden"
CUT = "cut"
OTHER_WAY = "other way"
NO_WAY = "no way"
BESIDE = "beside the detector"
SUM = "sum"
RAYS = "rays"
PIXELS = "pixels"
NOTHING_SUMMED = "nothing summed"
INCOHERENT = "incoherent"
LIGHT = "light"


@dataclass(frozen=True)
class Stage:
    """A step of a plan, or what a frame did for it.

    kind: one of the constants above; elements: ids of the shapes it is about, in order, or where a sum ends; way: the
    way it belongs to; reason: why, where there is something to say; how: of a sum, what was chosen; nodes: on the
    opening where a sum ends; count: rays a source, or side of the square of sub-pixels; rays: traced in all; share: of
    the pixels (in shadow, or reached); predicted_error: of the field, known beforehand; error: measured, both relative
    L2; seconds: it took.
    """

    kind: str
    elements: tuple[str, ...] = ()
    way: str = ""
    reason: str = ""
    how: How | None = None
    nodes: int | None = None
    count: int | None = None
    rays: int | None = None
    share: float | None = None
    predicted_error: float | None = None
    error: float | None = None
    seconds: float | None = None

    def __str__(self) -> str:
        return in_words(self)

    def to_json(self) -> dict:
        """What there is to say, as JSON can hold it."""
        content = vars(self) | {"how": vars(self.how) if self.how else None}
        said = {name: value for name, value in content.items() if value is not None and not _is_empty(value)}
        return {name: _plain(value) for name, value in said.items()}

    @classmethod
    def from_json(cls, content: dict) -> Stage:
        """The stage that ``to_json`` has written."""
        how = content.get("how")
        if how is not None:
            missed = tuple((kind, error) for kind, error in how["missed"])
            lists = {name: tuple(value) for name, value in how.items() if isinstance(value, (list, tuple))}
            how = How(**how | lists | {"missed": missed})
        return cls(**content | {"how": how, "elements": tuple(content.get("elements", ()))})


def _is_empty(value: object) -> bool:
    return isinstance(value, (str, tuple)) and not value


def _plain(value: object) -> object:
    """Python's numbers, and lists instead of tuples, so that what was written is equal to what is read again."""
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return value.item() if isinstance(value, np.generic) else value


def in_words(stage: Stage) -> str:
    """A stage in one line."""
    named = ", ".join(stage.elements)
    quoted = " or ".join(map(repr, stage.elements))
    match stage.kind:
        case "free space":
            return f"free space: {stage.reason}"
        case "way":
            return f"way: {stage.way}"
        case "unfolded":
            return f"unfolded: plane mirror {named}"
        case "traced":
            return f"traced: path length and amplitude through {named}"
        case "diffracted":
            return f"diffracted at {named}" + (f" ({stage.reason})" if stage.reason else "")
        case "not diffracted":
            return f"diffracts nothing: {stage.reason}"
        case "clear":
            return f"left out: {stage.reason}"
        case "geometric shadows":
            return f"openings cast geometric shadows, {stage.reason}"
        case "left out":
            return (
                f"left out: the wave of the edge of {quoted}, which stands beside the light "
                f"(at most {stage.predicted_error:.1%} of the field)"
            )
        case "relayed":
            return f"relayed: summed on a window at {named} first, as an image of an opening lies near the detector"
        case "beside a window":
            return f"left out: light that passes the window at {named} by (about {stage.error:.1e} of the field)"
        case "hidden":
            return (
                f"left out: what rims and shapes do to light behind {quoted}; {stage.share:.2%} of it falls where they "
                f"hide a part of {quoted} (at most {stage.error:.1e} of the field)"
            )
        case "cut":
            return (
                f"{quoted} cuts a part of the light: geometric shadow; "
                f"left out: the wave of its edge (about {stage.predicted_error:.1%} of the field)"
            )
        case "other way":
            return f"left out: {stage.way} (about {stage.predicted_error:.1e} of the field)"
        case "no way":
            return f"no way: no light reaches the detector, {stage.reason}"
        case "beside the detector":
            return "the geometric light passes beside the detector: only diffracted light can reach it"
        case "sum":
            nodes = f", {stage.nodes} nodes" if stage.nodes is not None else ""
            shadow = "" if stage.share is None else f"; {stage.share:.1%} of the pixels in full or partial shadow"
            return f"sum to {named}{nodes}: {stage.how}{shadow}"
        case "light":
            if stage.nodes is not None:
                return f"light over {stage.way}: summed from {stage.nodes} nodes across the beam"
            if stage.reason:
                return (
                    f"light over {stage.way}: a Gaussian beam {stage.reason}, exactly traced "
                    f"(aberrations are left out: about {stage.error:.1e} of the field)"
                )
            return f"light over {stage.way}: as it leaves the laser"
        case "incoherent":
            return f"intensities add up: {named}, {stage.count} wavelengths or lasers in all"
        case "rays":
            return f"rays: {stage.count} a source, {stage.rays} in all, reach {stage.share:.1%} of the pixels"
        case "pixels":
            return f"pixels: intensity averaged over {stage.count} x {stage.count} sub-pixels"
        case "nothing summed":
            return "nothing is summed: no light reaches the detector"
    raise ValueError(f"stage {stage.kind!r}: unknown")
