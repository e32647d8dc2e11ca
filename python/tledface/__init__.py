"""Physically based soft tissue and faces, from surfaces to wrinkles."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tledface import metrics as metrics
    from tledface.constitutive import Material as Material
    from tledface.constitutive import material as material
    from tledface.constitutive import materials as materials
    from tledface.device import Device as Device
    from tledface.device import devices as devices
    from tledface.errors import InputError as InputError
    from tledface.errors import SimulationError as SimulationError
    from tledface.model import Model as Model
    from tledface.motion import RigidMotion as RigidMotion
    from tledface.scene import Scene as Scene
    from tledface.schedule import ramp as ramp
    from tledface.simulator import Simulator as Simulator

# Where each public name lives. Modules load when a name is first used: `import tledface` and the
# command line's --help stay quick.
_HOMES = {
    "Device": "tledface.device",
    "InputError": "tledface.errors",
    "Material": "tledface.constitutive",
    "Model": "tledface.model",
    "Scene": "tledface.scene",
    "SimulationError": "tledface.errors",
    "Simulator": "tledface.simulator",
    "devices": "tledface.device",
    "material": "tledface.constitutive",
    "materials": "tledface.constitutive",
    "metrics": "tledface.metrics",
    "RigidMotion": "tledface.motion",
    "ramp": "tledface.schedule",
}
_MODULES = {"metrics"}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("tledface")
    if name not in _HOMES:
        raise AttributeError(f"module 'tledface' has no attribute {name!r}")
    module = import_module(_HOMES[name])
    value = module if name in _MODULES else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
