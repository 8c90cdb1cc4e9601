"""Import and export of shapes: drawings (DXF), triangles (OBJ, STL, PLY), meshes of compas."""

from crms_fenicsx.design.exchange.compas_mesh import from_compas, to_vertices_and_faces
from crms_fenicsx.design.exchange.drawings import Lines, read_dxf
from crms_fenicsx.design.exchange.shape_files import write_shape

__all__ = ["Lines", "from_compas", "read_dxf", "to_vertices_and_faces", "write_shape"]
