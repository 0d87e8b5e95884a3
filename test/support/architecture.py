"""The house's rules, checked on source text: nothing of ours and no ROS is imported here.

Each check takes the root of a tree and returns one sentence per violation, naming file and line.
"""

import ast
import functools
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

# Who may import whom among the top-level packages; each may import itself.
ARROWS: dict[str, set[str]] = {
    "msg_schemas": set(),
    "rover_runtime": {"msg_schemas"},
    "rover_sim": {"msg_schemas", "rover_runtime"},
    "rover_control": {"msg_schemas", "rover_runtime"},
    "tether_winch": {"msg_schemas", "rover_runtime"},
    "rover_hil": {"msg_schemas", "rover_runtime"},
    "rover_launch": {"msg_schemas", "rover_runtime"},
    "rover_view": {"msg_schemas", "rover_runtime"},
    "rover_actions": {"msg_schemas", "rover_runtime"},
    "rover_cli": {
        "msg_schemas",
        "rover_runtime",
        "rover_launch",
    },  # it imports what implements a subcommand by name
    "rover_estimation": set(),
    "rover_bags": {"msg_schemas", "rover_runtime", "rover_sim", "rover_estimation"},
    "operator_console": {"msg_schemas", "rover_runtime", "rover_bags"},
    "rover_studies": {"msg_schemas", "rover_sim"},
    "rover_validation": {"msg_schemas", "rover_sim", "rover_estimation"},
    "rover_verify": {
        "msg_schemas",
        "rover_runtime",
        "rover_sim",
        "rover_control",
        "rover_hil",
        "tether_winch",
        "rover_bags",
        "operator_console",
        "rover_launch",
        "rover_studies",
        "rover_validation",
    },
}
# Within a package: what knows nothing of the package but what is named here.
LAYERS: dict[str, set[str]] = {
    "rover_bags.files": set(),
    "rover_bags.analysis": {"rover_bags.reading"},
}
# Modules or rooms that may follow one arrow more.
EXCEPTIONS: dict[str, set[str]] = {"rover_control.prediction": {"rover_sim"}}
# Folders whose modules may, and whom the rest of their package does not know: devices that are not
# there are played by the simulator.
EXCEPTIONAL_FOLDERS: dict[str, set[str]] = {"rover_hil.emulator": {"rover_sim"}}
# Outside its own package, rover_sim is used by its public face alone, except by the verification,
# whose benches look inside.
PUBLIC_FACE = "rover_sim"
LOOKS_INSIDE = {"rover_sim", "rover_verify"}
# The physics is numerics: of ours it knows itself and the base of configurations, which checks
# parameters and has no input or output.
PHYSICS = "rover_sim.physics"
USED_BY_PHYSICS = {"msg_schemas.configuration"}
NOT_IN_PHYSICS = {"rclpy", "yaml", "matplotlib", "rosbags", "mcap"}
PAGE = 80
"""Most lines of a function, its docstring included."""
MOST_METHODS = 40
"""Of a class."""

# What an import needs: distribution on PyPI (empty: not there), key of rosdep (empty: not a package
# of Ubuntu; each message package besides).
REQUIREMENTS: dict[str, tuple[str, str]] = {
    "PIL": ("pillow", "python3-pil"),
    "can": ("python-can", "python3-can"),
    "canopen": ("canopen", ""),
    "cobs": ("cobs", ""),
    "argcomplete": ("argcomplete", "python3-argcomplete"),
    "ament_index_python": ("ros-jazzy-rclpy", "ament_index_python"),
    "distributed": ("dask", ""),
    "exudyn": ("exudyn", ""),
    "launch": ("", "launch"),  # come with ROS 2 alone
    "launch_ros": ("", "launch_ros"),
    "hypothesis": ("hypothesis", "python3-hypothesis"),
    "llvmlite": ("numba", ""),  # numba's own code generator
    "lz4": ("lz4", ""),
    "matplotlib": ("matplotlib", "python3-matplotlib"),
    "mcap": ("mcap", ""),
    "mcap_ros2": ("mcap-ros2-support", ""),
    "numba": ("numba", ""),
    "numpy": ("numpy", "python3-numpy"),
    "playwright": ("playwright", ""),  # tests skip without it
    "pyarrow": ("pyarrow", ""),
    "pytest": ("pytest", "python3-pytest"),
    "rclpy": ("ros-jazzy-rclpy", "rclpy"),
    "rich": ("rich", "python3-rich"),
    "rosbags": ("rosbags", ""),
    "scipy": ("scipy", "python3-scipy"),
    "serial": ("pyserial", "python3-serial"),
    "tornado": ("tornado", "python3-tornado"),
    "tf2_msgs": ("", "tf2_msgs"),  # where ROS 2 is sourced
    "tqdm": ("tqdm", "python3-tqdm"),
    "yaml": ("pyyaml", "python3-yaml"),
    "zstandard": ("zstandard", ""),
}
# Stands for types while they are checked, never imported at run time.
TYPES_ONLY = {"_typeshed"}


@dataclass(frozen=True)
class Import:
    """One imported module, as `importer` writes it."""

    importer: str
    target: str
    place: str


def python_files(root: Path, *folders: str) -> list[Path]:
    """Return the Python files below the folders of `root` that exist, sorted."""
    return sorted(path for folder in folders for path in (root / folder).rglob("*.py"))


def parse(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return _parsed(path.read_text(encoding="utf-8"))


@functools.cache
def _parsed(text: str) -> ast.Module:
    return ast.parse(text)


@functools.cache
def _nodes(text: str) -> list[ast.AST]:
    """All nodes of the syntax tree of a source."""
    return list(ast.walk(_parsed(text)))


def syntax_nodes(path: Path) -> list[ast.AST]:
    """Return all nodes of the syntax tree of a file."""
    return _nodes(path.read_text(encoding="utf-8"))


@functools.cache
def _imports_of(text: str) -> list[tuple[int, str, tuple[str, ...]]]:
    """Line, module (empty = none) and names of each import of a source."""
    found = []
    for node in _nodes(text):
        if isinstance(node, ast.Import | ast.ImportFrom):
            module = (node.module or "") if isinstance(node, ast.ImportFrom) else ""
            found.append((node.lineno, module, tuple(alias.name for alias in node.names)))
    return found


def module_name(root: Path, path: Path) -> str:
    """Return the dotted name under which the file is imported."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(root: Path) -> list[Import]:
    """Return every import of our packages, those inside functions and type checks included.

    `from package import name` counts as an import of `package.name` if that is a module of ours.
    """
    files = python_files(root, *ARROWS)
    modules = {module_name(root, path) for path in files}
    found = []
    for path in files:
        for line, base, given in _imports_of(path.read_text(encoding="utf-8")):
            targets = list(given)
            if base:
                names = [f"{base}.{name}" for name in given]
                inner = [name for name in names if name in modules]
                targets = inner + ([base] if len(inner) < len(names) else [])
            place = f"{path.relative_to(root)}:{line}"
            found += [Import(module_name(root, path), target, place) for target in targets]
    return found


def top(name: str) -> str:
    """Return the top-level package of a dotted name."""
    return name.partition(".")[0]


def _is_in(name: str, folder: str) -> bool:
    return (name + ".").startswith(folder + ".")


def forbidden_arrows(root: Path) -> list[str]:
    """Imports among our packages that the house does not allow."""
    found = []
    for each in imports(root):
        if top(each.target) not in ARROWS:
            continue
        if top(each.target) == top(each.importer):
            if any(
                _is_in(each.target, folder) and not _is_in(each.importer, folder)
                for folder in EXCEPTIONAL_FOLDERS
            ):
                found.append(f"{each.place}: {each.importer} must not import {each.target}")
            continue
        allowed = ARROWS[top(each.importer)]
        for folder, more in (EXCEPTIONS | EXCEPTIONAL_FOLDERS).items():
            if _is_in(each.importer, folder):
                allowed = allowed | more
        if top(each.target) not in allowed:
            found.append(f"{each.place}: {each.importer} must not import {each.target}")
        elif each.target.startswith(PUBLIC_FACE + ".") and top(each.importer) not in LOOKS_INSIDE:
            found.append(
                f"{each.place}: {each.importer} imports {each.target}; "
                f"use what {PUBLIC_FACE} itself offers"
            )
    return found


def forbidden_layers(root: Path) -> list[str]:
    """Imports within a package from a layer to one that stands above it."""
    return [
        f"{each.place}: {layer} must not import {each.target}"
        for each in imports(root)
        for layer, allowed in LAYERS.items()
        if each.importer.startswith(layer + ".")
        and top(each.target) == top(layer)
        and not any((each.target + ".").startswith(name + ".") for name in allowed | {layer})
    ]


def impure_physics(root: Path) -> list[str]:
    """Imports of the physics that are not numerics: ROS, files, or the rest of the suite."""
    return [
        f"{each.place}: physics must not import {each.target}"
        for each in imports(root)
        if _is_in(each.importer, PHYSICS)
        and each.target not in USED_BY_PHYSICS
        and (
            top(each.target) in NOT_IN_PHYSICS
            or top(each.target).endswith(("_msgs", "_srvs"))
            or (top(each.target) in ARROWS and not _is_in(each.target, PHYSICS))
        )
    ]


def package_cycles(root: Path) -> list[str]:
    """Import cycles between top-level packages."""
    return _cycles(
        (top(each.importer), top(each.target))
        for each in imports(root)
        if top(each.target) in ARROWS and top(each.target) != top(each.importer)
    )


def room_cycles(root: Path) -> list[str]:
    """Import cycles between the folders of one package; what a folder holds directly counts."""
    folders = {
        module_name(root, path.parent / "__init__.py")
        for path in python_files(root, *ARROWS)
        if path.name == "__init__.py"
    }

    def room(name: str) -> str:
        return name if name in folders else name.rpartition(".")[0]

    return _cycles(
        (room(each.importer), room(each.target))
        for each in imports(root)
        if top(each.importer) == top(each.target)
        and each.importer not in folders  # a folder's face names what it holds
        and room(each.importer) != room(each.target)
    )


def _cycles(arrows: Iterable[tuple[str, str]]) -> list[str]:
    graph: dict[str, list[str]] = {}
    for start, end in sorted(set(arrows)):
        graph.setdefault(start, []).append(end)
    found = []
    waiting = dict(graph)
    while True:  # what has no arrow out, or none in, is on no cycle
        ends = {end for targets in waiting.values() for end in targets}
        left = {
            start: [end for end in targets if end in waiting]
            for start, targets in waiting.items()
            if start in ends and any(end in waiting for end in targets)
        }
        if left == waiting:
            break
        waiting = left
    for start in waiting:
        path = [start]
        while path[-1] not in path[:-1]:
            path.append(waiting[path[-1]][0])
        cycle = path[path.index(path[-1]) : -1]
        first = cycle.index(min(cycle))
        found.append(" -> ".join([*cycle[first:], *cycle[: first + 1]]))
    return sorted(set(found))


def constants(path: Path) -> dict[str, object]:
    """Return the module-level names of a file that are bound to literals."""
    values: dict[str, object] = {}
    for node in parse(path).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            try:
                values[node.targets[0].id] = ast.literal_eval(node.value)
            except ValueError:
                continue
    return values


def topic_names(root: Path) -> set[str]:
    """Return the names of all topics and services of the contract."""
    values = constants(root / "msg_schemas" / "topics.py").values()
    return {value for value in values if isinstance(value, str)}


_TAKES_TOPIC = (
    "publisher",
    "subscribe",
    "subscription",
    "service",
    "client",
    "serve",
    "encode",
    "decode",
)


def _takes_topic(node: ast.Call) -> bool:
    name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    return str(name).lower().endswith(_TAKES_TOPIC)


def topic_strings(root: Path) -> list[str]:
    """Topic names written out anywhere but in the contract.

    A name with a slash is found wherever it stands as a string, alone or behind a namespace; a name
    that is a plain word (`config`) is found where a call takes a topic.
    """
    names = topic_names(root)
    paths = {name.strip("/") for name in names if "/" in name.strip("/")}
    behind_namespace = tuple(f"/{name}" for name in paths)
    words = {name.strip("/") for name in names} - paths
    found = []
    folders = [folder for folder in ARROWS if folder != "msg_schemas"]
    for path in python_files(root, *folders, "launch", "test"):
        if path.is_relative_to(root / "test" / "msg_schemas"):
            continue
        for node in syntax_nodes(path):
            literals: list[ast.Constant] = []
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                text = node.value.strip("/")
                if text in paths or text.endswith(behind_namespace):
                    literals = [node]
            elif isinstance(node, ast.Call) and _takes_topic(node):
                literals = [
                    argument
                    for argument in [*node.args, *(keyword.value for keyword in node.keywords)]
                    if isinstance(argument, ast.Constant)
                    and isinstance(argument.value, str)
                    and argument.value.strip("/") in words
                ]
            found += [
                f"{path.relative_to(root)}:{literal.lineno}: topic {literal.value!r} written out; "
                "use msg_schemas.topics"
                for literal in literals
            ]
    return found


_MESSAGES = ("message", "reason")
_WORD_CARRIERS = ("name", "text", "phase", "mode", "winch", "descent", "drive", "jump")


def _words_of(root: Path, module: str) -> set[str]:
    """First strings of the members of a module's enumerations."""
    path = root / "msg_schemas" / module
    found: set[str] = set()
    if not path.exists():
        return found
    for statement in parse(path).body:
        for item in statement.body if isinstance(statement, ast.ClassDef) else ():
            value = item.value if isinstance(item, ast.Assign) else None
            first = value.elts[0] if isinstance(value, ast.Tuple) and value.elts else None
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                found.add(first.value)
    return found


def _comparisons(nodes: list[ast.AST]) -> Iterator[tuple[int, bool, list[ast.expr]]]:
    """Line, whether it is an equality, and operands of each comparison of texts."""
    for node in nodes:
        if isinstance(node, ast.Compare):
            equal = any(isinstance(op, ast.Eq | ast.NotEq) for op in node.ops)
            operands = [node.left, *node.comparators]
            sets = [each for each in operands if isinstance(each, ast.Tuple | ast.List | ast.Set)]
            yield node.lineno, equal, operands + [item for each in sets for item in each.elts]
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in ("startswith", "endswith")
        ):
            yield node.lineno, False, [node.func.value, *node.args]


def _attributes(operands: list[ast.expr]) -> set[str]:
    """Attributes that are compared, also as the elements of a list."""
    elements = [each.elt if isinstance(each, ast.ListComp) else each for each in operands]
    return {each.attr for each in elements if isinstance(each, ast.Attribute)}


def _is_text(value: object) -> bool:
    """Whether a literal may be a message for people; types of ROS messages are none."""
    return isinstance(value, str) and value != "" and "/msg/" not in value


def message_decisions(root: Path) -> list[str]:
    """Comparisons of messages for people with a literal: software decides on names and values.

    A test may assert that a value occurs in a message of a status or an event, but it does not
    find the status or the event by the message.
    """
    found = []
    for path in python_files(root, *ARROWS, "test", "tools"):
        is_test = path.is_relative_to(root / "test")
        nodes = syntax_nodes(path)
        for line, equal, operands in _comparisons(nodes):
            literal = any(
                isinstance(each, ast.JoinedStr)
                or (isinstance(each, ast.Constant) and _is_text(each.value))
                for each in operands
            )
            texts = _attributes(operands) & set(_MESSAGES[:1] if is_test else _MESSAGES)
            if literal and texts and (equal or not is_test):
                place = f"{path.relative_to(root)}:{line}"
                found.append(f"{place}: decides on the text of .{texts.pop()}")
        if is_test:
            found += [
                f"{path.relative_to(root)}:{line}: finds by the text of .message"
                for line in _searches(nodes)
            ]
    return found


def _searches(nodes: list[ast.AST]) -> Iterator[int]:
    """Lines that compare a message for people other than by an assertion."""
    asserted = {id(node.test) for node in nodes if isinstance(node, ast.Assert)}
    for node in nodes:
        if not isinstance(node, ast.Compare) or id(node) in asserted:
            continue
        contains = isinstance(node.ops[0], ast.In | ast.NotIn)
        texts = node.comparators if contains else [node.left, *node.comparators]
        if any(isinstance(each, ast.Attribute) and each.attr == "message" for each in texts):
            yield node.lineno


def typed_words(root: Path) -> list[str]:
    """Literals compared with names of events or phases: the enumeration's member is meant."""
    events = _words_of(root, "events.py")
    phases = _words_of(root, "phases.py")
    found = []
    for path in python_files(root, *ARROWS, "test", "tools"):
        for line, _, operands in _comparisons(syntax_nodes(path)):
            carriers = _attributes(operands) & set(_WORD_CARRIERS)
            for each in operands:
                word = each.value if isinstance(each, ast.Constant) else None
                is_event = word in events and "name" in carriers
                if is_event or (word in phases and carriers - {"name"}):
                    place = f"{path.relative_to(root)}:{line}"
                    found.append(f"{place}: compares with {word!r}, an enumeration has it")
    return found


def sleeps(root: Path) -> list[str]:
    """Uses of `time.sleep`: nodes and tests wait for conditions (an event, a future)."""
    found = []
    for path in python_files(root, *ARROWS, "test", "launch"):
        for node in syntax_nodes(path):
            attribute = (
                isinstance(node, ast.Attribute)
                and node.attr == "sleep"
                and isinstance(node.value, ast.Name)
                and node.value.id == "time"
            )
            imported = (
                isinstance(node, ast.ImportFrom)
                and node.module == "time"
                and any(alias.name == "sleep" for alias in node.names)
            )
            if attribute or imported:
                found.append(f"{path.relative_to(root)}:{getattr(node, 'lineno', 0)}: time.sleep")
    return found


def repeated_classes(root: Path) -> list[str]:
    """Class names that two modules define: each thing has a name of its own."""
    places: dict[str, list[str]] = {}
    for path in python_files(root, *ARROWS):
        for node in parse(path).body:
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(str(path.relative_to(root)))
    return [
        f"class {name} stands in {' and in '.join(found)}"
        for name, found in places.items()
        if len(found) > 1
    ]


def long_functions(root: Path) -> list[str]:
    """Functions longer than a page: their phases have no names."""
    found = []
    for path in python_files(root, *ARROWS):
        for node in syntax_nodes(path):
            if isinstance(node, ast.FunctionDef) and node.end_lineno is not None:
                lines = node.end_lineno - node.lineno + 1
                if lines > PAGE:
                    place = f"{path.relative_to(root)}:{node.lineno}"
                    found.append(f"{place}: {node.name} has {lines} lines, at most {PAGE}")
    return found


def crowded_classes(root: Path) -> list[str]:
    """Classes with more methods than a reader keeps apart: they do several things."""
    found = []
    for path in python_files(root, *ARROWS):
        for node in syntax_nodes(path):
            if isinstance(node, ast.ClassDef):
                methods = sum(isinstance(each, ast.FunctionDef) for each in node.body)
                if methods > MOST_METHODS:
                    place = f"{path.relative_to(root)}:{node.lineno}"
                    found.append(
                        f"{place}: {node.name} has {methods} methods, at most {MOST_METHODS}"
                    )
    return found


def nodes(root: Path) -> dict[str, str]:
    """Return executable and module of every node, as rover_launch lists them."""
    listed = constants(root / "rover_launch" / "nodes.py")["NODES"]
    assert isinstance(listed, dict)
    return {str(name): str(module) for name, module in listed.items()}


def commands(root: Path) -> dict[str, str]:
    """Return name and target of every command on PATH, as setup.py lists them."""
    listed = constants(root / "setup.py")["CONSOLE_SCRIPTS"]
    assert isinstance(listed, dict)
    return {str(name): str(target) for name, target in listed.items()}


def executables(root: Path) -> dict[str, str]:
    """Return name and target of everything that `ros2 run` starts: nodes and commands."""
    return {name: f"{module}:main" for name, module in nodes(root).items()} | commands(root)


def broken_executables(root: Path) -> list[str]:
    """Executables without shim or target, shims without executable or with another command."""
    listed = executables(root)
    started_by_name = commands(root)
    shims = {path.name: path for path in (root / "scripts").iterdir()}
    found = [f"scripts/{name} belongs to no node or command" for name in shims - listed.keys()]
    for name, target in listed.items():
        module, _, function = target.partition(":")
        source = root.joinpath(*module.split(".")).with_suffix(".py")
        if not source.is_file():
            found.append(f"executable {name}: no module {module}")
        elif function not in _functions_and_names(source):
            found.append(f"executable {name}: {module} has no {function}")
        if name not in shims:
            found.append(f"executable {name} has no scripts/{name}: `ros2 run` cannot find it")
            continue
        command = f'{name}"' if name in started_by_name else f'mother_rover" run {name}'
        expected = f'#!/bin/sh\nexec "$(dirname "$0")/../../bin/{command} "$@"\n'
        if shims[name].read_text(encoding="utf-8") != expected:
            found.append(f"scripts/{name} is not {expected!r}")
        if not shims[name].stat().st_mode & 0o100:
            found.append(f"scripts/{name} is not executable")
    return sorted(found)


def _functions_and_names(path: Path) -> Iterator[str]:
    for node in parse(path).body:
        if isinstance(node, ast.FunctionDef):
            yield node.name
        elif isinstance(node, ast.ImportFrom):
            yield from (alias.asname or alias.name for alias in node.names)
        elif isinstance(node, ast.Assign):
            yield from (target.id for target in node.targets if isinstance(target, ast.Name))


def setup_arguments(root: Path) -> dict[str, object]:
    for node in syntax_nodes(root / "setup.py"):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "setup":
            values: dict[str, object] = {}
            for keyword in node.keywords:
                try:
                    values[str(keyword.arg)] = ast.literal_eval(keyword.value)
                except ValueError:
                    continue
            return values
    raise ValueError(f"{root / 'setup.py'} does not call setup()")


def versions(root: Path) -> dict[str, str]:
    """Return the package's version as each file states it."""
    return {
        "setup.py": str(setup_arguments(root)["version"]),
        "package.xml": ET.parse(root / "package.xml").getroot().findtext("version", ""),
    }


def distribution_of(requirement: str) -> str:
    end = next((i for i, char in enumerate(requirement) if char in "[<>=~! "), len(requirement))
    return requirement[:end].lower()


def undeclared_requirements(root: Path, standard_library: frozenset[str]) -> list[str]:
    """Imports of others' packages that setup.py or package.xml does not ask for."""
    arguments = setup_arguments(root)
    wheels = arguments["install_requires"]
    extras = arguments["extras_require"]
    assert isinstance(wheels, list)
    assert isinstance(extras, dict)
    optional = [*extras.get("bench", []), *extras.get("cluster", [])]
    declared = {distribution_of(each) for each in [*wheels, *optional]}
    manifest = ET.parse(root / "package.xml").getroot()
    keys = {element.text for element in manifest if element.tag.endswith("depend")}
    found = []
    for each in imports(root):
        name = top(each.target)
        if name in standard_library or name in ARROWS or name in TYPES_ONLY:
            continue
        if name in REQUIREMENTS:
            distribution, key = REQUIREMENTS[name]
        elif name.startswith("rosidl_"):  # generators, which come with the wheels of the messages
            distribution, key = "ros-jazzy-common-interfaces", ""
        elif name.endswith(("_msgs", "_srvs", "_interfaces")):
            distribution, key = "ros-jazzy-common-interfaces", name
        else:
            found.append(f"{each.place}: {name} is not among the known requirements")
            continue
        if distribution and distribution not in declared:
            found.append(f"{each.place}: setup.py does not require {distribution}")
        if key and key not in keys:
            found.append(f"{each.place}: package.xml does not depend on {key}")
    return found


def untyped_packages(root: Path) -> list[str]:
    """Top-level packages that do not say they carry types, or are not packages."""
    return [
        f"{package}/{name} is missing"
        for package in ARROWS
        for name in ("__init__.py", "py.typed")
        if not (root / package / name).is_file()
    ]
