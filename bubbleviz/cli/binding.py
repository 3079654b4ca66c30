"""Commands bound to functions of the library; signatures and docstrings define the options.

Both are read from the source: importing a function for its `--help` would take a second. The type
of a parameter in the docstring determines that of its option: `bool` is a flag, `path` (not `str or
path`) a file, `{"a", "b"}` a choice, `iterable of …` an option that may be repeated, under its
singular name. The unit at the end of a name is left out.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from inspect import cleandoc
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

import bubbleviz as bv
from bubbleviz.lazy_imports import quick_imports
from bubbleviz.wording import encodable

if TYPE_CHECKING:
    from bubbleviz.api.summary import Summary

_SOURCES = Path(bv.__file__).parent
_UNIT = re.compile(r"(_s|_hz|_px|(?<=_sigma)_m)$")
"""Unit at the end of a parameter's name, which the name of its option leaves out."""
_CONSTANTS = {"AUTO": "auto"}
"""Values of constants that are defaults."""


class _Path(click.Path):
    """A path that is not empty: `Path("")`, as of an unset variable, is the current folder."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "":
            self.fail("the path is empty; give one", param, ctx)
        return super().convert(value, param, ctx)


PATH = _Path(path_type=Path)
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON: SI units, times in ms."
)


class Parameter(NamedTuple):
    """Description of a parameter from a docstring, and its default; `...` if required."""

    kind: str
    text: str
    default: Any


class Function(NamedTuple):
    text: str  # docstring up to the parameters
    parameters: dict[str, Parameter]


@cache
def function(name: str) -> Function:
    """Signature and docstring of a function of the library."""
    names = (_SOURCES / "__init__.pyi").read_text(encoding="utf-8")
    module = re.findall(rf"from \.(\S+) import \([^)]*\b{name} as", names)[0]
    source = (_SOURCES / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")
    functions = (each for each in ast.parse(source).body if isinstance(each, ast.FunctionDef))
    *_, found = (each for each in functions if each.name == name)  # overloads come before it
    text, *sections = re.split(r"\n\n(?=\w+\n-+\n)", cleandoc(ast.get_docstring(found) or ""))
    told = dict(_described(sections[0])) if sections else {}
    own = found.args
    given = [*own.args, *own.kwonlyargs]
    defaults = [*(len(own.args) - len(own.defaults)) * [None], *own.defaults, *own.kw_defaults]
    parameters = {
        each.arg: Parameter(*told.get(each.arg, ("", "")), _value(default))
        for each, default in zip(given, defaults, strict=True)
    }
    return Function(_plain(text, "\n\n"), parameters)


def _described(section: str) -> Iterator[tuple[str, tuple[str, str]]]:
    """Kind and text by name, of a section of a docstring; of `As in …` what stands there."""
    entries = re.findall(r"^(\w[^:\n]*?)(?: : (.*))?\n((?: {4}.*\n?)+)", section, re.MULTILINE)
    for names, kind, lines in entries:
        text = _plain(lines)
        other = re.match(r"As in (\w+)", text)
        for name in names.split(", "):
            if other is None:
                yield name, (kind, text)
            elif (there := function(other[1]).parameters.get(name)) is not None:
                yield name, (there.kind, there.text)


def _plain(text: str, between: str = " ") -> str:
    return between.join(" ".join(part.split()).replace("`", "") for part in text.split("\n\n"))


def _value(default: ast.expr | None) -> Any:
    if default is None:
        return ...
    with suppress(ValueError):
        return ast.literal_eval(default)
    return _CONSTANTS.get(ast.unparse(default))


def option(verb: str, name: str, former: str = "", *, required: bool = False) -> click.Option:
    """Option for a parameter of a function; `former` is a hidden name of it."""
    kind, text, default = function(verb).parameters[name]
    called = f"--{_UNIT.sub('', name).replace('_', '-')}"
    attributes: dict[str, Any] = {"help": text, "hidden": bool(former)}
    if kind == "bool":
        called += f"/--no-{called[2:]}" if default else ""
        attributes |= {"is_flag": True, "default": default}
    else:
        attributes |= {"type": _type(kind), "required": required or default is ...}
        if default not in (..., None, ()):
            attributes["default"] = default
    if kind.startswith("iterable"):
        called, attributes["multiple"] = called.removesuffix("s"), True
    return click.Option([former or called, name], **attributes)


def _type(kind: str) -> click.ParamType[Any] | type:
    if kind.startswith("{"):
        return click.Choice(sorted(ast.literal_eval(kind[: kind.index("}") + 1])))
    if "path" in kind and "str" not in kind:
        return PATH
    return {"int": int, "float": float}.get(kind.partition(",")[0], str)


@dataclass(frozen=True)
class Verb:
    """A command that calls a function of the library and prints its result."""

    verb: str  # the function
    arguments: Mapping[str, str] = field(default_factory=dict)  # with their names in the usage
    opening: tuple[str, ...] = ()  # options of `open`, for a function that takes its frames
    more: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # options of other functions
    required: tuple[str, ...] = ()  # required options that are optional parameters
    without: tuple[str, ...] = ()  # parameters without an option
    former: Mapping[str, str] = field(default_factory=dict)  # parameters by hidden former names
    extra: tuple[click.Option, ...] = ()
    call: Callable[..., None] | None = None  # called instead of the function

    def command(self, name: str) -> click.Command:
        """The command; its function is imported when it runs."""
        own, arguments = function(self.verb), {**self.arguments}
        if self.opening:
            arguments["recording"] = "REC"
        no_options = {*arguments, *self.without, "progress", "timeout_s"}
        no_options |= {"frames"} if self.opening else set()
        names = [(self.verb, each) for each in own.parameters if each not in no_options]
        names += [(of, each) for of, some in self.more.items() for each in some]
        names += [("open", each) for each in self.opening]
        of = {each: verb for verb, each in names}
        params: list[click.Parameter] = [
            *(click.Argument([n], metavar=shown, type=PATH) for n, shown in arguments.items()),
            *(option(verb, n, required=n in self.required) for n, verb in of.items()),
            *(option(of[n], n, former) for former, n in self.former.items()),
            *self.extra,
        ]
        call = self.call or partial(run_on_frames if self.opening else run, self.verb)
        return json_option(
            click.Command(name, params=params, callback=_checked(call), help=own.text)
        )


def _checked(call: Callable[..., Any]) -> Callable[..., None]:
    def checked(**options: Any) -> None:
        if options.get("colour_delay_s") is not None and not options.get("shear"):
            raise click.UsageError(
                "--colour-delay needs --shear, which uses the colour images; give both"
            )
        call(**options)

    return checked


def run(verb: str, *arguments: Any, as_json: bool, **options: Any) -> Any:
    """Call a function of the library, if it can with a progress bar, and print its result."""
    called = partial(getattr(bv, verb), *arguments, **options)
    if "progress" in function(verb).parameters:
        with Bar() as bar:
            result = called(progress=bar)
    else:
        result = called()
    report(result, as_json=as_json)
    return result


def run_on_frames(
    verb: str,
    recording: Path,
    frames: str | None = None,
    depth_topic: str | None = None,
    wrench: str | None = None,
    **options: Any,
) -> None:
    """Call a function with frames of a recording, after a check for existing outputs."""
    from bubbleviz.files import refuse_existing

    for path in filter(None, (options.get("out"), options.get("csv"))):
        refuse_existing(path, overwrite=options["overwrite"])
    with quick_imports():
        getattr(bv, verb)
        source = bv.open(recording, frames, depth_topic=depth_topic, wrench_topic=wrench)
    with source as chosen:
        run(verb, chosen, **options)


def report(result: Summary, *, as_json: bool) -> None:
    """Print a summary, and its warning on standard error."""
    click.echo(encodable(result.to_json() if as_json else result.to_text()))
    warning = getattr(result, "warning", None)
    if warning:
        click.echo(f"bubbleviz: warning: {warning}", err=True)


class Bar:
    def __enter__(self) -> Bar:
        from tqdm import tqdm

        self._bar = tqdm(total=100, unit="%", leave=False, disable=None)
        self._step = ""
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def __call__(self, step: str, done: float) -> None:
        if self._step != step:
            self._step = step
            self._bar.reset()
            self._bar.set_description(step)
        self._bar.update(100.0 * done - self._bar.n)
