"""Risk regions from a file: YAML, or NPZ with the nodes of each."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import yaml
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.readings.regions import RiskRegion, RiskRegionError, nodes_of_region, painted

_KEYS = {"name", "margin", "stress_limit", "nodes", "region", "points", "radius"}
_WAYS = "one of nodes (ids), region (of the mesh) or points [m] with radius [m]"


def read_regions(path: Path, mesh: Mesh, margin: float, stress_limit: float) -> list[RiskRegion]:
    """The risk regions of a file.

    A YAML file has a list `risk_regions` of mappings with `name`, one of `nodes`, `region` or
    `points` and `radius`, and perhaps `margin` and `stress_limit`. An NPZ file has the ids of the
    nodes of each region in an array of its name.

    Args:
        path: The file.
        mesh: The tissue they lie in.
        margin: Of those that have none [m].
        stress_limit: Of those that have none [Pa].

    Raises:
        RiskRegionError: The file cannot be read, or a region in it is not allowed.
    """
    entries: Any
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                entries = [{"name": name, "nodes": file[name]} for name in file.files]
        else:
            text = yaml.safe_load(path.read_text(encoding="utf-8"))
            entries = text["risk_regions"] if isinstance(text, dict) else None
    except OSError as error:
        raise RiskRegionError(f"{path} cannot be read: {error.strerror}") from None
    except (KeyError, ValueError, BadZipFile, yaml.YAMLError) as error:
        raise RiskRegionError(f"{path} holds no risk regions: {error}") from None
    if not isinstance(entries, list):
        raise RiskRegionError(f"{path} holds no list risk_regions")
    default = {"margin": margin, "stress_limit": stress_limit}
    found = []
    for number, entry in enumerate(entries, start=1):
        try:
            found.append(_region({**default, **_mapping(entry)}, mesh))
        except (KeyError, TypeError, ValueError) as error:
            raise RiskRegionError(f"{path}, risk region {number}: {error}") from None
    return found


def _mapping(entry: Any) -> dict[str, Any]:
    if not isinstance(entry, dict) or "name" not in entry:
        raise RiskRegionError(f"needs a name and {_WAYS}")
    unknown = sorted(set(entry) - _KEYS)
    if unknown:
        raise RiskRegionError(f"unknown {', '.join(unknown)}; allowed: {', '.join(sorted(_KEYS))}")
    return entry


def _region(entry: dict[str, Any], mesh: Mesh) -> RiskRegion:
    if len({"nodes", "region", "points"} & set(entry)) != 1:
        raise RiskRegionError(f"needs {_WAYS}")
    nodes: NDArray[Any]
    if "nodes" in entry:
        nodes = np.asarray(entry["nodes"])
        if nodes.dtype.kind not in "iu" or nodes.ndim != 1:
            raise RiskRegionError("nodes are a list of ids")
        nodes = nodes.astype(np.int64)
    elif "region" in entry:
        nodes = nodes_of_region(mesh, str(entry["region"]))
    else:
        points = np.asarray(entry["points"], dtype=np.float64).reshape(-1, 3)
        nodes = painted(mesh, points, float(entry.get("radius", 0.0)))
    if not len(nodes):
        raise RiskRegionError("there is no node in it")
    name, margin = str(entry["name"]), float(entry["margin"])
    return RiskRegion(name, nodes, margin, float(entry["stress_limit"])).checked()
