"""Files of a surface that is ready for a session: mesh.ply, surface.json, vertex_sigma.csv."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from palpate.geometry import write_mesh
from palpate.records import json_text, write_text
from palpate.scanning.prepare import PreparedSurface
from palpate.scanning.scan import ScannedSurface

MESH_FORMAT = "palpate-mesh/1"


def write_surface(folder: Path, surface: PreparedSurface | ScannedSurface) -> None:
    """Write mesh.ply, in metres, and surface.json; for a scan also vertex_sigma.csv.

    Parameters
    ----------
    folder : Path                   exists
    surface : PreparedSurface or ScannedSurface

    Raises
    ------
    RecordError                     a file cannot be written
    """
    write_mesh(folder / "mesh.ply", surface.mesh)
    if isinstance(surface, ScannedSurface):
        said = _of_views(surface)
        rows = np.column_stack([surface.mesh.vertices, surface.sigma])
        lines = ["x_m,y_m,z_m,sigma_m"]
        lines += [",".join("" if np.isnan(x) else f"{x:.9g}" for x in row) for row in rows]
        write_text(folder / "vertex_sigma.csv", "\n".join(lines) + "\n")
    else:
        said = _of_mending(surface)
    content = {
        "format": MESH_FORMAT,
        **said,
        "guessed_triangles": np.flatnonzero(surface.guessed),
        "quality": asdict(surface.quality),
    }
    write_text(folder / "surface.json", json_text(content))


def _of_mending(surface: PreparedSurface) -> dict[str, Any]:
    """Repairs, and the deviation of the mesh from the mended surface."""
    return {
        "actions": [
            {"defect": a.defect, "count": a.count, "place": a.place, "done": a.done}
            for a in surface.actions
        ],
        "deviation": asdict(surface.deviation),
    }


def _of_views(surface: ScannedSurface) -> dict[str, Any]:
    """Agreement of the views with each other and with the mesh."""
    return {
        "views": [asdict(one) for one in surface.agreements],
        "distance": {"median": surface.distance[0], "percentile_95": surface.distance[1]},
        "volume_std": surface.volume_std,
    }
