"""In this folder, engine="auto" takes the host, which elsewhere it takes only for what the kernels do not serve."""

from dataclasses import replace

import pytest

from openmm_exactrb.engines.catalogue import ENGINES


@pytest.fixture(autouse=True)
def host_is_advised(monkeypatch):
    monkeypatch.setitem(ENGINES, "native", replace(ENGINES["native"], advice=lambda *_: (False, "the host is tested")))
