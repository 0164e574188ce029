"""Every renderer that is named exists, and takes the class of results that it is named for."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import typing

import pytest

import casid
from casid.presentation import Presented, present
from casid.report.renderers import JSON_FILES, RENDERERS, renderer
from casid.report.terminal import terminal_text
from tests.report.test_pages import Seen
from tests.support import samples

FORMS = [(name, form) for name, forms in RENDERERS.items() for form in forms]


def every_class() -> dict[str, list[type]]:
    """Name -> classes of casid that have it."""
    found: dict[str, list[type]] = {}
    for module in pkgutil.walk_packages(casid.__path__, "casid."):
        if not module.name.endswith("__main__"):
            for kind in vars(importlib.import_module(module.name)).values():
                if inspect.isclass(kind) and kind.__module__ == module.name:
                    found.setdefault(kind.__name__, []).append(kind)
    return found


CLASSES = every_class()


@pytest.mark.parametrize(("name", "form"), FORMS)
def test_a_renderer_takes_the_class_that_it_is_named_for(name: str, form: str) -> None:
    make = renderer(CLASSES[name][0], form)
    first = next(iter(typing.get_type_hints(make).values()))
    assert first in CLASSES[name]
    assert not [k for k in CLASSES[name] if k is not first and issubclass(k, Presented)]


def test_every_class_that_says_so_can_be_displayed() -> None:
    presented = {
        name
        for name, kinds in CLASSES.items()
        for kind in kinds
        if issubclass(kind, Presented) and kind is not Presented
    }
    assert presented <= {name for name, forms in RENDERERS.items() if "document" in forms}
    reported = {name for name, forms in RENDERERS.items() if "report" in forms}
    assert set(JSON_FILES) == reported - {"Estimate", "MomentEstimate"}  # these write their own


def test_a_form_that_is_not_there_is_refused() -> None:
    with pytest.raises(LookupError, match="no page of int"):
        present(1, "page")


def test_a_report_as_text_has_the_words_of_its_page() -> None:
    """One document: what a reader finds on the page, a terminal shows without its markup."""
    report = renderer(samples.Diagnosis, "report")(samples.rich())
    shown = set(terminal_text(report).split())
    assert "<code>" not in shown
    page = Seen(samples.page_of(samples.rich())).text
    named = {word for cause in samples.rich().causes for word in cause.sentence.split()}
    for word in ("quadratic_damping", "coulomb_friction", "0.327", "swing-11", *named):
        assert word in page
        assert word in shown or f"{word}." in shown
