"""The packages as documented: no cycles, and the contracts of pyproject.toml.

And the tests: they look at what is public, and wait for conditions.
"""

import ast
import os
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
PACKAGES = (REPOSITORY / "bubbleviz", REPOSITORY / "ui" / "bubbleviz_ui")
FILES = [file for package in PACKAGES for file in sorted(package.rglob("*.py"))]

BY_NAME = {"getattr", "setattr", "delattr", "hasattr", "attrgetter"}
"""Functions that take the name of an attribute as text; pytest's `monkeypatch` has two of them."""
PUBLIC_AFTER_ALL = {"_replace", "_asdict", "_fields", "_exit"}
"""Documented, of named tuples and `os`."""


def name_of(file):
    """Import name of a module."""
    package = next(package for package in PACKAGES if file.is_relative_to(package))
    parts = file.relative_to(package.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def tree_of(file):
    """Syntax tree of a file, and all its nodes."""
    tree = ast.parse(file.read_text())
    return tree, [*ast.walk(tree)]


MODULES = {name_of(file): file for file in FILES}


def imported(node):
    """Modules that are imported at run time below a node, inside functions too."""
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        assert node.level == 0 and node.module, "imports are absolute"
        for alias in node.names:
            full = f"{node.module}.{alias.name}"
            yield full if full in MODULES else node.module
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.expr):
            yield from imported(child)


@cache
def imports():
    """What each module imports."""
    return {name: set(imported(tree_of(file)[0])) for name, file in MODULES.items()}


def test_no_module_imports_itself_through_others():
    graph = {name: targets & MODULES.keys() - {name} for name, targets in imports().items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" → ".join(error.args[1]))


def test_rooms_and_packages_import_what_their_contracts_allow():
    """The contracts in pyproject.toml: layers, no Qt in the backend, no numerics in the window."""
    found = subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports_command as c; c()",
            "--no-cache",
        ],
        cwd=REPOSITORY,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(REPOSITORY), str(REPOSITORY / "ui")]),
        },
        capture_output=True,
        text=True,
    )
    assert found.returncode == 0, found.stdout


def private(name):
    """Whether a dotted name has a private part."""
    return any(
        part.startswith("_") and not part.endswith("__") and part not in PUBLIC_AFTER_ALL
        for part in name.split(".")
    )


def private_names(node):
    """Private names of others that a piece of code uses, by attribute, import or text."""
    if isinstance(node, ast.Attribute):
        own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
        return [node.attr] if private(node.attr) and not own else []
    if isinstance(node, ast.ImportFrom):
        return [alias.name for alias in node.names if private(alias.name)]
    if isinstance(node, ast.Call) and called(node) in BY_NAME:
        texts = [a.value for a in node.args if isinstance(a, ast.Constant)]
        return [text for text in texts if isinstance(text, str) and private(text)]
    return []


def called(node):
    """Name of the called function, without its object or module."""
    return ast.unparse(node.func).split(".")[-1]


TESTS = sorted((REPOSITORY / "tests").rglob("*.py"))


def test_tests_use_nothing_private():
    found = [
        f"{file.relative_to(REPOSITORY)}:{node.lineno}: {name}"
        for file in TESTS
        for node in tree_of(file)[1]
        for name in private_names(node)
    ]
    assert not found


def test_tests_wait_for_conditions_and_never_for_a_time():
    """Helpers may sleep: a slow source, a robot with a rate, a polling loop."""
    found = [
        f"{file.relative_to(REPOSITORY)}:{node.lineno}"
        for file in TESTS
        if file.name.startswith("test_")
        for node in tree_of(file)[1]
        if isinstance(node, ast.Call)
        and (
            called(node) in ("sleep", "qWait", "qSleep")
            or ast.unparse(node.func).endswith("bot.wait")
        )
    ]
    assert not found


def late_imports(file):
    """First and last line of each run of imports inside a function."""
    for function in tree_of(file)[1]:
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = sorted(
                (node.lineno, node.end_lineno or node.lineno)
                for node in ast.walk(function)
                if isinstance(node, ast.Import | ast.ImportFrom)
            )
            for k, (start, end) in enumerate(lines):
                if k and start - lines[k - 1][1] <= 2:
                    lines[k] = (lines[k - 1][0], end)
            yield from dict(lines).items()


def test_an_import_inside_a_function_says_why():
    """A comment at the import or for the module names the faster start or the optional extra."""
    silent = []
    for file in FILES:
        text = file.read_text().splitlines()
        if "import" in (ast.get_docstring(tree_of(file)[0]) or ""):
            continue
        for start, end in late_imports(file):
            above = text[start - 2].strip().startswith("#")
            if not above and not any("  # " in line for line in text[start - 1 : end]):
                silent.append(f"{file.relative_to(REPOSITORY)}:{start}")
    assert not silent
