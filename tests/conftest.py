"""Options, data and executors that all tests share."""

import importlib
import json
import os
from contextlib import contextmanager
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
            found.append(Executor(device.id, "tile"))
    return found


EXECUTORS = _executors()


@contextmanager
def file_limit(size):
    """Let this process write no file longer than that, as `ulimit -f` does."""
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


FIGURES = pytest.StashKey[list]()


def pytest_configure(config):
    config.stash[FIGURES] = []


def pytest_sessionfinish(session):
    path = session.config.getoption("--figures")
    if path:
        Path(path).write_text(json.dumps(session.config.stash[FIGURES], indent=1) + "\n")


@pytest.fixture
def figure(request):
    """Check a figure and keep it for the verification page (docs/make_verification.py).

    ``figure(what, got, expected, rel=..)``: within a share of the expected; ``absolute=..``: within
    an amount; ``at_most=..``: an error that must not pass a limit (nothing expected).
    """

    def check(what, got, expected=None, *, rel=None, absolute=None, at_most=None):
        got = float(got)
        if at_most is not None:
            tolerance, good = f"≤ {at_most:g}", got <= at_most
        elif rel is not None:
            tolerance, good = f"± {100 * rel:g} %", abs(got - expected) <= rel * abs(expected)
        else:
            tolerance, good = f"± {absolute:g}", abs(got - expected) <= absolute
        callspec = getattr(request.node, "callspec", None)
        request.config.stash[FIGURES].append(
            {
                "page": request.node.path.stem.removeprefix("test_"),
                "test": request.node.originalname,
                "case": callspec.id if callspec else "",
                "what": what,
                "expected": expected,
                "got": got,
                "tolerance": tolerance,
            }
        )
        assert good, f"{what}: got {got:.6g}, expected {expected}, allowed {tolerance}"

    return check


def pytest_addoption(parser):
    parser.addoption("--figures", default=None, help="write every checked figure to this file")
    parser.addoption("--run-slow", action="store_true", help="run the long studies too")


def pytest_collection_modifyitems(config, items):
    if not config.getoption("--run-slow"):
        skip = pytest.mark.skip(reason="a long study: --run-slow runs it")
        for item in items:
            if "slow" in item.keywords:
                item.add_marker(skip)


def required(module):
    """Import a module of the ``test`` extra; where it is missing skip, or fail if all must run."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        unless_required(f"{module} is not installed: {error}")


def unless_required(why):
    """Skip, or fail where TLEDFACE_REQUIRE_OPENCL=1 says that all of it must run."""
    if os.environ.get("TLEDFACE_REQUIRE_OPENCL") == "1":
        pytest.fail(f"needed here: {why}")
    pytest.skip(why)


def pytest_sessionstart(session):
    if os.environ.get("TLEDFACE_REQUIRE_OPENCL") == "1" and len(EXECUTORS) == 1:
        raise pytest.UsageError(
            "TLEDFACE_REQUIRE_OPENCL=1, but no OpenCL device works here: see `tledface doctor`"
        )


@pytest.fixture(params=EXECUTORS, ids=str)
def executor(request):
    """Every executor that works on this machine."""
    return request.param


@pytest.fixture
def opencl():
    """The id of an OpenCL device, a GPU where there is one."""
    found = [d for d in devices() if d.works and d.id.startswith("opencl")]
    if not found:
        unless_required("no OpenCL device works")
    return min(found, key=lambda d: d.kind != "gpu").id


@pytest.fixture(scope="session")
def shared_data():
    """The folder of real anatomy, where this machine has it."""
    return _shared("data", "anatomy surfaces")


@pytest.fixture(scope="session")
def shared_refs():
    """The folder of independent reference results, where this machine has it."""
    return _shared("refs", "independent reference results")


def _shared(folder, what):
    path = Path(os.environ.get("TLEDFACE_SHARED") or REPOSITORY.parent / "shared") / folder
    if not path.is_dir():
        pytest.skip(f"{what} are not on this machine")
    return path
