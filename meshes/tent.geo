// Plan of the tent on two masts: a rhombus between two high points (east and west, 16 m apart) and
// two low points (south and north, 14 m apart), which the demo lifts.
DefineConstant[ size = {0.42, Name "size"} ];
Mesh.MeshSizeMin = size; // of the cells, the same everywhere
Mesh.MeshSizeMax = size;

Point(1) = {0, -7, 0};
Point(2) = {8, 0, 0};
Point(3) = {0, 7, 0};
Point(4) = {-8, 0, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};

Physical Curve("south east") = {1};
Physical Curve("north east") = {2};
Physical Curve("north west") = {3};
Physical Curve("south west") = {4};
Physical Point("south") = {1};
Physical Point("east") = {2};
Physical Point("north") = {3};
Physical Point("west") = {4};
