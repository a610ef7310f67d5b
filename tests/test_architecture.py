"""Imports run down the floors of docs/architecture.md, and no files import each other in a circle."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from floors import FLOORS

import gridslam
from gridslam.systems.registry import METHODS, method_class

PACKAGE = Path(gridslam.__file__).parent
FLOOR = {room: number for number, floor in enumerate(FLOORS) for room in floor.split()}
FILE_FORMATS = (
    "h5py", "matplotlib", "tomli_w", "tomllib", "gridslam.io", "gridslam.importers",
    "gridslam.maps.map_files", "gridslam.measurements.csv_table", "gridslam.measurements.hdf5_table",
    "gridslam.measurements.matlab", "gridslam.measurements.network_files", "gridslam.systems.checkpoint",
)  # fmt: skip
MOST_FILES = 12
PRIVATE_TO_TAICHI = re.compile(r"\b(ti|taichi)\.(lang\b|_[a-z])|from taichi import (lang|_)")
KEPT_BY_TAICHI = re.compile(
    r"\b(_primal|_ArgPack\w*|compiled_kernels|make_launch_context|set_arg_\w+|compile_kernel|launch_kernel)\b"
)
"""What its kernels and launches keep to themselves."""
UPWARDS: set[tuple[str, str]] = set()
"""Imports that still run up: (importing file, imported file)."""
CIRCLES: set[tuple[str, str]] = set()
"""Imports without which there is no circle."""
FORMATS: set[tuple[str, str]] = set()
"""Imports without which inference knows of no file format."""


@cache
def modules() -> dict[str, Path]:
    """All files of the package, by the names they are imported by."""
    files = [*PACKAGE.rglob("*.py"), *(PACKAGE / "kernels").rglob("*.py")]  # rglob follows no links
    named = {}
    for file in files:
        parts = file.relative_to(PACKAGE).with_suffix("").parts
        named[".".join(("gridslam", *(part for part in parts if part != "__init__")))] = file
    return named


@cache
def syntax(module: str) -> ast.Module:
    """Of a file, or of the stub beside it, which says what the file imports when it is asked for."""
    file = modules()[module]
    stub = file.with_suffix(".pyi")
    return ast.parse((stub if stub.exists() else file).read_text(encoding="utf-8"))


@cache
def imports(module: str) -> frozenset[str]:
    """What a file imports, within functions and for type checkers alone, too."""
    found = set()
    for node in ast.walk(syntax(module)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: a relative import"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found.add(whole if whole in modules() else str(node.module))
    return frozenset(found - {module})


def inner(module: str) -> set[str]:
    """Files of the package that a file imports. The package's own name stands above all rooms."""
    return {name for name in imports(module) if name in modules()}


def room(module: str) -> str:
    parts = module.split(".")[1:] or [""]
    if parts == ["__main__"]:
        return "cli"
    return "/".join(parts[: 2 if parts[0] in ("inference", "kernels") else 1])


def circle(allowed: set[tuple[str, str]]) -> list[str]:
    """Files that import each other in a circle; empty if there are none."""
    done: set[str] = set()

    def visit(module: str, way: list[str]) -> list[str]:
        if module in way:
            return [*way[way.index(module) :], module]
        if module in done:
            return []
        for name in sorted(inner(module)):
            found = [] if (module, name) in allowed else visit(name, [*way, module])
            if found:
                return found
        done.add(module)
        return []

    for module in modules():
        found = visit(module, [])
        if found:
            return found
    return []


def formats(allowed: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Imports of file formats by inference or by what it imports."""
    todo = [name for name in modules() if name.startswith("gridslam.inference")]
    seen, found = set(todo), set()
    while todo:
        module = todo.pop()
        for name in imports(module):
            if (module, name) in allowed:
                continue
            if any(name == known or name.startswith(f"{known}.") for known in FILE_FORMATS):
                found.add((module, name))
            if name in modules() and name not in seen:
                seen.add(name)
                todo.append(name)
    return found


def test_every_file_is_in_a_room_that_has_a_floor():
    rooms = {room(name) for name in modules() if name != "gridslam"}
    assert rooms - {"inference", "kernels"} == set(FLOOR), "the floors of this test are those of the package"


def test_no_import_runs_up():
    up = set()
    for module in modules():
        for name in inner(module) - {"gridslam", "gridslam.kernels"} if module != "gridslam" else set():
            if FLOOR.get(room(name), 0) < FLOOR.get(room(module), 0):
                up.add((module, name))
    assert up == UPWARDS


def test_rooms_of_one_floor_do_not_import_each_other_in_turn():
    pairs = {(room(module), room(name)) for module in modules() for name in inner(module)}
    assert not {(a, b) for a, b in pairs if a != b and (b, a) in pairs and a and b}


def test_kernels_know_nothing_of_what_is_above_them():
    for module in modules():
        if module.startswith("gridslam.kernels"):
            assert all(name.startswith("gridslam.kernels") for name in inner(module)), module


def test_one_file_names_private_modules_of_taichi():
    files = [file for name, file in modules().items() if name != "gridslam.kernels.primitives.taichi_inside"]
    files += [file for file in Path(__file__).parent.rglob("*.py") if file != Path(__file__).resolve()]
    files += [file for folder in ("docs", "examples") for file in (PACKAGE.parent / folder).rglob("*.py")]
    assert len(files) > 500
    for file in files:
        assert not PRIVATE_TO_TAICHI.search(file.read_text(encoding="utf-8")), file
    assert PRIVATE_TO_TAICHI.search(modules()["gridslam.kernels.primitives.taichi_inside"].read_text("utf-8"))


def test_one_file_knows_what_kernels_of_taichi_keep_to_themselves():
    found = [name for name, file in modules().items() if KEPT_BY_TAICHI.search(file.read_text("utf-8"))]
    assert found == ["gridslam.kernels.primitives.taichi_inside"]


def test_no_files_import_each_other_in_a_circle():
    assert circle(CIRCLES) == []
    for edge in CIRCLES:
        assert circle(CIRCLES - {edge}), f"{edge} is no exception any longer"


def test_inference_knows_of_no_file_format():
    assert formats(FORMATS) == set()
    for edge in FORMATS:
        assert formats(FORMATS - {edge}), f"{edge} is no exception any longer"


def test_public_names_are_there_and_others_are_not():
    assert dir(gridslam) == sorted(gridslam.__all__)
    for name in gridslam.__all__:
        assert getattr(gridslam, name).__module__.startswith("gridslam."), name
    assert gridslam.from_sionna.__name__ == "measurements_from_sionna"
    assert gridslam.world.__name__ == "gridslam.world"
    for name in ("nothing", "_nothing", "__path_of_nothing__"):
        with pytest.raises(AttributeError, match=name):
            getattr(gridslam, name)


def test_what_is_not_asked_for_is_not_imported():
    program = """
import sys, gridslam
assert "numpy" not in sys.modules
from gridslam import GridSlam
import gridslam.cli.run, gridslam.runs.map_scene, gridslam.runs.progress
ours = ("systems.direct", "systems.hybrid", "systems.network", "importers", "reference")
for name in ("scipy.ndimage", "scipy.fft", "matplotlib", "taichi", *(f"gridslam.{room}" for room in ours)):
    assert name not in sys.modules, name
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_modules_of_methods_are_there_without_their_import():
    program = """
import gridslam as gs
assert gs.systems.grid.GridSlam is gs.GridSlam
assert gs.systems.adaptive.step
assert not hasattr(gs.systems, "nothing") and not hasattr(gs.systems, "_nothing")
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_folders_of_tests_are_rooms_of_the_package():
    tests = Path(__file__).parent
    rooms = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    folders = {path.name for path in tests.iterdir() if any(path.glob("*.py"))}
    assert folders - {"helpers"} <= rooms
    assert not [*(tests / "helpers").glob("test_*.py")]


def test_the_package_shows_rooms_rather_than_files():
    assert len([*PACKAGE.glob("*.py")]) <= MOST_FILES


@pytest.mark.parametrize("name", ["ezdxf", "rerun", "joblib", "distributed"])
def test_optional_packages_stay_in_one_room(name):
    users = {room(module) for module in modules() if name in {i.split(".")[0] for i in imports(module)}}
    assert len(users) <= 1


def test_no_system_inherits_from_another():
    classes = [method_class(name) for name in METHODS]
    assert len(set(classes)) == len(classes) > 10
    assert not [(a, b) for a in classes for b in classes if a is not b and issubclass(a, b)]


def test_one_function_says_what_is_declared_to_exist():
    users = {name for name, file in modules().items() if ".detect_above" in file.read_text("utf-8")}
    assert users == {"gridslam.world.filter_model"}


@pytest.mark.parametrize("folder", ["systems", "inference/management"])
def test_the_page_names_every_file_of_the_rooms_it_lists_by_file(folder):
    page = (PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    (row,) = [line for line in page.splitlines() if line.startswith(f"| `{folder}/` |")]
    files = {file.stem for file in (PACKAGE / folder).glob("*.py")} - {"__init__"}
    assert {name for name in files if f"`{name}`" not in row} == set()


def is_serial(kernel):
    """Whether each outer loop of a kernel is kept from running in parallel, whatever the device."""
    serial, loops = False, []
    for line in kernel.body:
        if isinstance(line, ast.For):
            loops.append(serial)
            serial = False
        elif "loop_config" in (text := ast.unparse(line)):  # of the next loop
            serial = text == "ti.loop_config(serialize=True)"
    assert loops, kernel.name
    return all(loops)


def test_the_page_says_how_many_kernels_have_no_parallel_loop():
    found = [
        is_serial(node)
        for module in modules()
        if module.startswith("gridslam.kernels")
        for node in ast.walk(syntax(module))
        if isinstance(node, ast.FunctionDef) and "ti.kernel" in map(ast.unparse, node.decorator_list)
    ]
    page = (PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert f"{sum(found)} of the {len(found)} have no parallel loop on any device" in page


MOST_ARGUMENTS = 12
LONG = {"gridslam.measurements.recording.from_arrays": "a column of a user's recording each, as in its file"}
"""Functions that may take more, and why."""


def argument_counts(module):
    """Functions of a file and how many arguments each takes."""
    for node in ast.walk(syntax(module)):
        if isinstance(node, ast.FunctionDef):
            known = node.args
            yield node.name, len(known.posonlyargs) + len(known.args) + len(known.kwonlyargs)


def test_no_function_takes_more_than_a_dozen_arguments():
    counts = {}
    for module in modules():
        for name, count in argument_counts(module):
            where = f"{module}.{name}"
            counts[where] = max(count, counts.get(where, 0))
    assert len(counts) > 2000
    assert {where for where, count in counts.items() if count > MOST_ARGUMENTS} == set(LONG)


MOST_LINES = 350


def test_a_file_is_one_room_of_at_most_350_lines():
    long = {
        name for name, file in modules().items() if len(file.read_text("utf-8").splitlines()) > MOST_LINES
    }
    assert not long, "split it where there is a natural seam"
