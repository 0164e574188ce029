"""Arguments of another type than a public call declares: refused by name, with what it takes.

Nothing is checked as long as a call succeeds. Where one fails with an error that is not casid's
own, its arguments are compared with the annotations, and the first that does not fit is named.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Literal, SupportsFloat, SupportsIndex, TypeVar, Union, get_args, get_origin

from casid.errors import CasidError, DataError

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T", bound=type)

_FAILURES = (TypeError, AttributeError, ValueError, LookupError, NotImplementedError)
"""What a value of the wrong type gives, in Python, NumPy and CasADi."""


def names_wrong_types(error: type[CasidError] = DataError) -> Callable[[F], F]:
    """A decorator of public functions, which name the argument that is of the wrong type.

    Raises
    ------
    CasidError
        An `error`, where the function fails and an argument does not fit its annotation.
    """

    def decorate(function: F) -> F:
        """The function, as it is where it succeeds."""

        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            """Compare the arguments with their annotations once the function has failed."""
            try:
                return function(*args, **kwargs)
            except (CasidError, *_FAILURES) as failure:
                if isinstance(failure, CasidError) and not _is_ours(failure):
                    raise
                refusal = _refusal(function, args, kwargs)
                if refusal is None:
                    raise
                raise error(refusal) from failure

        return call  # type: ignore[return-value]

    return decorate


def methods_name_wrong_types(error: type[CasidError] = DataError) -> Callable[[T], T]:
    """`names_wrong_types` for the constructor and every public method of a class."""

    def decorate(cls: T) -> T:
        """The class itself, its own methods replaced."""
        for name, member in list(vars(cls).items()):
            if inspect.isfunction(member) and (name == "__init__" or not name.startswith("_")):
                setattr(cls, name, names_wrong_types(error)(member))
        return cls

    return decorate


class _Refusal(str):
    """What is wrong with an argument: said of the outermost call, which is the user's own."""


def _is_ours(error: CasidError) -> bool:
    return bool(error.args) and isinstance(error.args[0], _Refusal)


def _refusal(
    function: Callable[..., Any], args: tuple[Any, ...], kwargs: Mapping[str, Any]
) -> _Refusal | None:
    """What is wrong, where, and how to correct it; None where every argument fits."""
    signature = inspect.signature(function)
    try:
        given = signature.bind(*args, **kwargs).arguments
    except TypeError:
        return None  # Python itself says which argument is missing or unknown
    owner = [type(given.pop("self")).__name__] if "self" in given else []
    first = next(iter(given.values()), None)
    where = ".".join([*owner, function.__name__]).removesuffix(".__init__")
    for name, argument in given.items():
        parameter = signature.parameters[name]
        hint = _read(parameter.annotation, function)
        for label, value in _values(parameter, argument):
            misfit = _misfit(label, value, hint)
            if misfit is None:
                continue
            which = f"({first!r}, ...)" if isinstance(first, str) and first is not argument else ""
            has_default = parameter.default is not inspect.Parameter.empty
            return _Refusal(f"{where}{which}: {misfit}{', or leave it out' * has_default}")
    return None


def _values(parameter: inspect.Parameter, argument: Any) -> Iterator[tuple[str, Any]]:
    """Each value of a parameter with its name: several of ``*names`` and ``**values``."""
    if parameter.kind is inspect.Parameter.VAR_POSITIONAL:
        yield from ((f"{parameter.name}[{i}]", v) for i, v in enumerate(argument))
    elif parameter.kind is inspect.Parameter.VAR_KEYWORD:
        yield from argument.items()
    else:
        yield parameter.name, argument


class _Unread:
    """What stands for a type that only the type checker loads: every value fits."""


class _Names(dict[str, Any]):
    """The names of a module, those that only the type checker knows standing for anything."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, _Unread)


def _read(annotation: Any, function: Callable[..., Any]) -> Any:
    """The type that an annotation of the library names; `_Unread` where it cannot be read."""
    if not isinstance(annotation, str):
        return _Unread if annotation is inspect.Parameter.empty else annotation
    try:
        return eval(annotation, {}, _Names(getattr(function, "__globals__", {})))
    except (TypeError, AttributeError):
        return _Unread


def _misfit(label: str, value: Any, hint: Any) -> str | None:
    """What does not fit a type, and what would; None where all of it does."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        misfits = [_misfit(label, value, h) for h in inner]
        if None in misfits:
            return None
        close = [m for h, m in zip(inner, misfits, strict=True) if _is_a(value, h)]
        return close[0] if close else _give(label, value, hint)
    if not _is_a(value, hint):
        return _give(label, value, hint)
    parts: list[tuple[str, Any, Any]] = []
    if isinstance(value, Mapping) and len(inner) == 2:
        parts += [(f"a name in {label}", key, inner[0]) for key in value]
        parts += [(f"{label}[{key!r}]", entry, inner[1]) for key, entry in value.items()]
    elif isinstance(value, list | tuple) and _is_list(origin) and len({*inner} - {...}) == 1:
        parts += [(f"{label}[{i}]", entry, inner[0]) for i, entry in enumerate(value)]
    return next((m for part in parts if (m := _misfit(*part)) is not None), None)


def _is_a(value: Any, hint: Any) -> bool:
    """True where a value is of a type, whatever stands in it."""
    known = get_origin(hint) or hint
    if known is Literal:
        return value in get_args(hint)
    if known is float:  # numbers of NumPy and CasADi are no subclasses of it
        return isinstance(value, SupportsFloat) and not isinstance(value, str | bytes)
    if known is int or known is bool:
        return isinstance(value, SupportsIndex)
    if known is None or known is Callable:
        return value is None if known is None else callable(value)
    if not isinstance(known, type) or known is _Unread:
        return True
    if _is_list(known):
        return isinstance(value, Iterable) and not isinstance(value, str | bytes)
    try:
        return isinstance(value, known)
    except TypeError:  # a protocol for the type checker alone
        return True


def _is_list(known: Any) -> bool:
    """True of the types of lists, tuples, sets and arrays; neither of mappings nor of text."""
    if not isinstance(known, type) or issubclass(known, Mapping | str | bytes):
        return False
    is_general = known.__module__ in ("builtins", "collections.abc", "numpy")
    return is_general and issubclass(known, Iterable)


def _give(label: str, value: Any, hint: Any) -> str:
    text = repr(value)
    return f"{label} = {text if len(text) <= 60 else text[:57] + '...'}; give {_described(hint)}"


def _described(hint: Any) -> str:
    """What a type takes, in words: "a list of text", "a number or a dict {text: number}"."""
    known, inner = get_origin(hint) or hint, get_args(hint)
    if known in (Union, types.UnionType):
        return " or ".join(_described(h) for h in inner if h is not type(None))
    if known is Literal:
        return " or ".join(map(repr, inner))
    if known is bool:
        return "True or False"
    if isinstance(known, type) and issubclass(known, Mapping):
        return f"a dict {{{': '.join(map(_noun, inner))}}}"
    if _is_list(known) and known.__module__ == "numpy":
        return "an array of numbers"
    if _is_list(known):
        return f"a list of {_noun(inner[0])}" if inner and inner[0] is not Any else "a list"
    return _noun(hint) if known is str else f"a {_noun(hint)}"


def _noun(hint: Any) -> str:
    """What stands in a dict or a list: "text", "number", "casid.Model"."""
    known = get_origin(hint) or hint
    if known in (Union, types.UnionType):
        return " or ".join(_noun(h) for h in get_args(hint) if h is not type(None))
    words = {str: "text", int: "whole number", float: "number", Callable: "function", None: "None"}
    if known in words:
        return words[known]
    if not isinstance(known, type) or known is _Unread:
        return "value"
    is_ours = known.__module__.startswith("casid.")
    return f"casid.{known.__name__}" if is_ours else known.__name__
