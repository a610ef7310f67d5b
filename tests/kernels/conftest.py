"""All tests of this folder launch kernels."""

import pytest

from gridslam import runtime


@pytest.fixture(scope="session", autouse=True)
def runtime_started():
    runtime.start()
