"""Options, data and executors that all tests share."""

import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from tledface.device import devices

REPOSITORY = Path(__file__).parents[1]


@dataclass(frozen=True)
class Executor:
    """A way to run the kernels: keyword arguments of tledface.Simulator."""

    device: str
    kernels: str

    @property
    def kwargs(self):
        return {"device": self.device, "kernels": self.kernels}

    def __str__(self):
        return f"{self.device}-{self.kernels}"


def _executors():
    found = [Executor("native", "rows")]
    for device in devices():
        if device.works and device.id.startswith("opencl"):
            if device.kind == "cpu":
                found.append(Executor(device.id, "rows"))
            found.append(Executor(device.id, "gather"))
    return found


EXECUTORS = _executors()


def pytest_addoption(parser):
    parser.addoption("--run-slow", action="store_true", help="run the long studies too")


def pytest_collection_modifyitems(config, items):
    if not config.getoption("--run-slow"):
        skip = pytest.mark.skip(reason="a long study: --run-slow runs it")
        for item in items:
            if "slow" in item.keywords:
                item.add_marker(skip)


def pytest_sessionstart(session):
    if os.environ.get("TLEDFACE_REQUIRE_OPENCL") == "1" and len(EXECUTORS) == 1:
        raise pytest.UsageError(
            "TLEDFACE_REQUIRE_OPENCL=1, but no OpenCL device works here: see `tledface doctor`"
        )


@pytest.fixture(params=EXECUTORS, ids=str)
def executor(request):
    """Every executor that works on this machine."""
    return request.param


@pytest.fixture(scope="session")
def shared_data():
    """The folder of real anatomy, where this machine has it."""
    root = Path(os.environ.get("TLEDFACE_SHARED", REPOSITORY.parent / "shared"))
    if not (root / "data").is_dir():
        pytest.skip("the shared anatomy data are not on this machine")
    return root / "data"
