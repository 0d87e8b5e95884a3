"""Interface packages that PyPI does not have: `tf2_msgs`, and `mother_rover_interfaces`.

A sourced ROS 2 has them, or `colcon build` makes them. The wheels from PyPI contain the generators
of rosidl: with them and a compiler a package is built once, in some seconds, and kept in the
user's cache. The generators need an ament index, which the wheels do not announce, so a child
process runs this module:

    python -m rover_runtime.ros.interface_packages SOURCE TARGET
"""

from __future__ import annotations

import hashlib
import importlib
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import numpy as np

from msg_schemas.file_lock import lock_file

SOURCES = Path(__file__).with_name("interfaces")
"""Folder of the packages that can be built."""

_POLL_PERIOD = 0.1  # [s]
_SUPPORTS = ["rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"]

_INIT = """import ctypes
from pathlib import Path

for library in Path(__file__).parent.glob("lib*.so"):
    ctypes.CDLL(str(library))
"""


class InterfacesMissing(ImportError):
    """A package can be neither imported nor built; the message has the remedy."""


def load_interfaces(
    name: str,
    module: str,
    report: Callable[[str], None],
    check: Callable[[], None] = lambda: None,
) -> ModuleType:
    """Import a module of an interface package; build the package if need be.

    Args:
        name: of the package, such as `tf2_msgs`.
        module: within the package, such as `msg`.
        report: called before the package is built.
        check: called meanwhile; what it raises ends the build.

    Raises:
        InterfacesMissing: the package is not installed, and there is no compiler, or it fails, or
            the cache cannot be written.
    """
    try:
        return importlib.import_module(f"{name}.{module}")
    except ModuleNotFoundError:
        try:
            folder = _built(SOURCES / name, Path(sys.prefix), report, check)
        except OSError as error:
            raise InterfacesMissing(f"{name} cannot be built: {error}") from error
    sys.path.append(str(folder))
    importlib.invalidate_caches()
    return importlib.import_module(f"{name}.{module}")


def _built(
    source: Path, prefix: Path, report: Callable[[str], None], check: Callable[[], None]
) -> Path:
    """Return the folder of the built package."""
    if not (prefix / "share" / "rosidl_generator_py").is_dir():
        raise InterfacesMissing(f"{source.name} cannot be imported: build or install this package")
    if not (shutil.which("gcc") and shutil.which("g++")):
        raise InterfacesMissing(
            f"{source.name} cannot be built, for there is no compiler: install gcc and g++"
        )
    contents = [each.read_bytes() for each in sorted(source.rglob("*")) if each.is_file()]
    made_by = f"{sys.version} {prefix} {np.__version__} {version('ros-jazzy-rclpy')}".encode()
    key = hashlib.sha256(b"\0".join([*contents, Path(__file__).read_bytes(), made_by]))
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mother_rover"
    folder = cache / f"{source.name}_{key.hexdigest()[:16]}"
    if folder.is_dir():
        return folder
    cache.mkdir(parents=True, exist_ok=True)

    def cancelled() -> bool:
        check()
        return False

    with (cache / f"{source.name}.lock").open("w") as lock:
        lock_file(lock, cancelled)
        if not folder.is_dir():
            report(f"building {source.name} into {folder}, once")
            with tempfile.TemporaryDirectory(dir=cache, ignore_cleanup_errors=True) as made:
                _build_in_child(source, made, check)
                # At once: a folder that is there is whole.
                whole = Path(made) / folder.name
                whole.mkdir()
                (Path(made) / source.name).rename(whole / source.name)
                whole.rename(folder)
    return folder


def _build_in_child(source: Path, target: str, check: Callable[[], None]) -> None:
    """Build in a child process, which ends with its compilers where `check` raises."""
    command = [sys.executable, "-m", __name__, str(source), target]
    child = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    errors = None
    try:
        while errors is None:
            try:
                _, errors = child.communicate(timeout=_POLL_PERIOD)
            except subprocess.TimeoutExpired:
                check()
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
            child.communicate()
    if child.returncode:
        reason = errors.strip().splitlines()[-1:]
        raise InterfacesMissing(f"{source.name} cannot be built: {' '.join(reason)}")


def build(source: Path, target: Path, prefix: Path) -> None:
    """Build the importable package TARGET/NAME of an interface package.

    Args:
        source: folder of the package, with the folders ``msg`` or ``action``; its name is NAME.
        target: existing folder.
        prefix: of ROS, with ``share``, ``include`` and ``lib``.

    Raises:
        subprocess.CalledProcessError: the compiler fails.
    """
    os.environ["AMENT_PREFIX_PATH"] = str(prefix)
    # They are imported here: a sourced ROS 2 need not have them.
    from rosidl_adapter.action import convert_action_to_idl  # noqa: PLC0415
    from rosidl_adapter.msg import convert_msg_to_idl  # noqa: PLC0415
    from rosidl_generator_c.cli import GenerateC  # noqa: PLC0415
    from rosidl_generator_py.cli import GeneratePython  # noqa: PLC0415
    from rosidl_generator_type_description.cli import HashTypeDescription  # noqa: PLC0415
    from rosidl_typesupport_c.cli import GenerateCTypesupport  # noqa: PLC0415
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport  # noqa: PLC0415
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport  # noqa: PLC0415

    name, package = source.name, target / source.name
    work = target / "build" / name
    include_paths = sorted(str(each.parent) for each in (prefix / "share").glob("*/msg"))
    definitions = []
    for kind, convert in (("msg", convert_msg_to_idl), ("action", convert_action_to_idl)):
        for each in sorted(source.glob(f"{kind}/*.{kind}")):
            made = convert(source, name, each.relative_to(source), work / kind)
            definitions.append(f"{work}:{made.relative_to(work)}")
    common = {
        "package_name": name,
        "interface_files": definitions,
        "include_paths": include_paths,
        "output_path": work,
    }
    hashes = HashTypeDescription("hash").generate_type_hashes(**common)
    GenerateC("c").generate(**common, type_description_files=hashes)
    GenerateCTypesupport("c", typesupport_implementations=_SUPPORTS).generate(**common)
    GenerateFastRTPSCTypesupport("fastrtps").generate(**common)
    # Its files have the names of others.
    other = {**common, "output_path": target / "introspection" / name}
    GenerateIntrospectionCTypesupport("introspection").generate(**other)
    python = GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"])
    python.generate(**{**common, "output_path": package})
    _compile(name, target, prefix)


def _compile(name: str, target: Path, prefix: Path) -> None:
    """Compile everything that was generated into the one module that the package imports."""
    package, generated = target / name, (target / "build", target / "introspection")
    sources = sorted(each for suffix in ("c", "cpp") for each in target.rglob(f"*.{suffix}"))
    include = prefix / "include"
    headers = [include, *sorted(include.iterdir()), Path(sysconfig.get_path("include"))]
    includes = [f"-I{each}" for each in (*generated, *headers, np.get_include())]

    def compile_one(number: int, source: Path) -> str:
        compiler = "g++" if source.suffix == ".cpp" else "gcc"
        made = str(target / f"{number}.o")
        _run(compiler, "-c", "-O1", "-w", "-fPIC", *includes, str(source), "-o", made)
        return made

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        objects = list(pool.map(compile_one, range(len(sources)), sources))
    kinds = ("generator_c", "generator_py", "typesupport_c", *(each[7:] for each in _SUPPORTS))
    lib = prefix / "lib"
    linked = [str(each) for kind in kinds for each in sorted(lib.glob(f"lib*__rosidl_{kind}.so"))]
    linked += [f"-l{each}" for each in ("rosidl_runtime_c", "rosidl_typesupport_c", *_SUPPORTS)]
    linked += ["-lfastcdr", "-lrmw", "-lrcutils"]
    module = f"{name}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    paths = [f"-L{lib}", f"-Wl,-rpath,{lib}", "-Wl,--as-needed"]
    _run("g++", "-shared", *objects, *paths, *linked, "-o", str(package / module))
    for support in _SUPPORTS:
        # The middleware finds them by these names where they are loaded, and in them the module.
        alias = f"lib{name}__{support}.so"
        named = [f"-Wl,-soname,{alias}", "-Wl,-rpath,$ORIGIN", "-Wl,--no-as-needed"]
        _run("g++", "-shared", *named, f"-L{package}", f"-l:{module}", "-o", str(package / alias))
    (package / "__init__.py").write_text(_INIT)


def _run(*command: str) -> None:
    subprocess.run(command, check=True)


if __name__ == "__main__":
    build(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.prefix))
