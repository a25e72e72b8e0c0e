"""Hold the paper's own timings (section 7, "Performance") for the report and the bench."""

from __future__ import annotations

#: Time of each stage of ``STAGE_NAMES`` on a quad-core of 2012, ms per frame. "Fitting in adaptive space" (9 ms) is made up of
#: the Laplacian deformation (4.2 ms, by the same solver as the final one) and the projection (the rest).
PAPER_MS = {
    "rigid": 3.2,
    "blendshapes": 3.0,
    "laplacian": 4.2,
    "projection": 4.8,
    "final_deformation": 4.2,
    "adaptive_pca": 3.0,
}

#: Sum of the paper's stages, ms.
PAPER_SUM_MS = sum(PAPER_MS.values())
