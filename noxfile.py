"""The menu of developer commands: ``nox -s tests``, ``lint``, ``types``, ``cpp``, ``bench``."""

from __future__ import annotations

import nox

nox.options.sessions = ["lint", "types", "tests"]
nox.options.reuse_existing_virtualenvs = True


@nox.session
def tests(session: nox.Session) -> None:
    """Build, install and run all tests; arguments go to pytest."""
    session.install(".[test]")
    session.run("pytest", *session.posargs)


@nox.session
def lint(session: nox.Session) -> None:
    """Check style and format, and repair what can be; arguments go to ``pre-commit run``."""
    session.install("pre-commit>=3.7")
    session.run("pre-commit", "run", "--all-files", "--show-diff-on-failure", *session.posargs)


@nox.session
def types(session: nox.Session) -> None:
    """Check types, strictly; nothing is built, the stub speaks for the compiled module."""
    project = nox.project.load_toml("pyproject.toml")["project"]
    session.install("mypy>=2.1", *project["dependencies"])
    session.run("mypy", *session.posargs)


@nox.session
def cpp(session: nox.Session) -> None:
    """Build the C++ tests with sanitizers and warnings as errors, and run them."""
    session.install("cmake>=3.24", "ninja")
    session.run("cmake", "--preset", "asan", "-G", "Ninja")
    session.run("cmake", "--build", "--preset", "asan", *session.posargs)
    session.run("ctest", "--preset", "asan")


@nox.session
def bench(session: nox.Session) -> None:
    """Measure element steps per second; arguments go to ``tledface bench``."""
    session.install(".")
    session.run("tledface", "bench", *session.posargs)
