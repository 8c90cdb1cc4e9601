"""Membrane meshes from generators, files and arrays: checked, oriented and distributed."""

from importlib import import_module
from typing import TYPE_CHECKING

from crms_fenicsx.foundation.meshes.cell_division import refine
from crms_fenicsx.foundation.meshes.dolfinx_mesh import from_dolfinx, mesh_tags
from crms_fenicsx.foundation.meshes.domes import air_hall, spherical_cap
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, from_arrays
from crms_fenicsx.foundation.meshes.mesh_files import from_file, from_gmsh, from_step
from crms_fenicsx.foundation.meshes.orientation import AwayFrom
from crms_fenicsx.foundation.meshes.plane import circle, ellipse, polygon, rectangle
from crms_fenicsx.foundation.meshes.refinement import Refinement

__all__ = [
    "AwayFrom",
    "MembraneMesh",
    "Refinement",
    "air_hall",
    "along",
    "circle",
    "ellipse",
    "from_arrays",
    "from_dolfinx",
    "from_file",
    "from_gmsh",
    "from_step",
    "mesh_tags",
    "polygon",
    "rectangle",
    "refine",
    "spherical_cap",
]


if TYPE_CHECKING:
    from crms_fenicsx.foundation.meshes.cutting.along import along


def __getattr__(name: str) -> object:
    """`along`, which needs the packages above this one."""
    if name == "along":
        return import_module("crms_fenicsx.foundation.meshes.cutting.along").along
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
