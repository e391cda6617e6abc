"""How the material of a target was described, as plain values that travel to another process."""

from __future__ import annotations

from pathlib import Path

TARGET = "rough_target"


class _NotPlain(Exception):
    """Holds an object, a transform or another value that is not plain."""


def bsdf_recipe(state, identity: str) -> dict | None:
    """The BSDF of a rough target as nested dictionaries that ``mi.load_dict`` takes, of strings, numbers and lists.

    state: the parsed scene (``mi.parser.ParserState``), whose references are resolved here; identity: the target's, of
    use where a scene has several. None where the target has no BSDF of its own, or one that is more than plain values
    (a texture with a transform, an object made beforehand).
    """
    import mitsuba as mi

    config = mi.parser.ParserConfig(mi.variant())
    try:
        mi.parser.transform_upgrade(config, state)
        mi.parser.transform_resolve(config, state)
    except RuntimeError:
        return None
    targets = [node for node in state.nodes if node.props.plugin_name() == TARGET]
    if len(targets) > 1:
        targets = [node for node in targets if node.props.id() == identity]
    if len(targets) != 1:
        return None
    children = [value for _, value in targets[0].props.items()]
    materials = [child for child in children if _type_of(state, child) == mi.ObjectType.BSDF]
    if len(materials) != 1:
        return None
    try:
        return _plugin(state, materials[0].index())
    except _NotPlain:
        return None


def _type_of(state, child):
    """What kind of object a property of a parsed scene is; None where it is a value."""
    import mitsuba as mi

    if isinstance(child, mi.Properties.ResolvedReference):
        return state.nodes[child.index()].type
    return mi.ObjectType.BSDF if isinstance(child, mi.BSDF) else None


def _plugin(state, index: int) -> dict:
    node = state.nodes[index]
    recipe: dict = {"type": node.props.plugin_name()}
    for name, value in node.props.items():
        # Children without a name are called _arg_0, which only the parser may.
        recipe[name.lstrip("_")] = _file(state, node, value) if name == "filename" else _plain(state, value)
    return recipe


def _plain(state, value):
    import mitsuba as mi

    if isinstance(value, mi.Properties.ResolvedReference):
        return _plugin(state, value.index())
    if isinstance(value, mi.ScalarColor3d):
        return {"type": "rgb", "value": [float(component) for component in value]}
    if hasattr(value, "wavelengths"):  # a spectrum, of a type that Mitsuba gives no name
        if value.is_uniform():
            return {"type": "spectrum", "value": float(value.values[0])}
        pairs = zip(value.wavelengths, value.values, strict=True)
        return {"type": "spectrum", "value": [[float(wavelength), float(v)] for wavelength, v in pairs]}
    if isinstance(value, (bool, int, float, str)):
        return value
    raise _NotPlain


def _file(state, node, value) -> str:
    """A file that the scene names relative to itself, so that another process finds it."""
    import mitsuba as mi

    if not isinstance(value, str):
        raise _NotPlain
    folders = [Path(str(state.files[node.file_index])).parent] if state.files else []
    beside = next((folder / value for folder in folders if (folder / value).is_file()), None)
    path = (beside or Path(str(mi.file_resolver().resolve(value)))).absolute()
    if not path.is_file():
        raise _NotPlain
    return str(path)
