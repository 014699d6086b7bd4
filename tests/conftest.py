"""What all tests share: where a system library is missing, what needs it is skipped, not failed.

Open3D (the virtual scanner) cannot be imported without libEGL, libGL and libusb. Everything else works
without them, and ``make test`` on a machine where nobody may install them has to show that.
"""

import os
import re

import pytest
from hypothesis import settings

# In CI the examples are the same every time: a red run is the change's own. Elsewhere they vary.
settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")

pytest_plugins = ["pytester"]

MISSING = re.compile(r"(lib[\w.+-]+\.so[.\d]*): cannot open shared object file")


def skip_for(error):
    """Turn an import that failed for want of a system library into a skip; raise all others again."""
    found = MISSING.search(str(error))
    if found is None:
        raise error
    pytest.skip(f"the system library {found[1]} is missing; tools/setup.sh says how to get it")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item):
    try:
        return (yield)
    except ImportError as error:
        return skip_for(error)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    try:
        return (yield)
    except ImportError as error:
        return skip_for(error)
