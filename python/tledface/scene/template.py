"""The commented scene that ``tledface new`` writes."""

from __future__ import annotations

import os
import tempfile
from importlib import resources
from pathlib import Path

from tledface.errors import InputError

__all__ = ["template_text", "write_template"]


def template_text() -> str:
    """A commented scene; valid once its surface files exist."""
    return resources.files(__package__).joinpath("template.toml").read_text(encoding="utf-8")


def write_template(path: Path) -> None:
    """Write the commented scene to a new file; raises InputError if ``path`` exists already."""
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; make it first")
    handle, temporary = tempfile.mkstemp(prefix=path.name, suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(template_text())
        os.chmod(temporary, 0o644)
        # A link fails where the name has appeared meanwhile; a rename would overwrite it.
        os.link(temporary, path)
    except FileExistsError:
        raise InputError(
            f"{path}: exists already; give a new file name, or remove it first"
        ) from None
    finally:
        os.unlink(temporary)
