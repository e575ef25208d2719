"""What the workspace's sources say about themselves, read without importing them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

REPOSITORY = Path(__file__).resolve().parents[2]
SOURCES = REPOSITORY / "src"
PYTHON_PACKAGES = ("tissue_sim", "cut_service", "tool_input", "viz_bridge")


@dataclass(frozen=True)
class Module:
    """One Python file of a package.

    Attributes:
        name: Dotted name.
        path: Its file.
    """

    name: str
    path: Path

    @property
    def package(self) -> str:
        """The ament package it belongs to."""
        return self.name.partition(".")[0]


@cache
def modules() -> dict[str, Module]:
    """Every module of the Python packages, by dotted name."""
    found = {}
    for package in PYTHON_PACKAGES:
        for path in sorted((SOURCES / package / package).rglob("*.py")):
            parts = path.relative_to(SOURCES / package).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found[name] = Module(name, path)
    return found


@cache
def syntax(path: Path) -> ast.Module:
    """Syntax tree of a Python file."""
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def imported(module: Module) -> Iterator[str]:
    """Dotted names that a module imports anywhere, also names taken out of packages."""
    base = module.name.split(".")
    if module.path.name != "__init__.py":
        base = base[:-1]
    for node in ast.walk(syntax(module.path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            origin = base[: len(base) - node.level + 1] if node.level else []
            origin = origin + (node.module.split(".") if node.module else [])
            yield ".".join(origin)
            yield from (".".join([*origin, alias.name]) for alias in node.names)


def import_closure(name: str) -> set[Module]:
    """The modules of the workspace that are imported with one of them, itself among them."""
    known, waiting, found = modules(), [name], set()
    while waiting:
        module = known.get(waiting.pop())
        if module is not None and module not in found:
            found.add(module)
            waiting.extend(imported(module))
    return found


def manifest(package: str) -> ElementTree.Element:
    """Root of a package's package.xml."""
    return ElementTree.parse(SOURCES / package / "package.xml").getroot()


def dependencies(package: str) -> set[str]:
    """Everything that a package.xml depends on in any way."""
    return {(tag.text or "").strip() for tag in manifest(package) if tag.tag.endswith("depend")}


@cache
def entry_points() -> dict[tuple[str, str], tuple[str, str]]:
    """From package and executable to module and function, as setup.py declares them."""
    found = {}
    for package in PYTHON_PACKAGES:
        for node in ast.walk(syntax(SOURCES / package / "setup.py")):
            if not (isinstance(node, ast.Constant) and isinstance(node.value, str)):
                continue
            match = re.fullmatch(r"(\w+) = ([\w.]+):(\w+)", node.value)
            if match:
                found[package, match[1]] = (match[2], match[3])
    return found


def declared_parameters(module: str) -> list[re.Pattern[str]]:
    """Names of the parameters that a node's module, or one it imports, declares.

    A declaration is the first argument of `Spec(...)` or `declare_parameter(...)`; the parts of
    an f-string that are filled in match anything.
    """
    found = []
    for member in import_closure(module):
        for node in ast.walk(syntax(member.path)):
            if isinstance(node, ast.Call) and node.args:
                function = node.func
                name = function.attr if isinstance(function, ast.Attribute) else ""
                name = function.id if isinstance(function, ast.Name) else name
                if name in ("Spec", "declare_parameter"):
                    pattern = _text_pattern(node.args[0])
                    if pattern:
                        found.append(re.compile(pattern))
    return found


def _text_pattern(node: ast.expr) -> str:
    """Regular expression of the texts that an expression can be; "" where it is no text."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return re.escape(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(
            _text_pattern(part) if isinstance(part, ast.Constant) else ".+" for part in node.values
        )
    return ""
