"""Write the current shape with its cables and bars for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.meshes.gmsh_model import imported
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError, collective, raised_together
from crms_fenicsx.foundation.runtime.files import absolute, make_writable, replaced
from crms_fenicsx.results.view_data import Surface, whole_shape

UNITS = {"mm": 4, "cm": 5, "m": 6, "in": 1, "ft": 2}
"""DXF codes of units."""

SUFFIXES = (".dxf", ".obj", ".stl", ".ply")

FORBIDDEN = '<>/\\":;?*|=`,'
"""Characters that DXF forbids in layer names, besides line breaks and the like."""


@collective
def write_shape(scene: Scene, filename: str | Path, *, unit: str = "m") -> None:
    """Write the current shape, such as a found form, to a file. Collective.

    A .dxf file has the surface as 3D faces on the layer MEMBRANE, and cables, bars and supported
    vertices on layers of their own ("CABLE ridge", "BAR mast", "SUPPORTS"); it requires ezdxf.
    Files .obj, .stl and .ply have the triangles of the surface, written by meshio.

    Parameters
    ----------
    scene
        The scene.
    filename
        Name of the file. An existing file is replaced once the new one is complete.
    unit
        Unit of length of the scene, recorded in .dxf files: "mm", "cm", "m", "in" or "ft".

    Raises
    ------
    InputError
        On all ranks, with nothing written: not a scene, an unknown suffix or unit, displacements
        that are not finite, or a file that cannot be written.
    ImportError, MeshError
        On all ranks: ezdxf or meshio is missing.

    Examples
    --------
    >>> write_shape(found.scene(material), "form.dxf")
    """
    checks.of_type("write_shape: scene", scene, Scene)
    checks.same(scene.comm, "write_shape", filename=filename, unit=unit)
    checks.one_of("write_shape: unit", unit, UNITS)
    path = absolute(checks.file("write_shape: filename", filename), scene.comm)
    checks.one_of("write_shape: the suffix", path.suffix.lower(), SUFFIXES)
    scene.membrane.check_finite("write_shape")
    whole = whole_shape(scene)
    held = np.any(scene.held[: scene.V.dofmap.index_map.size_local], axis=1)
    places = scene.comm.gather(scene.positions()[: len(held)][held])
    with raised_together(scene.comm):
        if whole is not None and places is not None:
            make_writable(path.parent)
            if path.suffix.lower() == ".dxf":
                document = _document(scene, whole, np.concatenate(places), unit)
                with replaced(path) as partial:
                    document.saveas(partial)
            else:
                mesh = imported("meshio").Mesh(
                    np.asarray(whole.points), [("triangle", np.asarray(whole.triangles))]
                )
                with replaced(path) as partial:
                    mesh.write(
                        partial, **({"binary": True} if path.suffix.lower() == ".stl" else {})
                    )


def _document(scene: Scene, surface: Surface, held: Any, unit: str) -> Any:
    """The drawing as an ezdxf document."""
    try:
        import ezdxf
    except ImportError:
        raise ImportError(
            "write_shape needs ezdxf for .dxf: install it (pip install ezdxf; Debian: "
            "python3-ezdxf), or write .obj, .stl or .ply."
        ) from None
    document = ezdxf.new("R2010", units=UNITS[unit])
    space = document.modelspace()

    def layer(name: str, colour: int) -> dict[str, str]:
        plain = "".join("_" if c in FORBIDDEN or not c.isprintable() else c for c in name)
        if plain not in document.layers:
            document.layers.add(plain, color=colour)
        return {"layer": plain}

    membrane = layer("MEMBRANE", 8)
    for corners in np.asarray(surface.points)[np.asarray(surface.triangles)].tolist():
        space.add_3dface(corners, dxfattribs=membrane)
    for cable in scene.cables:
        space.add_polyline3d(cable.line.tolist(), dxfattribs=layer(f"CABLE {cable.name}", 1))
    for bar in scene.bars:
        space.add_line(*bar.points.tolist(), dxfattribs=layer(f"BAR {bar.name}", 5))
    supports = layer("SUPPORTS", 3)
    for place in held.tolist():
        space.add_point(place, dxfattribs=supports)
    if len(document.audit().errors):
        raise InputError("write_shape: the drawing is not sound; write .obj, .stl or .ply.")
    return document
