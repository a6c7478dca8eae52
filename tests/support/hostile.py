"""Legal but unusual text files: variants that a format allows and that exporters write differently."""

from __future__ import annotations

POINTS = b"v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nv 1 2 0.5\nv 3 3 1\n"

OBJ = {
    "faces before their vertices": b"f 1 2 3 4\n" + POINTS + b"f -1 -2 -3\n",
    "every form of corner": POINTS
    + b"vt 0 0\nvt 1 0 0\nvt 1 1 0 0\nvn 0 0 1\nvn 0 1 0\nf 1 2 3\nf 1/1 2/2 3/3\nf 1//1 2//1 3//1\n"
    + b"f 1/1/1 2/2/1 3/3/1\nf -6/-3/-2 -5/-2/-2 -4/-1/-2 -3/-1/-2\nf 3//2 4/2/2 5/2 6\n",
    "no newline at the end": POINTS + b"f 1 2 3 4 5",
    "tabs and many spaces": POINTS.replace(b" ", b" \t ") + b"\tf\t1  2\t\t3   \n\n   \t\nf 3 4 5\t\n",
    "continued lines": POINTS.replace(b"v 2 1 0", b"v 2 \\\n 1\\\n 0").replace(b"v 3 3 1", b"v\\\n3 3 1")
    + b"f\\\n 1 2 3\\\n 4\n",
    "a comment that ends in a backslash": POINTS + b"f 1 2 3 # C:\\meshes\\\nf 1 3 4\n# D:\\\nf 3 4 5\n",
    "bytes of other encodings": b"# Stra\xdfe \xff\xfe\x80\n"
    + POINTS
    + b"o Stra\xdfe\ng \xe4\xbd\xa0\xe5\xa5\xbd\nf 1 2 3 # caf\xe9\n",
    "colours": b"v 0 0 0 1 0 0\nv 1 0 0 0.5 1e-3 0\nv 0 1 0 0 0 1\nv 1 1 1 1 1 1\nf 1 2 3 4\n",
    "a fourth coordinate": b"v 0 0 0 1\nv 1 0 0 0.5\nv 0 1 0 1.0\nf 1 2 3\n",
    "huge and tiny": b"v 1e9 -1e9 1E+9\nv 1e-9 -1e-9 1E-9\nv -0.0 +0 -0\nv +1.5e+09 .5 5.\nf 1 2 3\nf 2 3 4\n",
    "vertices twice and faces without area": b"v 0 0 0\nv 0 0 0\nv 1 0 0\nv 1 1 0\n"
    + b"f 1 2 3\nf 1 3 4 2\nf 3 3 3\nf 4 4 3 3\n",
    "a concave polygon": b"v 0 0 0\nv 4 0 0\nv 4 4 0\nv 2 1 0\nv 0 4 0\nf 4 5 1 2 3\n",
    "free-form statements": b"mg 1 0.5\n"
    + POINTS
    + b"vp 0.5 1\ncstype rat bspline\ndeg 3\ncurv 0.0 1.0 1 2 3 4\nparm u 0 0 1 1\nend\nf 1 2 3\n",
    "lines and points among faces": POINTS + b"p 1 2\nf 1 2 3\nl 1 2 3 4\nl 1/ 2/\nf 2 3 4\np -1\n",
    "smoothing and levels": POINTS + b"s 1\nf 1 2 3\ns off\nf 2 3 4\nlod 3\nbevel on\nc_interp off\ns 0\nf 3 4 5\n",
    "many names": b"o first thing\ng a b c\nusemtl none\n"
    + POINTS
    + b"f 1 2 3\no \ng\nusemtl\nf 2 3 4\no first thing\nf 3 4 5\n",
    "polygons of one and two corners": POINTS + b"f 1\nf 1 2\nf 1 2 3\nf\n",
    "shared normals out of order": b"vn 0 0 1\nf 1//1 2//1 3//1\nf 3//1 4//1 5//2\n" + POINTS + b"vn 0 1 0\nvn 1 0 0\n",
}

PLY_HEADER = b"ply\nformat ascii 1.0\nobj_info scanned\ncomment  two  spaces \xff\n"
PLY_POINTS = b"element vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
PLY_ROWS = b"0 0 0\n2 0 0\n2 1 0\n0 1 0\n1 2 0.5\n"

PLY = {
    "faces before vertices": PLY_HEADER
    + b"element face 2\nproperty list uchar int vertex_index\n"
    + PLY_POINTS
    + b"end_header\n4 0 1 2 3\n3 2 3 4\n"
    + PLY_ROWS,
    "wide lists and odd elements": PLY_HEADER
    + b"element material 1\nproperty list uint double weights\nproperty uchar kind\n"
    + PLY_POINTS
    + b"element face 2\nproperty uchar flags\nproperty list uint uint vertex_indices\nproperty list short float heat\n"
    + b"element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n"
    + b"3 1e-300 2.5 -0.0 7\n"
    + PLY_ROWS
    + b"1 4 0 1 2 3 0\n0 3 2 3 4 2 0.5 0.25\n0 1\n",
    "spaces after the words of the header": PLY_HEADER
    + PLY_POINTS.replace(b"\n", b" \t\n")
    + b"element face 1\nproperty list uchar int vertex_indices\nend_header \n"
    + PLY_ROWS
    + b"5 4 3 2 1 0",
    "no rows in an element": PLY_HEADER
    + PLY_POINTS
    + b"element empty 0\nproperty list uchar int nothing\nelement face 1\nproperty list uchar int vertex_indices\n"
    + b"end_header\n"
    + PLY_ROWS
    + b"\n3 0 1 2\n\n",
    "huge and tiny": PLY_HEADER
    + PLY_POINTS.replace(b"float", b"double")
    + b"end_header\n1e9 -1e9 1E+9\n1e-9 -1E-9 0\n-0.0 +0 -0\n+1.5e+09 .5 5.\n1 2 3\n",
    "words for numbers of lists": PLY_HEADER
    + PLY_POINTS.replace(b"float", b"float32")
    + b"element face 1\nproperty list uint8 int32 vertex_indices\nproperty list uint16 float64 texcoord\nend_header\n"
    + PLY_ROWS
    + b"4 0 1 2 3 8 0 0 1 0 1 1 0 1\n",
}

STL = {
    "two solids with names": b"solid \xe4\xbd\xa0 one\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n"
    + b"   vertex 1 0 0\n"
    + b"   vertex 0 1 0\n  endloop\n endfacet\nendsolid \xe4\xbd\xa0 one\nsolid\n facet normal 0 0 0\n  outer loop\n"
    + b"   vertex 1 0 0\n   vertex 1 1 0\n   vertex 0 1 0\n  endloop\n endfacet\nendsolid",
    "upper case and exponents": b"SOLID a\nFACET NORMAL 0 0 1\nOUTER LOOP\nVERTEX 1E9 0 -0.0\nVERTEX 0 1e-9 0\n"
    + b"VERTEX -1e+9 0 1\nENDLOOP\nENDFACET\nENDSOLID a\n",
    "triangles without area": b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    + b"endloop\nendfacet\n"
    + b"facet normal nan nan nan\nouter loop\nvertex 0 0 0\nvertex 0 0 0\nvertex 1 0 0\nendloop\nendfacet\n"
    + b"endsolid\n",
}
