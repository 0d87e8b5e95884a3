"""Compiled functions kept on disk follow changes of the functions that they call."""

import os
import subprocess
import sys
from pathlib import Path

from rover_sim.physics import compiled, energy_momentum, planar

FOLDER = Path(compiled.__file__).parent


def test_sources_are_followed_through_imports() -> None:
    names = {path.name for path in compiled.sources_of(FOLDER / "planar.py")}
    assert {"planar.py", "planar_rover.py", "energy_momentum.py", "packets.py"} <= names
    assert "statics.py" not in names
    own = compiled.source_stamp(FOLDER / "energy_momentum.py")
    assert energy_momentum.newton_increment._cache._cache_file._source_stamp == own
    assert planar.advance._cache._cache_file._source_stamp != own


def test_a_changed_callee_in_another_file_is_compiled_anew(tmp_path: Path) -> None:
    package = tmp_path / "rover_sim" / "physics"
    package.mkdir(parents=True)
    (package.parent / "__init__.py").touch()
    (package / "__init__.py").touch()
    (package / "compiled.py").write_bytes((FOLDER / "compiled.py").read_bytes())
    header = "from rover_sim.physics.compiled import kernel\n"
    (package / "caller.py").write_text(
        header + "from rover_sim.physics.callee import inner\n\n"
        "@kernel\ndef outer(x):\n    return inner(x)\n"
    )

    program = (
        "from rover_sim.physics.caller import outer\n"
        "print(outer(1.0), sum(outer.stats.cache_hits.values()))"
    )

    def run(factor: float) -> tuple[float, int]:
        (package / "callee.py").write_text(
            header + f"\n@kernel\ndef inner(x):\n    return {factor} * x\n"
        )
        done = subprocess.run(
            [
                sys.executable,
                "-c",
                program,
            ],
            cwd=tmp_path,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": "."},
            capture_output=True,
            text=True,
            check=True,
        )
        value, hits = done.stdout.split()
        return float(value), int(hits)

    assert run(2.0) == (2.0, 0)
    assert run(2.0) == (2.0, 1)
    assert run(3.0) == (3.0, 0)
