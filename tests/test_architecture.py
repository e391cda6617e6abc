"""What may import what: read from the sources, so that the structure is held by a test and not by memory."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE, PLUGINS = ROOT / "speckle_mi", ROOT / "plugins"
RENDERER = {"mitsuba", "drjit"}
LEVELS = (
    {"version", "errors"},
    {"geometry", "machine"},
    {"images", "measurement", "optics", "propagation", "scattering", "theory"},
    {"scene"},
    {"plan"},
    {"field"},
    {"experiments", "plugins"},
    {"studies"},
    {"report"},
    {"validation"},
    {"command_line"},
)
"""Rooms in the order in which data flows; a room imports from those of earlier levels and from itself."""
COMMANDS = {"render", "sweep", "sensitivity", "pose", "correlate", "converge", "stability", "benchmark", "sysinfo", "scenes",
            "preview", "view", "uncertainty", "compare", "optimise", "sequence", "document", "__main__"}  # fmt: skip
THIN = 230  # Lines of a plugin: documentation, parameters and registration, no physics.
LONGEST = 400  # Lines of a file that can still be seen whole.


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


def local_imports(module: str) -> set[str]:
    """Modules of this package that a module imports anywhere in it, functions included."""
    names = imports(module, at_import=False)
    found = {name for name in names if name in SOURCES}
    # A package counts only where something is taken from itself and not from a file in it.
    return {name for name in found - {module} if SOURCES[name].name != "__init__.py" or takes_from(module, name)}


def takes_from(module: str, package: str) -> bool:
    taken = {name for name in imports(module, at_import=False) if name.rpartition(".")[0] == package}
    return any(name not in SOURCES for name in taken)


def room(module: str) -> str:
    """The room that a module lies in, or its own name where it lies beside them."""
    return module.split(".")[1] if "." in module else ""


def level(module: str) -> int:
    return next((number for number, rooms in enumerate(LEVELS) if room(module) in rooms), len(LEVELS))


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


INNER = sorted(module for module in SOURCES if module != "speckle_mi")


@pytest.mark.parametrize("module", INNER)
def test_every_file_lies_in_a_room_or_is_a_command(module):
    assert level(module) < len(LEVELS) or module.removeprefix("speckle_mi.") in COMMANDS


@pytest.mark.parametrize("module", INNER)
def test_imports_go_downward_only(module):
    for name in local_imports(module) - {"speckle_mi"}:
        assert room(name) == room(module) or level(name) < level(module), f"{module} imports {name}"


def test_there_is_no_cycle_of_files():
    graph = {module: local_imports(module) for module in INNER}
    while ends := [module for module, needed in graph.items() if not needed & graph.keys()]:
        for module in ends:
            del graph[module]
    assert not graph, f"files that import one another: {', '.join(sorted(graph))}"


@pytest.mark.parametrize("module", INNER)
def test_nothing_but_commands_imports_a_command(module):
    commands = {f"speckle_mi.{name}" for name in COMMANDS}
    assert not commands & local_imports(module) - {module}


PURE = sorted(n for n in SOURCES if room(n) in ("measurement", "theory", "geometry") or n.endswith(".hashing"))


@pytest.mark.parametrize(
    "name",
    (*PURE, "speckle_mi.images.exr", "speckle_mi.images.pictures", "speckle_mi.command_line", "speckle_mi.report.plots",
     "speckle_mi.sweep", "speckle_mi.sensitivity", "speckle_mi.pose", "speckle_mi.render", "speckle_mi.correlate"),
)  # fmt: skip
def test_post_processing_imports_no_renderer(name):
    assert not RENDERER & top_level(reached(name))


@pytest.mark.parametrize("name", PURE)
def test_post_processing_uses_no_renderer_in_any_function(name):
    assert not RENDERER & top_level(imports(name, at_import=False))


@pytest.mark.parametrize("module", sorted(n for n in SOURCES if room(n) != "plugins"))
def test_only_the_package_itself_imports_plugins(module):
    found = {name for name in imports(module, at_import=False) if name.startswith("speckle_mi.plugins")}
    assert not found or module == "speckle_mi"


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
def test_files_are_short_and_say_what_they_are(module):
    text = SOURCES[module].read_text(encoding="utf-8")
    assert len(text.splitlines()) <= LONGEST
    assert ast.get_docstring(ast.parse(text))


def test_every_room_is_installed():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = {name.rpartition(".")[0] or name for name in SOURCES if SOURCES[name].name != "__init__.py"}
    assert packages <= set(project["tool"]["setuptools"]["packages"])


@pytest.mark.parametrize("module", sorted(SOURCES))
def test_no_module_imports_tests_or_reads_machine_paths(module):
    text = SOURCES[module].read_text(encoding="utf-8")
    assert "tests" not in top_level(imports(module, at_import=False))
    assert not [folder for folder in ("work", "root", "tmp") if f"/{folder}/" in text]


def test_every_public_class_has_a_name_of_its_own():
    found: dict[str, list[str]] = {}
    for module, path in SOURCES.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found.setdefault(node.name, []).append(module)
    assert not {name: modules for name, modules in found.items() if len(modules) > 1}


@pytest.mark.parametrize("module", sorted(SOURCES))
def test_what_is_private_to_a_file_stays_in_it(module):
    text = ast.parse(SOURCES[module].read_text(encoding="utf-8"))
    taken = {
        alias.name
        for node in ast.walk(text)
        if isinstance(node, ast.ImportFrom) and node.level
        for alias in node.names
        if alias.name.startswith("_") and not alias.name.startswith("__")
    }
    # The plugins' shared modules are private to Mitsuba's search path, not to a file.
    assert not {name for name in taken if f"{module.rpartition('.')[0]}.{name}" not in SOURCES}


PROCESS_WIDE = {"speckle_mi.machine.cores"}
"""Modules that know something of the process, which no scene changes."""


@pytest.mark.parametrize("module", sorted(SOURCES.keys() - PROCESS_WIDE))
def test_no_module_remembers_results(module):
    names = {name.rpartition(".")[2] for name in imports(module, at_import=False) if name.startswith("functools.")}
    assert not names & {"lru_cache", "cache"}
