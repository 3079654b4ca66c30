"""The packages as documented, by the contracts of pyproject.toml.

And the tests: they look at what is public, and wait for conditions.
"""

import ast
from functools import cache
from pathlib import Path

from importlinter.cli import lint_imports

REPOSITORY = Path(__file__).parents[1]
PACKAGES = (REPOSITORY / "bubbleviz", REPOSITORY / "ui" / "bubbleviz_ui")
FILES = [file for package in PACKAGES for file in sorted(package.rglob("*.py"))]

BY_NAME = {"getattr", "setattr", "delattr", "hasattr", "attrgetter"}
"""Functions that take the name of an attribute as text; pytest's `monkeypatch` has two of them."""
PUBLIC_AFTER_ALL = {"_replace", "_asdict", "_fields", "_exit"}
"""Documented, of named tuples and `os`."""


@cache
def tree_of(file):
    """Syntax tree of a file, and all its nodes."""
    tree = ast.parse(file.read_text())
    return tree, [*ast.walk(tree)]


def test_rooms_and_packages_import_what_their_contracts_allow(capsys):
    """Layers, no cycles, no Qt in the backend, no numerics in the window."""
    done = lint_imports(str(REPOSITORY / "pyproject.toml"), no_cache=True)
    assert done == 0, capsys.readouterr().out


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
    """Name of the called function, without its object or module; empty if it has none."""
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


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
            or (called(node) == "wait" and ast.unparse(node.func).endswith("bot.wait"))
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
