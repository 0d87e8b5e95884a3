"""Functions cached on disk are recompiled after a change of the functions that they call."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rover_sim.physics.integrators import planar
from rover_sim.physics.numerics import compiled
from rover_sim.physics.tether import energy_momentum

NUMERICS = Path(compiled.__file__).parent


def test_sources_are_followed_through_imports() -> None:
    names = {path.name for path in compiled.sources_of(Path(planar.__file__))}
    assert {"planar.py", "planar_rover.py", "energy_momentum.py", "simd.py"} <= names
    assert "statics.py" not in names
    own = compiled.source_stamp(Path(energy_momentum.__file__))
    assert energy_momentum.newton_increment._cache._cache_file._source_stamp == own
    assert planar.advance._cache._cache_file._source_stamp != own


class Package:
    """A callee and its callers as modules of their own, run in fresh processes."""

    HEADER = "from rover_sim.physics.numerics.compiled import inner, kernel\n"
    CALLER = HEADER + "{}\n\n@kernel\ndef outer(x):\n    return {}(x)\n"
    CALLED = "from rover_sim.physics.one.callee import called", "called"

    def __init__(self, root: Path) -> None:
        self._root = root
        physics = root / "rover_sim" / "physics"
        self._folder = physics / "one"
        self._other_folder = physics / "two"
        numerics = physics / "numerics"
        for folder in (self._folder, self._other_folder, numerics):
            folder.mkdir(parents=True)
        for folder in (physics.parent, physics, self._folder, self._other_folder, numerics):
            (folder / "__init__.py").touch()
        for name in ("compiled.py", "compilers.py"):
            (numerics / name).write_bytes((NUMERICS / name).read_bytes())
        for name in ("caller", "other"):
            self.write_caller(name)

    def write_caller(self, name: str, called: tuple[str, str] = CALLED) -> None:
        """A module that calls the callee from another folder; the import, and the callee's name."""
        (self._other_folder / f"{name}.py").write_text(self.CALLER.format(*called))

    def write(self, kind: str, factor: float) -> None:
        """The callee."""
        (self._folder / "callee.py").write_text(
            f"{self.HEADER}\n@{kind}\ndef called(x):\n    return {factor} * x\n"
        )

    def export_called(self) -> None:
        """Let the callee's folder offer it itself."""
        (self._folder / "__init__.py").write_text(
            "from rover_sim.physics.one.callee import called\n"
        )

    def write_typed(self, kind: str, name: str) -> None:
        """A module whose function takes a named tuple."""
        (self._other_folder / "typed.py").write_text(
            "from typing import NamedTuple\n"
            f"{self.HEADER}\nclass {name}(NamedTuple):\n    x: float\n    y: float\n\n"
            f"@{kind}\ndef total(pair):\n    return pair.x + pair.y\n\n"
            f"@kernel\ndef outer(x):\n    return total({name}(x, 2.0 * x))\n"
        )

    def write_long(self, kind: str) -> None:
        """A callee that is too long to be inlined."""
        terms = " + ".join(f"math.sin({k} * x)" for k in range(60))
        (self._folder / "callee.py").write_text(
            f"import math\n\n{self.HEADER}\n@{kind}\ndef called(x):\n    return {terms}\n"
        )

    def run(self, module: str, function: str) -> tuple[float, int]:
        """Result of a function for 1.0, and the number of cache hits."""
        value, hits = self.printed(
            f"from rover_sim.physics.{self._room(module)} import {module}\n"
            f"print({module}.{function}(1.0), sum({module}.{function}.stats.cache_hits.values()))"
        )
        return float(value), int(hits)

    def linkages(self, module: str, function: str) -> list[str]:
        """Linkages of the functions in the machine code of a function for 1.0."""
        return self.printed(
            f"from rover_sim.physics.{self._room(module)} import {module}\n"
            f"{module}.{function}(1.0)\n"
            f"(result,) = {module}.{function}.overloads.values()\n"
            "defined = result.library.get_defined_functions()\n"
            "print(*(function.linkage.name for function in defined))"
        )

    def _room(self, module: str) -> str:
        return "one" if (self._folder / f"{module}.py").exists() else "two"

    def printed(self, program: str) -> list[str]:
        """The words that a program prints in a process of its own."""
        done = subprocess.run(
            [sys.executable, "-c", program],
            cwd=self._root,
            env={
                **os.environ,
                "NUMBA_CACHE_DIR": str(self._root / "cache"),
                "PYTHONPATH": ".",
                # Bytecode is not renewed for a file of the same size written in the same second.
                "PYTHONDONTWRITEBYTECODE": "1",
            },
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.split()


@pytest.fixture
def package(tmp_path: Path) -> Package:
    return Package(tmp_path)


@pytest.mark.parametrize("kind", ["kernel", "inner"])
@pytest.mark.slow
def test_a_change_of_a_callee_in_another_file_recompiles_its_callers(package: Package, kind: str):
    for factor, hits in ((2.0, 0), (2.0, 1), (3.0, 0)):
        package.write(kind, factor)
        assert package.run("caller", "outer") == (factor, hits)


@pytest.mark.parametrize(
    "called",
    [
        ("from rover_sim.physics.one import callee", "callee.called"),
        ("from rover_sim.physics.one import callee as room", "room.called"),
        ("from rover_sim.physics.one.callee import (\n    called as its,\n)", "its"),
        ("import rover_sim.physics.one.callee\nits = rover_sim.physics.one.callee.called", "its"),
        ("from rover_sim.physics.one import called", "called"),
    ],
    ids=lambda called: called[0].partition("\n")[0],
)
@pytest.mark.slow
def test_a_callee_in_another_folder_is_followed_by_any_form_of_import(
    package: Package, called: tuple[str, str]
):
    package.write_caller("caller", called)
    package.export_called()
    for factor, hits in ((2.0, 0), (2.0, 1), (3.0, 0)):
        package.write("kernel", factor)
        assert package.run("caller", "outer") == (factor, hits)


@pytest.mark.parametrize("kind", ["kernel", "inner"])
def test_a_cache_that_names_a_removed_type_is_recompiled(package: Package, kind: str):
    for name in ("Pair", "Couple"):
        package.write_typed(kind, name)
        assert package.run("typed", "outer") == (3.0, 0)


@pytest.mark.slow
def test_inner_functions_are_linked_from_the_cache_and_callable_from_python(
    package: Package,
):
    package.write("inner", 2.0)
    assert package.run("caller", "outer") == (2.0, 0)
    assert package.run("callee", "called") == (2.0, 1)
    assert package.run("other", "outer") == (2.0, 0)
    assert package.run("other", "outer") == (2.0, 1)


@pytest.mark.parametrize("kind", ["kernel", "inner"])
def test_a_caller_has_its_own_copy_of_a_linked_function(package: Package, kind: str):
    """A weak symbol would be that of the library that a process happens to load first."""
    package.write_long(kind)
    linkages = package.linkages("caller", "outer")
    assert linkages.count("internal") == 1
    assert set(linkages) == {"internal", "external"}
