"""The menu of developer commands: ``nox -s tests``, ``lint``, ``types``, ``bench``."""

from __future__ import annotations

import nox

nox.options.sessions = ["lint", "types", "tests"]
nox.options.reuse_existing_virtualenvs = True

PYTHON_SOURCES = ("python", "tests", "noxfile.py")


@nox.session
def tests(session: nox.Session) -> None:
    """Build, install and run all tests; arguments go to pytest."""
    session.install(".[test]")
    session.run("pytest", *session.posargs)


@nox.session
def lint(session: nox.Session) -> None:
    """Check style and format of Python and C++; ``nox -s lint -- --fix`` repairs."""
    session.install("ruff>=0.6", "clang-format>=18,<19")
    fix = "--fix" in session.posargs
    session.run("ruff", "check", *(["--fix"] if fix else []), *PYTHON_SOURCES)
    session.run("ruff", "format", *([] if fix else ["--check"]), *PYTHON_SOURCES)
    listed = session.run("git", "ls-files", "*.cpp", "*.hpp", external=True, silent=True, log=False)
    sources = str(listed or "").split()
    if sources:
        how = ["-i"] if fix else ["--dry-run", "--Werror"]
        session.run("clang-format", *how, *sources)


@nox.session
def types(session: nox.Session) -> None:
    """Check types, strictly."""
    session.install(".", "mypy>=1.11")
    session.run("mypy", *session.posargs)


@nox.session
def bench(session: nox.Session) -> None:
    """Measure element steps per second; arguments go to ``tledface bench``."""
    session.install(".")
    session.run("tledface", "bench", *session.posargs)
