"""Builds the packages whose sources changed into install/ with colcon, and writes ./tissue.

Run by scripts/setup.sh with the interpreter of .venv. A package is built again when the contents
of its files, the files installed along with it, or the virtual environment changed.
"""

import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / ".venv"
STAMPS = ROOT / "build" / "stamps"
LOGS = ROOT / "build" / "log"
NUMBA_SOURCES = ROOT / "install" / ".numba_sources"
INTERFACES = "tissue_interfaces"
KEPT_NUMBA_CACHES = 3

WRAPPER = """\
#!/bin/bash
# Written by `make setup`: runs the tissue command in the workspace's environment.
. {root}/scripts/env.sh
exec {root}/.venv/bin/python -P -c '
import sys
sys.argv[0] = "tissue"
from tissue_sim.cli import main
sys.exit(main())' "$@"
"""


def package_folders() -> list[Path]:
    """The folders of the workspace's packages, in the order of their names."""
    return sorted(manifest.parent for manifest in (ROOT / "src").glob("*/package.xml"))


def source_files(folder: Path) -> Iterator[Path]:
    """Every file under a folder that can end up in an installation, sorted."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not any(
            part == "__pycache__" or part.endswith(".egg-info") for part in path.parts
        ):
            yield path


def digest(paths: Iterable[Path]) -> str:
    """Digest of the names and contents of files."""
    total = hashlib.sha256()
    for path in paths:
        total.update(str(path.relative_to(ROOT)).encode() + b"\0")
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def signature(package: Path) -> str:
    """What a package's installation depends on."""
    paths = list(source_files(package))
    if package.name == "tissue_sim":
        paths.extend(source_files(ROOT / "config"))
    environment = (VENV / ".tissue_stamp").read_bytes()
    return digest(paths) + hashlib.sha256(environment).hexdigest()


def is_built(package: Path) -> bool:
    """Whether the installation was made from the package's present sources."""
    stamp = STAMPS / package.name
    installed = ROOT / "install" / package.name / "share" / package.name / "package.xml"
    return stamp.is_file() and installed.is_file() and stamp.read_text() == signature(package)


def remove_leftovers(package: Path) -> None:
    """Removes earlier copies of a Python package, so that deleted modules do not live on."""
    if package.name == INTERFACES:
        return
    shutil.rmtree(ROOT / "build" / package.name, ignore_errors=True)
    for modules in (ROOT / "install" / package.name).glob(
        f"lib/python3*/site-packages/{package.name}"
    ):
        for path in list(source_files(modules)):
            if not (package / package.name / path.relative_to(modules)).exists():
                path.unlink()


def colcon_environment() -> dict[str, str]:
    """Environment of a build that sees the virtual environment and no other ROS installation."""
    environment = dict(os.environ)
    for name in ("PYTHONPATH", "COLCON_PREFIX_PATH", "PYTHONDONTWRITEBYTECODE", "ROS_DISTRO"):
        environment.pop(name, None)
    environment["PATH"] = f"{VENV / 'bin'}:{environment.get('PATH', '/usr/bin:/bin')}"
    environment["AMENT_PREFIX_PATH"] = environment["CMAKE_PREFIX_PATH"] = str(VENV)
    return environment


def colcon_build(packages: list[Path]) -> None:
    """Runs colcon; ends the program with the end of its output where it fails."""
    names = [package.name for package in packages]
    command = [str(VENV / "bin" / "colcon"), "--log-base", str(LOGS / "colcon"), "build"]
    command += ["--packages-select", *names, "--event-handlers", "console_direct+"]
    command += ["--cmake-args", f"-DPython3_EXECUTABLE={VENV}/bin/python"]
    LOGS.mkdir(parents=True, exist_ok=True)
    log = LOGS / "build.txt"
    with log.open("wb") as output:
        result = subprocess.run(
            command, cwd=ROOT, env=colcon_environment(), stdout=output, stderr=subprocess.STDOUT
        )
    if result.returncode != 0:
        lines = log.read_text(errors="replace").splitlines()
        print("failed", *lines[-40:], f"[setup] everything it printed: {log}", sep="\n")
        sys.exit(1)


def build(packages: list[Path]) -> None:
    """Builds packages and notes the sources they were built from."""
    STAMPS.mkdir(parents=True, exist_ok=True)
    names = ", ".join(package.name for package in packages)
    print(f"[setup] {'build: ' + names:<41} ", end="", flush=True)
    started = time.monotonic()
    # The signatures are taken first: what is edited during the build is built again next time.
    signatures = {package: signature(package) for package in packages}
    for package in packages:
        (STAMPS / package.name).unlink(missing_ok=True)
        remove_leftovers(package)
    colcon_build(packages)
    for package, value in signatures.items():
        (STAMPS / package.name).write_text(value)
    print(f"{time.monotonic() - started:6.1f} s")


def numba_cache_root() -> Path:
    """The folder of the kernel caches; scripts/env.sh names the same."""
    caches = os.environ.get("XDG_CACHE_HOME") or f"{os.environ.get('HOME') or '/tmp'}/.cache"
    return Path(caches) / "tissue_sim" / "numba"


def name_numba_cache() -> None:
    """Names the kernels' cache after all sources with kernels and removes the oldest caches."""
    sources = [
        path
        for package in package_folders()
        for path in source_files(package)
        if path.suffix == ".py" and "numba" in path.read_text(encoding="utf-8")
    ]
    name = digest(sources)[:16]
    if NUMBA_SOURCES.is_file() and NUMBA_SOURCES.read_text() == name:
        return
    NUMBA_SOURCES.write_text(name)
    caches = [path for path in numba_cache_root().glob("*") if path.is_dir()]
    caches.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    for cache in caches[KEPT_NUMBA_CACHES:]:
        shutil.rmtree(cache, ignore_errors=True)


def write_wrapper() -> None:
    """Writes ./tissue where it is missing or outdated."""
    wrapper = ROOT / "tissue"
    text = WRAPPER.format(root=shlex.quote(str(ROOT)))
    if not (wrapper.is_file() and wrapper.read_text() == text):
        wrapper.write_text(text)
    wrapper.chmod(0o755)


def main() -> None:
    """Builds what changed."""
    outdated = [package for package in package_folders() if not is_built(package)]
    if outdated:
        build(outdated)
    name_numba_cache()
    write_wrapper()


if __name__ == "__main__":
    main()
