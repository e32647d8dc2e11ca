"""The committed stub of the compiled module says what the module has: names, members, arguments."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import tledface
from tledface import _core

PACKAGE = Path(tledface.__file__).parent


def stub_members(body):
    """Name -> its last definition; names of the stub's own types start with an underscore."""
    return {node.name: node for node in body if isinstance(node, (ast.ClassDef, ast.FunctionDef))}


STUB = {
    name: node
    for name, node in stub_members(ast.parse((PACKAGE / "_core.pyi").read_text()).body).items()
    if not name.startswith("_")
}


def compiled_members(owner):
    """Name -> what pybind11 put there; nothing that Python or pybind11 adds to every object."""
    return {
        name: value
        for name, value in vars(owner).items()
        if (name == "__init__" and type(value).__name__ == "instancemethod")
        or not (name.startswith("__") or name.startswith("_pybind11"))
    }


def signature_of(function):
    """The signature that pybind11 writes as the first line of the docstring."""
    return ast.parse(f"def {function.__doc__.strip().splitlines()[0]}: ...").body[0]


def arguments_of(node, *, skip_self):
    """[(name, default)] of the positional and keyword-only arguments; positional-only is None."""
    spec = node.args
    positional = [*spec.posonlyargs, *spec.args]
    defaults = [None] * (len(positional) - len(spec.defaults)) + list(spec.defaults)
    both = [
        list(zip(positional, defaults, strict=True))[1 if skip_self else 0 :],
        list(zip(spec.kwonlyargs, spec.kw_defaults, strict=True)),
    ]

    def name(argument):
        anonymous = argument in spec.posonlyargs or argument.arg.startswith("arg")
        return None if anonymous else argument.arg

    return [
        [(name(argument), default and ast.literal_eval(default)) for argument, default in group]
        for group in both
    ]


def test_every_name_of_the_module_is_in_the_stub_and_no_other():
    assert set(compiled_members(_core)) == set(STUB)


@pytest.mark.parametrize(
    "name", [name for name, value in vars(_core).items() if inspect.isclass(value)]
)
def test_every_member_of_a_class_is_in_the_stub_and_no_other(name):
    compiled = compiled_members(getattr(_core, name))
    stub = stub_members(STUB[name].body)
    assert set(compiled) == set(stub)
    for member, value in compiled.items():
        is_property = [ast.unparse(d) for d in stub[member].decorator_list]
        if isinstance(value, property):
            assert is_property == ([f"{member}.setter"] if value.fset else ["property"]), member
        else:
            assert not is_property, member
            assert arguments_of(signature_of(value), skip_self=True) == arguments_of(
                stub[member], skip_self=True
            ), member


@pytest.mark.parametrize(
    "name", [name for name, value in vars(_core).items() if inspect.isbuiltin(value)]
)
def test_functions_take_the_arguments_of_the_stub(name):
    compiled = arguments_of(signature_of(getattr(_core, name)), skip_self=False)
    assert compiled == arguments_of(STUB[name], skip_self=False)


def test_bases_of_the_errors():
    for name in ("InputError", "SimulationError"):
        bases = [base.__name__ for base in getattr(_core, name).__bases__]
        assert bases == [ast.unparse(base) for base in STUB[name].bases]


def test_the_package_says_that_it_is_typed():
    assert (PACKAGE / "py.typed").exists()


def test_the_compiled_module_alone_does_not_import_numpy():
    """A default that is an array would: `--help` took three times as long, doctor needed NumPy."""
    code = "import sys; from tledface import _core; sys.exit('numpy' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
