"""rapl_core knows nothing of ROS, and imports between its rooms run downwards only."""

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import rapl_core

PACKAGE = Path(rapl_core.__file__).parent
ROOT = PACKAGE.parents[1]
ROS = {"rclpy", "rapl_msgs", "rapl_ros", "sensor_msgs", "std_msgs", "diagnostic_msgs", "launch"}

# docs/architecture.md; rooms of equal level may import each other.
LEVELS = {
    "types": 0, "errors": 0, "atomic": 0,
    "tasks": 1, "simulation": 1, "episodes": 1,
    "demonstrators": 2, "environments": 2,
    "transport": 3, "representations": 3, "preferences": 3, "streaming": 3,
    "policies": 4, "analysis": 4,
    "cli": 5,
}  # fmt: skip


def imports(source: str) -> Iterator[str]:
    """Yield the dotted name of every module that ``source`` imports, wherever in the file."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            yield from (
                [module]
                if module != "rapl_core"
                else [f"rapl_core.{alias.name}" for alias in node.names]
            )


def upward_imports(room: str, source: str) -> list[str]:
    """Return the imports of ``source`` that lead to a room above its own."""
    rooms = {name.split(".")[1] for name in imports(source) if name.startswith("rapl_core.")}
    return sorted(other for other in rooms if LEVELS.get(other, 0) > LEVELS[room])


def modules() -> list[Path]:
    return sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def test_every_room_has_a_level() -> None:
    assert {room_of(path) for path in modules()} <= set(LEVELS)


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_run_downwards(path: Path) -> None:
    source = path.read_text()
    assert not [name for name in imports(source) if name.partition(".")[0] in ROS]
    assert upward_imports(room_of(path), source) == []


def test_an_upward_import_is_noticed() -> None:
    assert upward_imports("tasks", "from rapl_core.policies.config import SacConfig") == [
        "policies"
    ]
    assert upward_imports("tasks", "from rapl_core import analysis") == ["analysis"]
    assert upward_imports("tasks", "def f():\n    import rapl_core.policies.x") == ["policies"]
    assert upward_imports("policies", "from rapl_core.tasks import get_task") == []


@pytest.mark.parametrize(
    "path",
    sorted((ROOT / "tests" / "core").rglob("*.py")),
    ids=lambda path: str(path.relative_to(ROOT / "tests")),
)
def test_the_tests_of_the_core_import_no_ros(path: Path) -> None:
    assert not [name for name in imports(path.read_text()) if name.partition(".")[0] in ROS]


@pytest.mark.timeout(300)
def test_every_module_of_the_core_imports_where_ros_is_missing() -> None:
    program = f"""
import importlib, pkgutil, sys
for name in {sorted(ROS)!r}:
    sys.modules[name] = None  # an import of it raises ModuleNotFoundError
import rapl_core
for module in pkgutil.walk_packages(rapl_core.__path__, "rapl_core."):
    importlib.import_module(module.name)
print("imported", sum(name.startswith("rapl_core.") for name in sys.modules))
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=os.environ, cwd="/"
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) >= len({room_of(path) for path in modules()})


def test_no_module_names_a_package_of_the_ros_side() -> None:
    """What is on disk is defined by files; their places tell what types are called."""
    named = [p.name for p in modules() if re.search(r"\brapl_(msgs|bringup)\b", p.read_text())]
    assert not named
