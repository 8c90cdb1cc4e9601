// Plan of the tennis hall of the demos: a square of 36 m.
DefineConstant[ size = {1.8, Name "size"} ];
Mesh.MeshSizeMin = size; // of the cells, the same everywhere
Mesh.MeshSizeMax = size;

Point(1) = {-18, -18, 0};
Point(2) = {18, -18, 0};
Point(3) = {18, 18, 0};
Point(4) = {-18, 18, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};

Physical Curve("front") = {1};
Physical Curve("right") = {2};
Physical Curve("back") = {3};
Physical Curve("left") = {4};
Physical Point("front left") = {1};
Physical Point("front right") = {2};
Physical Point("back right") = {3};
Physical Point("back left") = {4};
