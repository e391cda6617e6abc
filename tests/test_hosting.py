"""Any program can host the package: importing it changes nothing but what Mitsuba and Dr.Jit need to work with it."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from conftest import SCENES

from speckle_mi.machine import llvm

SCENE = str(SCENES / "tilted_laser.xml")


def said_by(script: str, folder, **environment: str) -> str:
    """What a fresh Python prints; a user's choice of LLVM is not passed on."""
    ours = ("DRJIT_LIBLLVM_PATH", "OMP_WAIT_POLICY")
    kept = {name: value for name, value in os.environ.items() if name not in ours}
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=folder, env=kept | environment, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def state_of_process() -> str:
    """Source of a function that tells what a library could have changed."""
    return """
import os, signal, sys, threading
def state():
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    wakeup = signal.set_wakeup_fd(-1); signal.set_wakeup_fd(wakeup)
    return (dict(os.environ), [signal.getsignal(n) for n in numbers], wakeup, threading.enumerate(), os.getcwd())
before = state()
"""


@pytest.mark.parametrize(
    "use",
    [
        "import speckle_mi",
        "import speckle_mi, mitsuba",
        "import mitsuba, speckle_mi; mitsuba.set_variant('llvm_ad_mono')",
        "import speckle_mi.propagation.lowrank, speckle_mi.command_line, speckle_mi.render, speckle_mi.sweep",
        # As when a command's own process starts, up to where the command begins.
        "sys.argv[0], sys.orig_argv = '-m', ['python', '-m', 'speckle_mi.render']; import speckle_mi.render",
    ],
)
def test_an_import_leaves_environment_signals_threads_and_folder_alone(use, tmp_path):
    assert said_by(f"{state_of_process()}{use}\nprint(state() == before)", tmp_path) == "True"


def test_a_users_choices_in_the_environment_are_kept(tmp_path):
    script = (
        "import os, speckle_mi, speckle_mi.machine.nufft\n"
        "print(os.environ['DRJIT_LIBLLVM_PATH'], os.environ['OMP_WAIT_POLICY'])"
    )
    own = str(llvm.packaged_library() or "/somewhere/libLLVM.so")
    assert said_by(script, tmp_path, DRJIT_LIBLLVM_PATH=own, OMP_WAIT_POLICY="ACTIVE") == f"{own} ACTIVE"


def test_finuffts_threads_sleep_while_they_wait(tmp_path):
    """OpenMP tells how it was set up on stderr, when it is loaded."""
    script = "import os, speckle_mi.propagation.lowrank, finufft; print('OMP_WAIT_POLICY' in os.environ)"
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=os.environ | {"OMP_DISPLAY_ENV": "true"},
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.stdout.strip() == "False"
    assert "OMP_WAIT_POLICY = 'PASSIVE'" in done.stderr


# LLVM

NEEDS_PACKAGED = pytest.mark.skipif(llvm.packaged_library() is None, reason="no packaged LLVM here")
PRINTS_LLVM = "import drjit as dr; print(dr.detail.llvm_version()[0])"


def used_without_us(tmp_path) -> int:
    """Major version of the LLVM that Dr.Jit finds by itself; 0 where it finds none."""
    script = "import drjit as dr\ntry: print(dr.detail.llvm_version()[0])\nexcept Exception: print(0)"
    return int(said_by(script, tmp_path))


@NEEDS_PACKAGED
@pytest.mark.parametrize("start", ["import speckle_mi", "import mitsuba, speckle_mi", "import drjit, speckle_mi",
                                   "import importlib.util, speckle_mi; importlib.util.find_spec('drjit')"])  # fmt: skip
def test_the_packaged_llvm_is_found_whatever_is_imported_first(start, tmp_path):
    assert int(said_by(f"{start}\n{PRINTS_LLVM}", tmp_path)) >= llvm.OLDEST_LLVM


@NEEDS_PACKAGED
def test_a_dr_jit_in_use_is_left_alone(tmp_path):
    """Its back ends are started anew only where nothing lives in them; a host's arrays and kernels do."""
    if not 0 < used_without_us(tmp_path) < llvm.OLDEST_LLVM:
        pytest.skip("Dr.Jit finds no LLVM that is too old here")
    for holds in ("held = dr.llvm.Float([1, 2, 3])", "dr.llvm.Float([1, 2, 3])\nheld = dr.llvm.Float([1, 2]) + 1"):
        host = f"import drjit as dr\n{holds}\nbefore = dr.detail.llvm_version(), dr.whos(as_string=True)\n"
        after = "import speckle_mi\nprint((dr.detail.llvm_version(), dr.whos(as_string=True)) == before)\n"
        assert said_by(host + after, tmp_path) == "True"
    used = "import drjit as dr\ntry: dr.eval(dr.llvm.Float([1, 2]) + 1)\nfinally: pass\nimport speckle_mi\n"
    assert said_by(f"{used}from speckle_mi.machine import llvm; print(llvm.is_unused())", tmp_path) == "False"


@NEEDS_PACKAGED
def test_a_host_that_uses_too_old_an_llvm_is_told_what_to_do(tmp_path):
    if not 0 < used_without_us(tmp_path) < llvm.OLDEST_LLVM:
        pytest.skip("Dr.Jit finds no LLVM that is too old here")
    script = (
        "import drjit as dr\nheld = dr.llvm.Float([1, 2, 3])\nimport mitsuba as mi, speckle_mi\n"
        "mi.set_variant('llvm_ad_mono')\n"
        f"try: mi.load_file({SCENE!r})\nexcept RuntimeError as error: print(error)\n"
    )
    assert "import speckle_mi before" in said_by(script, tmp_path)


# The import of Mitsuba

RENDERS = "mi.set_variant('llvm_ad_mono'); mi.set_log_level(mi.LogLevel.Error); "
RENDERS += f"print(type(mi.load_file({SCENE!r}).integrator()).__name__)"


@pytest.mark.parametrize(
    "before",
    [
        "importlib.util.find_spec('mitsuba')",
        "[importlib.util.find_spec(name) for name in ('mitsuba', 'drjit', 'mitsuba')]",
        "sys.modules['drjit'] = None; tries(); del sys.modules['drjit']",
        "threads = [threading.Thread(target=importlib.import_module, args=['mitsuba']) for _ in range(8)]\n"
        "[t.start() for t in threads]; [t.join() for t in threads]",
    ],
    ids=["looked for", "looked for again and again", "failed to import", "imported by threads"],
)
def test_plugins_are_known_however_mitsuba_was_looked_for(before, tmp_path):
    script = (
        "import importlib, importlib.util, sys, threading, speckle_mi\n"
        "def tries():\n"
        "    try: import mitsuba\n"
        "    except ImportError: pass\n"
        f"{before}\nimport mitsuba as mi\n{RENDERS}\n"
    )
    assert said_by(script, tmp_path) == "Coherent"


def test_another_package_that_waits_for_mitsuba_finds_it_as_well(tmp_path):
    """One that asks all finders anew, as import hooks do, before and after us."""
    hook = """
import importlib.util, sys
class Hook:
    asking = False
    def find_spec(self, name, path=None, target=None):
        if name != "mitsuba" or self.asking: return None
        self.asking = True
        try: return importlib.util.find_spec(name)
        finally: self.asking = False
"""
    insert = "sys.meta_path.insert(0, Hook())"
    for order in (f"{insert}; import speckle_mi", f"import speckle_mi; {insert}"):
        assert said_by(f"{hook}\n{order}\nimport mitsuba as mi\n{RENDERS}", tmp_path) == "Coherent"


def test_the_context_of_an_import_is_entered_once_and_left_by_an_error_as_well(tmp_path, monkeypatch):
    import contextlib
    import importlib

    from speckle_mi.machine.around_import import around_import

    entered, left = [], []

    @contextlib.contextmanager
    def around():
        entered.append(1)
        try:
            yield
        finally:
            left.append(1)

    (tmp_path / "of_a_host.py").write_text("import os\nif not os.path.exists('good'): raise ImportError('not yet')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    around_import("of_a_host", around)
    with pytest.raises(ImportError, match="not yet"):
        importlib.import_module("of_a_host")
    (tmp_path / "good").touch()
    importlib.reload(importlib.import_module("of_a_host"))
    assert len(entered) == len(left) == 2


# Scenes of a host

STOCK = '<scene version="3.0.0">{}<integrator type="path"/><shape type="sphere"/></scene>'
TARGET = '<shape type="rough_target" id="target"/>'


@pytest.fixture
def parsed(mitsuba, monkeypatch) -> list[str]:
    """Names of the parsers that were called."""
    calls: list[str] = []
    for name in ("parse_file", "parse_string", "parse_dict"):
        parse = getattr(mitsuba.parser, name)

        def counted(*arguments, name=name, parse=parse, **parameters):
            calls.append(name)
            return parse(*arguments, **parameters)

        monkeypatch.setattr(mitsuba.parser, name, counted)
    return calls


def test_a_scene_without_our_plugins_is_loaded_by_mitsuba_alone(mitsuba, parsed, tmp_path):
    (tmp_path / "part.xml").write_text(STOCK.format(""))
    (tmp_path / "whole.xml").write_text('<scene version="3.0.0"><include filename="part.xml"/></scene>')
    mitsuba.load_file(str(tmp_path / "whole.xml"))
    mitsuba.load_string(STOCK.format(f"<!-- --flag: {TARGET} would stand here -->"))
    mitsuba.load_string(STOCK.format('<default name="kind" value="cube"/><shape type="$kind"/>'), kind="disk")
    mitsuba.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": {"type": "diffuse"}}})
    assert parsed == []


def test_a_target_is_seen_in_every_way_to_name_it(mitsuba, parsed, tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "target.xml").write_text(f'<scene version="3.0.0">{TARGET}</scene>')
    (tmp_path / "include.xml").write_text('<scene version="3.0.0"><include filename="parts/target.xml"/></scene>')
    (tmp_path / "path.xml").write_text(
        '<scene version="3.0.0"><path value="parts"/><include filename="target.xml"/></scene>'
    )
    by_default = STOCK.format('<default name="k" value="rough"/><default name="kind" value="$k_target"/>')
    ways = [
        lambda: mitsuba.load_file(str(tmp_path / "include.xml")),
        lambda: mitsuba.load_file(str(tmp_path / "path.xml")),
        lambda: mitsuba.load_string(STOCK.format(TARGET)),
        lambda: mitsuba.load_string(by_default.replace("sphere", "$kind")),
        lambda: mitsuba.load_string(STOCK.format('<shape type="$kind"/>'), kind="rough_target"),
        lambda: mitsuba.load_string(STOCK.format(TARGET.replace("rough_", "rough&#95;"))),
        lambda: mitsuba.load_dict({"type": "scene", "group": {"type": "rough_target"}}),
    ]
    for number, way in enumerate(ways, start=1):
        loaded = way()
        assert any(type(shape).__name__ == "RoughTarget" for shape in loaded.shapes()), number
        assert len(parsed) == number


MATERIALS = {
    "a metal": '<bsdf type="roughconductor"><string name="material" value="Al"/>'
    '<float name="alpha" value="0.3"/></bsdf>',
    "by reference": '<ref id="of scene"/>',
    "nested": '<bsdf type="twosided"><bsdf type="diffuse">'
    '<rgb name="reflectance" value="0.3, 0.4, 0.5"/></bsdf></bsdf>',
    "a blend": '<bsdf type="blendbsdf"><float name="weight" value="0.25"/><ref id="of scene"/>'
    '<bsdf type="diffuse"/></bsdf>',
    "a spectrum": '<bsdf type="diffuse"><spectrum name="reflectance" value="400:0.3, 700:0.5"/></bsdf>',
    "a texture": '<bsdf type="diffuse"><texture type="checkerboard" name="reflectance">'
    '<float name="color0" value="0.1"/></texture></bsdf>',
}
NOT_PLAIN = {
    "none": "",
    "a placed texture": '<bsdf type="diffuse"><texture type="checkerboard" name="reflectance">'
    '<transform name="to_uv"><scale value="4"/></transform></texture></bsdf>',
}


def target_of(mitsuba, material: str):
    of_scene = '<bsdf type="roughconductor" id="of scene"><float name="alpha" value="0.2"/></bsdf>'
    target = f'<shape type="rough_target">{material}</shape>'
    (loaded,) = mitsuba.load_string(f'<scene version="3.0.0">{of_scene}{target}</scene>').shapes()
    return loaded


@pytest.mark.parametrize("material", MATERIALS)
def test_a_targets_material_is_made_again_from_its_recipe(mitsuba, material):
    import json

    import numpy as np

    target = target_of(mitsuba, MATERIALS[material])
    made = mitsuba.load_dict(json.loads(json.dumps(target.bsdf_recipe)))
    random = np.random.default_rng(5)
    interaction = mitsuba.SurfaceInteraction3f()
    interaction.uv = mitsuba.Point2f(random.random((2, 50)))
    interaction.wi = mitsuba.warp.square_to_uniform_hemisphere(mitsuba.Point2f(random.random((2, 50))))
    out = mitsuba.warp.square_to_uniform_hemisphere(mitsuba.Point2f(random.random((2, 50))))
    values = [np.array(bsdf.eval(mitsuba.BSDFContext(), interaction, out)) for bsdf in (target.bsdf(), made)]
    assert values[0].max() > 0
    np.testing.assert_array_equal(*values)


@pytest.mark.parametrize("material", NOT_PLAIN)
def test_a_material_that_is_more_than_plain_values_has_no_recipe(mitsuba, material):
    assert target_of(mitsuba, NOT_PLAIN[material]).bsdf_recipe is None
