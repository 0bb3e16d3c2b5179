"""Images as functions of place: `bspline` (cubic splines, matched smoothing), `interpolation` (for kernels), `pyramid`
(the panorama in several resolutions); `colour` (grey values); `comb` (two fields in one picture); `tuning`
(constants)."""
