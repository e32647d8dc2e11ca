"""The two errors that reach a user; each message is one complete line."""

from tledface._core import InputError, SimulationError

__all__ = ["InputError", "SimulationError"]
