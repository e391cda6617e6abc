"""What may import what: read from the sources, so that the structure is held by a test and not by memory."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE, PLUGINS = ROOT / "speckle_mi", ROOT / "plugins"
RENDERER = {"mitsuba", "drjit"}
COMMANDS = {"cli", "render", "sweep", "report", "sysinfo", "converge", "benchmark", "stability"}
THIN = 230  # Lines of a plugin: documentation, parameters and registration, no physics.


def sources() -> dict[str, Path]:
    """Module names, as imported, of everything that is installed."""
    found = {}
    for folder, prefix in ((PACKAGE, "speckle_mi"), (PLUGINS, "speckle_mi.plugins")):
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            name = ".".join([prefix, *(part for part in parts if part != "__init__")])
            found[name] = path
    return found


SOURCES = sources()


def imports(module: str, at_import: bool = True) -> set[str]:
    """Absolute names that a module imports: when it is imported, or anywhere in it."""
    path = SOURCES[module]
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    found: set[str] = set()

    def visit(node: ast.AST) -> None:
        if at_import and isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            return
        if at_import and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                anchor = package.rsplit(".", node.level - 1)[0] if node.level > 1 else package
                base = f"{anchor}.{base}".rstrip(".")
            found.add(base)
            found.update(f"{base}.{alias.name}" for alias in node.names)
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(path.read_text(encoding="utf-8")))
    return found


def reached(module: str) -> set[str]:
    """Everything that importing a module imports, through local modules and their packages."""
    done: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in done:
            continue
        done.add(name)
        parents = [name.rsplit(".", n)[0] for n in range(1, name.count(".") + 1)]
        waiting += [parent for parent in parents if parent in SOURCES]
        if name in SOURCES:
            waiting += imports(name)
    return done


def top_level(names: set[str]) -> set[str]:
    return {name.partition(".")[0] for name in names}


CORRELATION = ("correlate", "correlator", "correlation_peak", "ncc")
PURE = ("theory", "statistics", "sensitivity", "geometry", "hashing", *CORRELATION)


@pytest.mark.parametrize("name", (*PURE, "exr", "cli", "plots", "sweep", "render"))
def test_post_processing_imports_no_renderer(name):
    assert not RENDERER & top_level(reached(f"speckle_mi.{name}"))


@pytest.mark.parametrize("name", PURE)
def test_post_processing_uses_no_renderer_in_any_function(name):
    assert not RENDERER & top_level(imports(f"speckle_mi.{name}", at_import=False))


@pytest.mark.parametrize(
    "module", sorted(n for n in SOURCES if n.startswith(("speckle_mi.optics", "speckle_mi.propagation")))
)
def test_propagation_and_optics_know_neither_scenes_nor_plugins_nor_commands(module):
    local = {name for name in imports(module, at_import=False) if name.startswith("speckle_mi")}
    forbidden = {
        f"speckle_mi.{name}" for name in (*COMMANDS, "plugins", "assembly", "simulate", "parameters", "placement")
    }
    assert not {name for name in local if any(name == f or name.startswith(f + ".") for f in forbidden)}


@pytest.mark.parametrize("module", sorted(n for n in SOURCES if n.rpartition(".")[2] not in COMMANDS))
def test_nothing_but_commands_imports_a_command(module):
    commands = {f"speckle_mi.{name}" for name in ("render", "sweep", "converge", "benchmark", "stability")}
    own_package = module.rpartition(".")[0]
    assert not (commands - {own_package}) & imports(module, at_import=False)


@pytest.mark.parametrize("module", sorted(n for n in SOURCES if not n.startswith("speckle_mi.plugins")))
def test_only_the_registration_imports_plugins(module):
    found = {name for name in imports(module, at_import=False) if name.startswith("speckle_mi.plugins")}
    assert not found or module == "speckle_mi.registration"


@pytest.mark.parametrize("path", sorted(PLUGINS.glob("[!_]*.py")), ids=lambda path: path.stem)
def test_plugins_are_thin(path):
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    assert len(text.splitlines()) <= THIN
    assert ".. pluginparameters::" in ast.get_docstring(tree)
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    assert len(classes) == 1, "one plugin a file"
    methods = [node.name for node in classes[0].body if isinstance(node, ast.FunctionDef)]
    assert methods[0] == "__init__" and "to_string" in methods
    last = tree.body[-1]
    assert isinstance(last, ast.Expr) and ast.unparse(last).startswith("mi.register_"), "registration comes last"
    assert {"numpy.fft", "scipy"}.isdisjoint(imports(f"speckle_mi.plugins.{path.stem}"))


@pytest.mark.parametrize("module", sorted(SOURCES))
def test_no_module_imports_tests_or_reads_machine_paths(module):
    text = SOURCES[module].read_text(encoding="utf-8")
    assert "tests" not in top_level(imports(module, at_import=False))
    assert not [folder for folder in ("work", "root", "tmp") if f"/{folder}/" in text]
