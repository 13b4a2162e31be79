import locale

import pytest


@pytest.fixture(autouse=True)
def _same_locale():
    """Restore the locale: OpenMM's PME leaves "C" on OpenCL (VkFFT), and files are read as ASCII in the tests after."""
    before = locale.setlocale(locale.LC_ALL)
    yield
    locale.setlocale(locale.LC_ALL, before)
