"""Many small cases in one test, where each takes less time than pytest needs for a test of its own."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any

import pytest


def in_one_test(
    names: str, cases: Iterable[Any], ids: Callable[[Any], str] | None = None
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """As pytest.mark.parametrize, with all cases in one test; names: of the arguments, as in "x, y".

    All cases are run. Each that fails is told with its values, or with `ids` of it. Of the fixtures that the test
    takes, all cases get the same, so that it must leave them as they were. A case that skips itself is passed over.
    """
    arguments, listed = [name.strip() for name in names.split(",")], list(cases)

    def made(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def test(**fixtures: Any) -> None:
            failed = []
            for case in listed:
                values = dict(zip(arguments, case if len(arguments) > 1 else (case,), strict=True))
                try:
                    function(**values, **fixtures)
                except pytest.skip.Exception:
                    continue
                except (Exception, pytest.fail.Exception) as error:
                    told = ids(case) if ids else ", ".join(f"{name} = {value!r:.200}" for name, value in values.items())
                    error.add_note(f"The case: {told}")
                    failed.append(error)
            if failed:
                raise BaseExceptionGroup(f"{len(failed)} of {len(listed)} cases failed", failed)

        asked = [one for name, one in inspect.signature(function).parameters.items() if name not in arguments]
        test.__signature__ = inspect.Signature(asked)  # type: ignore[attr-defined]
        return test

    return made
