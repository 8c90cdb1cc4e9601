// A four-point tent: a hyperbolic paraboloid over a square, two corners high, two low.
// Its edges are straight in the stress-free shape; cables or supports go along "edges".
side = DefineNumber[ 10.0, Name "side" ];
rise = DefineNumber[ 3.0, Name "rise" ];
size = DefineNumber[ 1.0, Name "size" ];

Point(1) = {0, 0, 0, size};
Point(2) = {side, 0, rise, size};
Point(3) = {side, side, 0, size};
Point(4) = {0, side, rise, size};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Surface(1) = {1}; // bilinear between its straight sides

Physical Point("low") = {1, 3};
Physical Point("high") = {2, 4};
Physical Curve("edges") = {1, 2, 3, 4};
Physical Surface("membrane") = {1};
