"""Array type aliases with shapes, checked while the tests run, without run-time cost otherwise.

The last axis is the component, leading axes are the batch. A letter binds to one size within
one call or one dataclass: `n` points, `v` vertices, `m` triangles, `k` records or indices.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

Vector3 = Float[np.ndarray, "3"]
Matrix3 = Float[np.ndarray, "3 3"]
Points = Float[np.ndarray, "n 3"]
PointScalars = Float[np.ndarray, " n"]
PointIndices = Int[np.ndarray, " n"]
Flags = Bool[np.ndarray, " n"]
Vertices = Float[np.ndarray, "v 3"]
Triangles = Int[np.ndarray, "m 3"]
TriangleVectors = Float[np.ndarray, "m 3"]
TriangleScalars = Float[np.ndarray, " m"]
Indices = Int[np.ndarray, " k"]
