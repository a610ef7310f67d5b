"""Write the pages of the reference that follow from the code: `python docs/generate.py`.

`scene-file.md` comes from the types of scenes, `file-formats.md` from the descriptions that writers and
readers of files go by, `methods.md` from the registry, and `model.md` and `notebook.md` from the pages in the
folders of their names, so that none can say what isn't so; a test compares them with those committed. What
keys of scenes mean is in gridslam/world/scene_keys.toml, what files, methods and pages are in
docs/formats.toml.
"""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import fields
from itertools import groupby
from pathlib import Path

from gridslam.bench.bench import Speed, StepSpeed
from gridslam.bench.growth import Growth
from gridslam.bench.kernels import KernelSpeed
from gridslam.bench.plan import Plan
from gridslam.bench.start import Machine, StartUp
from gridslam.io.datasets import Layout
from gridslam.maps.map_datasets import MAP
from gridslam.measurements.datasets import MEASUREMENTS, RECORDING
from gridslam.runs.network_files import CLOCKS
from gridslam.runs.step_datasets import ALL_STEPS
from gridslam.runs.summary import SUMMARY, Entry
from gridslam.studies.columns import HEAD, RECORD, RUNS, STEPS
from gridslam.studies.columns import SUMMARY as TOTALS
from gridslam.systems.registry import METHODS, method_class, uses_maps
from gridslam.world.columns import TABLE
from gridslam.world.scene_reference import keys

DOCS = Path(__file__).resolve().parent
MEANINGS = tomllib.loads((DOCS / "formats.toml").read_text(encoding="utf-8"))


class Missing(KeyError):
    """What a key or dataset means isn't said yet."""


def meaning(of: str, key: str) -> str:
    """What a key of a table in formats.toml means."""
    told = MEANINGS[of]
    if key not in told:
        raise Missing(f"docs/formats.toml: no line for {key!r} of {of}; add it, then python docs/generate.py")
    return str(told[key])


COLUMNS = ("key", "unit", "default", "allowed", "meaning")
ALIKE = {
    ("[anchors]", "array"): "radio.array",
    ("[agents]", "array"): "radio.array",
    ("[agents]", "clock"): "anchors.clock",
}
"""Tables that are described elsewhere."""


def scene_page() -> str:
    """The reference of the scene file."""
    lines = ["# Scene file", "", *MEANINGS["page"]["scene"].strip().splitlines()]
    table: str | None = None
    for key in keys():
        if key.table != table:
            table = key.table
            title = f"`{_header(table)}`" if table else "At the top"
            lines += ["", f"## {title}", "", f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|"]
        plain = key.default in ("-", "required", "its own defaults")
        default = key.default if plain else f"`{key.default}`"
        allowed = key.allowed.replace("a table", f"a table as `{ALIKE.get((key.table, key.name), '')}`")
        allowed = allowed.replace(" as ``", "")
        lines.append(f"| `{key.name}` | {key.unit} | {default} | {allowed} | {key.meaning} |")
    return "\n".join(lines) + "\n"


def _header(table: str) -> str:
    """A table's header as TOML has it: brackets twice where there may be several."""
    first, *rest = table.split(".")
    plain = ".".join([first.strip("[]"), *(part.strip("[]") for part in rest)])
    return f"[[{plain}]]" if table.endswith("]") else f"[{plain}]"


def methods_page() -> str:
    """All methods that are entered, with what they take and the papers they follow."""
    lines = ["# Methods", "", *MEANINGS["page"]["methods"].strip().splitlines(), ""]
    lines += [
        "| `--method` | what it is | whose it is | what it takes | starts from a map | model |",
        "|---|---|---|---|---|---|",
    ]
    for name, entry in METHODS.items():
        page = entry.page.removeprefix("docs/")
        kept = "yes" if uses_maps(method_class(name)) else "no"
        cells = entry.about, meaning("whose", name), entry.measures, kept, f"[{page.split('/')[0]}]({page})"
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    for name in METHODS:
        lines += ["", f"## `{name}`", "", *meaning("methods", name).strip().splitlines()]
    return "\n".join(lines) + "\n"


def formats_page() -> str:
    """The reference of the files that gridslam writes and reads."""
    lines = ["# File formats", "", *MEANINGS["page"]["formats"].strip().splitlines()]
    lines += ["", "## `measurements.csv`", "", *_rows()]
    for layout in (MEASUREMENTS, MAP, ALL_STEPS, RECORDING, CLOCKS):
        lines += ["", f"## `{layout.file}`", "", *_h5(layout)]
    lines += ["", "## `run.json`", "", *meaning("run.json", "about").strip().splitlines(), *_entries(SUMMARY)]
    lines += ["", "## `study.jsonl`", "", *meaning("study.jsonl", "about").strip().splitlines()]
    lines += [*_entries(HEAD, "key of the first line"), *_entries(RECORD, "key of each other line")]
    for name, columns in (("runs.csv", RUNS), ("steps.csv", STEPS), ("summary.csv", TOTALS)):
        lines += ["", f"## `{name}`", "", *_columns(name, columns)]
    lines += ["", "## `bench --json`", "", *_bench()]
    for name, told in MEANINGS["others"].items():
        lines += ["", f"## `{name}`", "", *told.strip().splitlines()]
    return "\n".join(lines) + "\n"


def _rows() -> Iterator[str]:
    """The columns of a table of measurements, of the types that check it."""
    yield from meaning("measurements.csv", "about").strip().splitlines()
    yield from ("", f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|")
    for one in TABLE:
        unit = {"1": "", "index": "name"}.get(one.unit, one.unit)
        allowed = "the scene's names" if one.unit == "index" else one.allowed
        yield f"| `{one.name}` | {unit} | {one.default} | {allowed} | {one.meaning} |"
    yield f"| `agent` | name | one agent | the scene's names | {meaning('measurements.csv', 'agent')} |"


def _columns(name: str, columns: Iterable[Entry]) -> Iterator[str]:
    """Columns of a study's table, as they are described."""
    yield from meaning(name, "about").strip().splitlines()
    yield from _entries(columns, "column", "empty")


def _bench() -> Iterator[str]:
    """What was measured, by the types that hold it: their attributes are the keys, told in docstrings."""
    yield from meaning("bench", "about").strip().splitlines()
    yield from ("", "| key | type | unit | meaning |", "|---|---|---|---|")
    inner = {"plan": Plan, "machine": Machine, "kernels": KernelSpeed, "steps": StepSpeed, "growth": Growth}
    inner["start_up"] = StartUp
    for name in ("format", "version", *(field.name for field in fields(Speed))):
        several = str(Speed.__annotations__.get(name, "")).startswith("tuple")
        kind = "" if name in inner else {"format": "text", "version": "whole number"}.get(name, "number")
        yield f"| `{name}` | {kind} | {'s' if name == 'seconds' else ''} | {meaning('bench', name)} |"
        for key, kind, told in _attributes(inner[name]) if name in inner else ():
            unit = _unit(key)
            yield f"| `{name}{'[]' * several}.{key}` | {kind} | {unit} | {told} |"


def _attributes(kind: type) -> Iterator[tuple[str, str, str]]:
    """Name, type in words and meaning of a dataclass's attributes, as its docstring has them."""
    words = {"int": "whole number", "float": "number", "str": "text", "bool": "true or false"}
    entries = re.findall(r"^(\w+) : .*\n((?: {4}.*\n?)+)", inspect.getdoc(kind) or "", re.M)
    told = {name: " ".join(text.split()).rstrip(".").replace("``", "`") for name, text in entries}
    for field in fields(kind):
        if field.name not in told:
            raise Missing(f"{kind.__name__}: no line for {field.name} in its docstring")
        plain, null = str(field.type).removesuffix(" | None"), str(field.type).endswith(" | None")
        own = words.get(plain.partition("[")[2].partition(",")[0].rstrip("]") or plain, "table")
        shown = (
            f"list of {own}s" if plain.startswith("tuple") else "table" if plain.startswith("dict") else own
        )
        meaning = told[field.name].replace("None", "null")
        yield field.name, f"{shown} or null" if null else shown, meaning[:1].lower() + meaning[1:]


def _unit(key: str) -> str:
    """Of a key of `bench --json`, by its end."""
    if "_per_" in key:
        return {"ns_per_unit": "ns", "steps_per_s": "1/s"}[key]
    units = {"s": "s", "seconds": "s", "ms": "ms", "us": "us", "mb": "MB", "gb": "GB", "m": "m"}
    return units.get(key.rpartition("_")[2], "") if "_" in key or key == "seconds" else ""


def _h5(layout: Layout) -> Iterator[str]:
    """Groups and datasets of an HDF5 file, as they are described to its writer and its reader."""
    yield from meaning(layout.file, "about").strip().splitlines()
    versions = " or ".join(map(str, layout.versions))
    yield from ("", f'Root attributes: `format = "{layout.kind}"`, `version = {versions}`.', "")
    absent = [f"`/{group.name}`: {group.absent}" for group in layout.groups if group.absent]
    if absent:
        yield from (f"What a file without a group means: {'; '.join(absent)}.", "")
    yield "| dataset or attribute | shape | type | unit | default | allowed | meaning |"
    yield "|---|---|---|---|---|---|---|"
    for group in layout.groups:
        for one in group.datasets:
            path = f"{group.name}/{one.name}".replace("/@", "@") if group.name else one.name
            name, _, attribute = path.partition("@")
            shown = f"`/{name}`, attribute `{attribute}`" if attribute else f"`/{name}`"
            shown = shown.removeprefix("`/`, ")
            shape = f"({one.shape}{'' if ', ' in one.shape else ','})" if one.shape else ""
            cells = shown, shape, one.kind, one.shown_unit, one.default, one.allowed, one.meaning
            yield f"| {' | '.join(cells)} |"


def _entries(entries: Iterable[Entry], what: str = "key", empty: str = "null, or missing") -> Iterator[str]:
    """Keys of run.json or columns, as they are described to those who write and check them."""
    yield from ("", f"| {what} | type | unit | {empty} | allowed | meaning |", "|---|---|---|---|---|---|")
    for one in entries:
        allowed = "" if one.allowed == one.kind else one.allowed
        cells = f"`{one.name}`", one.kind, one.shown_unit, one.default, allowed, one.meaning
        yield f"| {' | '.join(cells)} |"


GIVEN = re.compile(r"\\text\{\(M\d+\)(?:, \(M\d+\))*\}|\*\*\(M\d+\)\*\*")
"""A formula's number where it is given: beside the formula, or bold where a sentence is the formula."""


def model_page() -> str:
    """The model's sections with their pages, and each formula with the heading under which it is given."""
    lines = ["# The model", "", *MEANINGS["page"]["model"].strip().splitlines()]
    lines += ["", "## Sections", "", "| section | page | what is there | formulas |", "|---|---|---|---|"]
    where: dict[int, tuple[str, str]] = {}
    for name, page in _pages("model"):
        given = dict(_given(page))
        where |= {number: (name, place) for number, place in given.items()}
        section, _, title = _title(page).partition(". ")
        cells = section, f"[{title}](model/{name}.md)", meaning("model", name), _numbers(given)
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "## Formulas by number", "", "| numbers | where they are given |", "|---|---|"]
    for ten, numbers in groupby(sorted(where), lambda number: number // 10):
        runs = []
        for name, run in groupby(numbers, lambda number: where[number][0]):
            links = [f"[M{number}](model/{name}.md#{where[number][1]})" for number in run]
            runs.append(f"{' '.join(links)} {name}")
        lines.append(f"| {10 * ten} to {10 * ten + 9} | {'; '.join(runs)} |")
    return "\n".join(lines) + "\n"


def notebook_page() -> str:
    """The pages of the notebook."""
    lines = ["# Notebook", "", *MEANINGS["page"]["notebook"].strip().splitlines()]
    lines += ["", "| page | what was tried and measured |", "|---|---|"]
    for name, page in _pages("notebook"):
        lines.append(f"| [{_title(page)}](notebook/{name}.md) | {meaning('notebook', name)} |")
    return "\n".join(lines) + "\n"


def _pages(folder: str) -> Iterator[tuple[str, Path]]:
    """Names and files of a folder's pages, in the order in which formats.toml tells of them."""
    for page in sorted((DOCS / folder).glob("*.md")):
        meaning(folder, page.stem)
    for name in MEANINGS[folder]:
        yield name, DOCS / folder / f"{name}.md"


def _title(page: Path) -> str:
    """What a page is called."""
    return page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")


def _given(page: Path) -> Iterator[tuple[int, str]]:
    """Numbers of the formulas that a page gives, each with the name of the heading above it in links."""
    names: list[str] = []
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            name = re.sub(r"[^\w\- ]", "", line.lstrip("#").strip().lower()).replace(" ", "-")
            again = sum(re.fullmatch(rf"{re.escape(name)}(-\d+)?", other) is not None for other in names)
            names.append(f"{name}-{again}" if again else name)
        for found in GIVEN.findall(line):
            yield from ((int(number), names[-1]) for number in re.findall(r"\d+", found))


def _numbers(given: Iterable[int]) -> str:
    """Formulas in a few words: M1 to M8, M15."""
    runs: list[list[int]] = []
    for number in sorted(given):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    joint = {1: ", ", 2: ", "}
    return ", ".join(
        f"M{run[0]}" if len(run) == 1 else f"M{run[0]}{joint.get(len(run), ' to ')}M{run[-1]}" for run in runs
    )


PAGES = {
    f"{name}.md": draw
    for name, draw in {
        "scene-file": scene_page,
        "file-formats": formats_page,
        "methods": methods_page,
        "model": model_page,
        "notebook": notebook_page,
    }.items()
}

if __name__ == "__main__":
    for page, draw in PAGES.items():
        (DOCS / page).write_text(draw(), encoding="utf-8")
        print(f"wrote {DOCS / page}")
