"""``pytest --nbmake notebooks`` (part of plain ``pytest``): the short form, and errors in slider callbacks fail the run."""

import os

import pytest

SHORT_AND_STRICT = {"ADAPTIVEFACE_NOTEBOOK_FAST": "1", "ADAPTIVEFACE_STRICT": "1"}
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Only while a notebook runs: other tests of the same session have settings of their own."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in SHORT_AND_STRICT.items():
            if name not in os.environ:
                patch.setenv(name, value)
        return (yield)
