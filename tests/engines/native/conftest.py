import locale

import pytest

from places import REFERENCE, device_platform


@pytest.fixture(autouse=True)
def _same_locale():
    """Restore the locale: OpenMM's PME leaves "C" on OpenCL (VkFFT), and files are read as ASCII in the tests after."""
    before = locale.setlocale(locale.LC_ALL)
    yield
    locale.setlocale(locale.LC_ALL, before)


@pytest.fixture(params=[pytest.param("native", marks=pytest.mark.opencl), "Reference"])
def where(request):
    """Return the name of a place where the engine runs, and the platform there."""
    return request.param, device_platform() if request.param == "native" else REFERENCE
